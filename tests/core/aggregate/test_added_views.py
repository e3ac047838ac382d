"""A level field of Gaussians, wrong in one corner, is refined by a photograph of that corner."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.aggregate.added_views import RefinedModel, refine_with_views
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.frames import Frame
from radiant_core.render.rendered_view import render_views
from radiant_core.render.trajectories import Lens, cameras_looking_at
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from radiant_core.train.config import train_preset
from radiant_core.train.trainer import FitOptions
from radiant_core.train.views import TrainingViews

LENS = Lens(size_wh=(64, 48), field_of_view_deg=50.0)
STEP_M, SIDE = 0.5, 40


def field() -> Splats:
    rng = np.random.default_rng(7)
    x, y = np.meshgrid(*[STEP_M * (np.arange(SIDE) - SIDE / 2)] * 2)
    count = x.size
    return Splats(
        means=np.column_stack([x.ravel(), y.ravel(), np.zeros(count)]).astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        log_scales=np.full((count, 3), np.log(0.6 * STEP_M), np.float32),
        logit_opacities=np.full(count, 3.0, np.float32),
        sh0=rng.uniform(-1, 1, (count, 1, 3)).astype(np.float32),
        shN=np.zeros((count, 0, 3), np.float32),
    )


def cameras() -> Cameras:
    """Two over the west, two over the east; the last one over the north-east corner is new."""
    places = np.array([[-6.0, -4, 6], [-6, 4, 6], [5, -5, 6], [5, -4, 6], [6, 6, 5]])
    return cameras_looking_at(places, places * [1, 1, 0] + [0.1, 0.2, 0], LENS)


def views_of(model: Splats, gains: tuple[float, ...]) -> TrainingViews:
    images = [
        np.clip(255 * gain * view.image, 0, 255).astype(np.uint8) for gain, view in zip(gains, render_views(model, cameras()), strict=True)
    ]
    return TrainingViews(cameras=cameras(), images=tuple(images))


def scene_of(model: Splats) -> SfmScene:
    points = model.means[::3].astype(np.float64)
    observed = [np.zeros((0, 2), np.int64)] + [
        np.column_stack([rows, np.full(len(rows), index)])
        for index in range(len(cameras()))
        if len(rows := np.flatnonzero(cameras().select([index]).any_sees(points)))
    ]
    frame = Frame(kind="unscaled", origin_lat_lon_alt=np.zeros(3))
    colors = np.full((len(points), 3), 127, np.uint8)
    return SfmScene(cameras=cameras(), points=points, colors=colors, observations=np.concatenate(observed), frame=frame)


def refined(before: Splats, truth: Splats, gain: float = 1.0) -> RefinedModel:
    config = replace(train_preset("draft"), num_steps=150, sh_degree=0, sky=False, fill_in=False)
    is_new = np.array([False] * 4 + [True])
    return refine_with_views(before, scene_of(truth), views_of(truth, (1.0,) * 4 + (gain,)), is_new, config, FitOptions())


def corner_is_wrong(truth: Splats) -> Splats:
    wrong = np.asarray((truth.means[:, :2] > 3).all(axis=1))
    return replace(truth, sh0=np.where(wrong[:, None, None], np.float32(0), truth.sh0))


def error_db(model: Splats, truth: Splats) -> float:
    one = cameras().select([4])
    (shown,), (true,) = (list(render_views(one_model, one)) for one_model in (model, truth))
    return psnr_db(shown.image, true.image)


def test_the_corner_is_mended_and_the_west_keeps_its_bits() -> None:
    truth = field()
    before = corner_is_wrong(truth)
    result = refined(before, truth)
    assert error_db(result.splats, truth) > error_db(before, truth) + 3
    west = truth.means[:, 0] < -2
    assert not result.moved[west].any()
    for name, array in before.arrays().items():
        assert result.splats.arrays()[name][: len(before)][~result.moved].tobytes() == array[~result.moved].tobytes()
    # No photograph of the west shows what moves.
    assert {4} <= set(result.views.tolist()) <= {2, 3, 4}
    assert len(result.splats) == len(before) + result.num_added


def test_a_darker_photograph_is_brought_into_the_light_of_the_model() -> None:
    truth = field()
    result = refined(truth, truth, gain=0.7)
    assert any(decision.topic == "light" and "one canonical light" in decision.choice for decision in result.decisions)
    # Fitted as it was taken it would leave the model some 10 dB of a change of 30 %.
    assert error_db(result.splats, truth) > 25


def test_an_empty_land_gets_gaussians_and_a_photograph_of_nothing_is_refused() -> None:
    truth = field()
    bare = truth.select(~(truth.means[:, :2] > 3).all(axis=1))
    result = refined(bare, truth)
    # Of some 31 points that the photograph shows, those that are no neighbours of the rim.
    assert 15 <= result.num_added <= 31
    assert (result.splats.means[len(bare) :, :2] > 2).all()
    away = replace(truth, means=truth.means - np.float32([200, 0, 0]))
    with pytest.raises(BadInput, match="show none of the model"):
        refined(away, away)
