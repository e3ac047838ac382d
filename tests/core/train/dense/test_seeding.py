"""What a training begins with where its photographs were matched, and where they could not be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.hierarchy.device import prepare_training
from radiant_core.hierarchy.messages import DeviceTask
from radiant_core.hierarchy.reporter import Recorder
from radiant_core.numerics import FloatArray
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig, train_preset, with_settings
from radiant_core.train.dense.points import dense_points
from radiant_core.train.dense.seeding import MIN_POINTS, PIXELS_PER_POINT, seed_densely
from radiant_core.train.densify.density import rotate
from radiant_core.train.initialize import FLATNESS, first_splats, with_dense_points
from tests.core.train.dense.textured import HEIGHT_M, SIZE_WH, step_height, step_scene

PIXEL_M = HEIGHT_M / (0.9 * SIZE_WH[0])
CONFIG = with_settings(train_preset("default"), {"dense_points": "always"})


def directions_of(splats: Splats) -> FloatArray:
    return rotate(splats.quats.astype(np.float64), np.tile([0.0, 0, 1], (len(splats.means), 1)))


def test_dense_points_begin_the_model_and_growth_is_off() -> None:
    scene, views = step_scene(0.8)
    recorder = Recorder()
    prepared = prepare_training(DeviceTask(scene=scene, train=CONFIG, backend="native"), views, recorder)
    assert prepared.config.density.kind == "none"
    decision = next(each for each in recorder.decisions if each.topic == "dense points")
    assert decision.forced and decision.figure is not None and decision.figure >= MIN_POINTS
    assert decision.figure <= len(views) * SIZE_WH[0] * SIZE_WH[1] / PIXELS_PER_POINT
    heights = prepared.initial.means[:, 2]
    truth = step_height(prepared.initial.means[:, :2].astype(np.float64), 0.8)
    assert np.median(np.abs(heights - truth)) < 0.5 * PIXEL_M


def test_gaussians_are_flat_along_the_normals() -> None:
    scene, views = step_scene(0.0)
    plain, _ = first_splats(scene, views, TrainConfig(dense_points="none"))
    points = dense_points(scene, views, most=500)
    both = with_dense_points(plain, points, 10_000)
    flat = np.isclose(both.log_scales[:, 2] - both.log_scales[:, 0], np.log(FLATNESS), atol=1e-5)
    assert flat.sum() == len(points)
    # Both hold the same directions, in another order.
    np.testing.assert_allclose(np.sort(directions_of(both)[flat, 2]), np.sort(points.normals[:, 2]), atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(both.quats, axis=1), 1, atol=1e-5)


@pytest.mark.parametrize("normal", [[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, -1, 0], [0.6, 0, -0.8]])
def test_any_normal_can_be_turned_to(normal: list[float]) -> None:
    scene, views = step_scene(0.0)
    plain, _ = first_splats(scene, views, TrainConfig())
    points = dense_points(scene, views, most=200)
    turned = with_dense_points(plain, replace(points, normals=np.tile(np.array(normal, float), (len(points), 1))), 10_000)
    flat = np.isclose(turned.log_scales[:, 2] - turned.log_scales[:, 0], np.log(FLATNESS), atol=1e-5)
    np.testing.assert_allclose(directions_of(turned)[flat], np.tile(normal, (len(points), 1)), atol=1e-5)


@pytest.mark.parametrize("limit", [10, 150, 600])
def test_no_more_gaussians_than_allowed(limit: int) -> None:
    scene, views = step_scene(0.0)
    config = replace(CONFIG, max_num_splats=limit)
    config, dense, _ = seed_densely(config, scene, views)
    initial, _ = first_splats(scene, views, config, dense)
    assert len(initial) <= limit


def test_what_is_not_asked_for_changes_nothing() -> None:
    scene, views = step_scene(0.4)
    config = train_preset("standard")
    assert seed_densely(config, scene, views) == (config, None, ())


def test_where_nothing_agrees_growth_stays_on() -> None:
    scene, views = step_scene(0.0)
    black = replace(views, images=tuple(np.zeros_like(image) for image in views.images))
    config, dense, (decision,) = seed_densely(CONFIG, scene, black)
    assert config == CONFIG and dense is None
    assert decision.changes_nothing and decision.choice == "no dense points"


def test_another_value_is_refused() -> None:
    with pytest.raises(BadInput, match="dense_points"):
        TrainConfig(dense_points="some")  # pyright: ignore[reportArgumentType]
