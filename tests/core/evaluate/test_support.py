"""Support: which views constrain a Gaussian, against counts and angles found another way."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.evaluate.shown_pixels import count_shown_pixels
from radiant_core.evaluate.support import largest_angles_deg, support_of
from radiant_core.geometry.support import Support, load_support, save_support, unconstrained
from radiant_core.splats import Splats, concatenate_splats
from tests.core.scenes import cameras_above, ground_splats


def one_splat(place: tuple[float, float, float], scale: float = 0.2) -> Splats:
    """An opaque grey Gaussian."""
    return Splats(
        means=np.array([place]), quats=np.array([[1.0, 0, 0, 0]]), log_scales=np.full((1, 3), np.log(scale)),
        logit_opacities=np.array([3.0]), sh0=np.zeros((1, 1, 3)), shN=np.zeros((1, 0, 3)),
    )  # fmt: skip


def test_the_views_that_show_a_gaussian_are_counted_with_their_angle() -> None:
    cameras = cameras_above([(-1.0, 0.0), (1.0, 0.0), (40.0, 0.0)])
    support = support_of(one_splat((0.0, 0.0, 0.0)), cameras)
    assert support.num_views.tolist() == [2]
    assert support.parallax_deg[0] == pytest.approx(2 * np.degrees(np.arctan(1 / 6)), rel=1e-6)
    assert support.constrained(2, 15.0).tolist() == [True]
    assert support.constrained(3, 15.0).tolist() == [False]
    assert support.constrained(2, 25.0).tolist() == [False]


def test_what_lies_behind_another_or_outside_is_not_supported() -> None:
    ground = ground_splats(400)
    ground = replace(ground, log_scales=ground.log_scales + np.float32(0.7), logit_opacities=ground.logit_opacities + 3)
    hidden, outside = one_splat((0.0, 0.0, -3.0), 0.05), one_splat((90.0, 0.0, 0.0))
    cameras = cameras_above([(-1.0, 0.0), (0.0, 1.0), (1.0, 0.0)], size_wh=(96, 72))
    model = concatenate_splats([ground, hidden, outside])
    support = support_of(model, cameras)
    assert support.num_views[-2:].tolist() == [0, 0] and support.parallax_deg[-2:].tolist() == [0, 0]
    near = np.abs(model.means[:-2, :2]).max(axis=1) < 1
    assert np.median(support.num_views[:-2][near]) == 3
    np.testing.assert_allclose(support.shown_px, count_shown_pixels(model, cameras), rtol=1e-5, atol=1e-3)


def test_one_view_has_no_parallax_and_no_view_no_support() -> None:
    alone = support_of(one_splat((0.0, 0.0, 0.0)), cameras_above([(0.0, 0.0)]))
    assert (alone.num_views.tolist(), alone.parallax_deg.tolist()) == ([1], [0.0])
    cameras = cameras_above([(0.0, 0.0)]).select(np.zeros(0, np.int64))
    nobody = support_of(one_splat((0.0, 0.0, 0.0)), cameras)
    assert (nobody.num_views.tolist(), nobody.parallax_deg.tolist(), nobody.shown_px.tolist()) == ([0], [0.0], [0.0])
    empty = support_of(one_splat((0.0, 0.0, 0.0)).select(np.zeros(0, np.int64)), cameras_above([(0.0, 0.0)]))
    assert len(empty.num_views) == 0


def test_angles_are_within_the_bound_of_all_pairs_and_exact_on_an_arc() -> None:
    rng = np.random.default_rng(0)
    places, centers = rng.normal(0, 1, (60, 3)), rng.normal(0, 5, (9, 3)) + np.array([0, 0, 20])
    seen = rng.random((9, 60)) < 0.5
    seen[:, 0], seen[:, 1], seen[1:, 2] = False, True, False
    found = largest_angles_deg(places, centers, [np.flatnonzero(row) for row in seen])
    for column in range(60):
        rays = centers[seen[:, column]] - places[column]
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        exact = max((np.degrees(np.arccos(np.clip(a @ b, -1, 1))) for a, b in itertools.combinations(rays, 2)), default=0.0)
        assert exact / 2 - 1e-4 <= found[column] <= exact + 1e-4
    arc = np.column_stack([10 * np.sin(np.linspace(-1, 1.2, 7)), np.zeros(7), 10 * np.cos(np.linspace(-1, 1.2, 7))])
    assert largest_angles_deg(np.zeros((1, 3)), arc, [np.zeros(1, np.int64)] * 7)[0] == pytest.approx(np.degrees(2.2))


def test_a_gaussian_at_a_cameras_centre_and_far_away_have_finite_angles() -> None:
    centers = np.array([[0.0, 0, 0], [1e7, 0, 0], [0, 1e7, 0]])
    angles = largest_angles_deg(np.array([[0.0, 0, 0], [1e9, 1e9, 0]]), centers, [np.arange(2)] * 3)
    assert np.isfinite(angles).all()
    exact = np.degrees(np.arctan2(1e7 * 1e9, 1e9 * (1e9 - 1e7)))
    assert angles[1] == pytest.approx(exact, rel=0.02)


def test_a_file_of_support_comes_back_and_broken_or_poisoned_ones_are_refused(tmp_path: Path) -> None:
    support = Support(num_views=np.array([0, 3]), parallax_deg=np.array([0.0, 12.5]), shown_px=np.array([0.0, 90.0]))
    save_support(tmp_path / "support.safetensors", support)
    again = load_support(tmp_path / "support.safetensors")
    assert again.num_views.tolist() == [0, 3] and again.parallax_deg.tolist() == [0.0, 12.5] and len(again) == 2
    with pytest.raises(BadInput, match="parallax_deg"):
        Support(num_views=np.array([1, 2]), parallax_deg=np.array([np.nan, 1.0]), shown_px=np.zeros(2))
    with pytest.raises(BadInput, match="shown_px"):
        Support(num_views=np.array([1, 2]), parallax_deg=np.zeros(2), shown_px=np.zeros(3))
    (tmp_path / "support.safetensors").write_bytes(b"no table")
    with pytest.raises((BadInput, StoreDamaged)):
        load_support(tmp_path / "support.safetensors")


def test_the_background_is_not_called_unconstrained() -> None:
    near, far = one_splat((0.0, 0.0, 0.0)), one_splat((500.0, 0.0, 0.0))
    support = Support(num_views=np.array([1, 1]), parallax_deg=np.zeros(2), shown_px=np.ones(2))
    points = np.random.default_rng(0).normal(size=(50, 3))
    model = concatenate_splats([near, far])
    assert unconstrained(model, support, points).tolist() == [True, False]
    assert unconstrained(model, support, points[:0]).tolist() == [True, True]
