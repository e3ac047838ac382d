"""Exposures of models from places that two of them show: corrected where they differ, else not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from radiant_core.aggregate.balance import MIN_LEVELS, balance_teachers, expose_splats, exposure_balance
from radiant_core.aggregate.synthetic_views import Teacher
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats
from tests.core.scenes import cameras_above, ground_splats

NEAR = (cameras_above([(-1, -1), (-1, 1)]), cameras_above([(1, -1), (1, 1)]), cameras_above([(0, -1), (0, 1)]))


def soft_ground() -> Splats:
    """Ground whose colours stay inside 0..1 when they are exposed otherwise."""
    ground = ground_splats(400)
    return replace(ground, sh0=ground.sh0 * np.float32(0.4))


def exposed(gains: list[float], offsets: list[float]) -> list[Teacher]:
    pairs = zip(gains, offsets, NEAR, strict=False)
    return [Teacher(splats=expose_splats(soft_ground(), np.full(3, g), np.full(3, b)), cameras=own) for g, b, own in pairs]


def test_exposing_a_model_exposes_its_pictures() -> None:
    gains, offsets = np.array([0.7, 0.9, 1.1]), np.array([0.05, 0.0, -0.02])
    shown = zip(render_views(expose_splats(soft_ground(), gains, offsets), NEAR[0]), render_views(soft_ground(), NEAR[0]), strict=True)
    for after, before in shown:
        # Over black: what is transparent stays so; float32 sums.
        np.testing.assert_allclose(after.image, gains * before.image + offsets * before.alpha[..., None], atol=1e-5)


def test_exposures_that_were_planted_are_taken_back_up_to_the_mean_of_all() -> None:
    given = [0.8, 1.1, 1.1]
    teachers = exposed(given, [0.0, 0.03, -0.03])
    balance = exposure_balance(teachers)
    assert balance.is_needed and balance.num_pairs > 2_000
    np.testing.assert_allclose(balance.gains.mean(axis=0), 1, atol=1e-9)
    np.testing.assert_allclose(balance.offsets.mean(axis=0), 0, atol=1e-9)
    shown = [view.image for teacher in balance_teachers(teachers, balance) for view in render_views(teacher.splats, NEAR[2])]
    for first, second in ((0, 2), (1, 3), (0, 4)):
        # One ground for all: only float32 and the ridge are left.
        assert np.abs(shown[first] - shown[second]).max() < 0.5 / 255


def test_models_of_one_exposure_keep_their_bits() -> None:
    teachers = exposed([1.0, 1.0], [0.0, 0.0])
    balance = exposure_balance(teachers)
    assert balance.levels < 0.1 < MIN_LEVELS and not balance.is_needed
    assert all(after is before for after, before in zip(balance_teachers(teachers, balance), teachers, strict=True))


def test_models_that_share_no_place_are_left_alone() -> None:
    near, dark = exposed([1.0, 0.5], [0.0, 0.0])
    means = dark.splats.means + np.float32([1000, 0, 0])
    far = Teacher(splats=replace(dark.splats, means=means), cameras=cameras_above([(999, 0), (1001, 0)]))
    for teachers in ([near, far], [near]):
        balance = exposure_balance(teachers)
        assert balance.num_pairs == 0 and not balance.is_needed and (balance.gains == 1).all()
