"""The unit of the centres' rates: what a camera sees counts, not how far it flew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig, train_preset
from radiant_core.train.densify.policies import NoDensification
from radiant_core.train.extent import camera_extent, extent_decision, viewing_distance, working_extent
from radiant_core.train.trainer import FitOptions, fit_splats
from radiant_core.train.views import TrainingViews
from tests.core.scenes import cameras_above, ground_splats

HEIGHT_M = 6.0


def line(length_m: float, count: int = 41) -> Cameras:
    """Cameras that look down from 6 m along a line."""
    return cameras_above([(x, 0.0) for x in np.linspace(-length_m / 2, length_m / 2, count)], height_m=HEIGHT_M)


def ground(length_m: float) -> Splats:
    """Gaussians on the ground below it, and some so far away that they are the sky."""
    rng = np.random.default_rng(0)
    splats = ground_splats(4_000)
    means = np.column_stack([rng.uniform(-length_m / 2, length_m / 2, 4_000), rng.uniform(-4, 4, 4_000), np.zeros(4_000)])
    means[:100, 2] = -5_000.0
    return replace(splats, means=means.astype(np.float32))


def test_extent_of_one_camera_is_positive() -> None:
    assert camera_extent(line(0, 1)) > 0


@pytest.mark.parametrize("length_m", [4.0, 40.0, 400.0])
def test_a_longer_flight_at_the_same_height_has_no_larger_steps(length_m: float) -> None:
    cameras, splats = line(length_m), ground(length_m)
    assert viewing_distance(cameras, splats.means) == pytest.approx(HEIGHT_M, rel=1e-5)
    assert working_extent(cameras, splats, 2.0) == pytest.approx(min(1.1 * length_m / 2, 2 * HEIGHT_M), rel=1e-5)
    assert working_extent(cameras, splats, None) == camera_extent(cameras)


def test_distance_is_that_of_a_plain_loop_over_cameras_and_places() -> None:
    cameras, places = line(20.0, 7), ground(20.0).means[::40].astype(np.float64)
    places = places[places[:, 2] > -1_000] + np.random.default_rng(1).normal(0, 1, (len(places) - (places[:, 2] <= -1_000).sum(), 3))
    nearer = []
    for K, pose, (width, height) in zip(cameras.Ks, cameras.cam_from_world, cameras.sizes_wh, strict=True):
        depths = []
        for place in places:
            x, y, z = K @ (pose[:3, :3] @ place + pose[:3, 3])
            if z > 0 and 0 < x / z < width and 0 < y / z < height:
                depths.append(z)
        nearer.append(np.quantile(depths, 0.25))
    assert viewing_distance(cameras, places) == pytest.approx(float(np.median(nearer)), rel=1e-9)


def test_what_sees_nothing_has_the_extent_of_its_cameras() -> None:
    cameras = line(40.0)
    away = replace(ground(40.0), means=ground(40.0).means + np.float32([0, 0, 6_000]))
    empty = ground(40.0).select(np.arange(0))
    for splats in (away, empty):
        assert viewing_distance(cameras, splats.means) is None
        assert working_extent(cameras, splats, 2.0) == camera_extent(cameras)


def test_another_unit_of_length_changes_nothing() -> None:
    cameras, splats = line(400.0), ground(400.0)
    expected = working_extent(cameras, splats, 2.0)
    for scale in (1e-3, 1e4):
        poses = cameras.cam_from_world.copy()
        poses[:, :3, 3] *= scale
        larger, scaled = replace(cameras, cam_from_world=poses), replace(splats, means=splats.means * np.float32(scale))
        assert working_extent(larger, scaled, 2.0) == pytest.approx(scale * expected, rel=1e-4)


def test_the_decision_says_what_is_done_and_for_how_much() -> None:
    short, long, free = (
        extent_decision(line(length_m), ground(length_m), limit) for length_m, limit in ((4.0, 2.0), (400.0, 2.0), (400.0, None))
    )
    assert short.changes_nothing and short.figure == 1 and "in place" not in short.choice
    assert long.choice == "centres move in units of 12 instead of 220" and long.figure == pytest.approx(220 / 12, rel=1e-4)
    assert free.changes_nothing and free.reason == "as in 3DGS"


def test_a_long_flight_trains_as_a_short_one_does() -> None:
    """Centres of the first step move as far, whatever lies beside the pictures that they are in."""
    moved = {}
    for length_m, limit in ((8.0, 2.0), (400.0, 2.0), (400.0, None)):
        cameras, splats = line(length_m, 101), ground(length_m)
        images = tuple(np.full((height, width, 3), 200, np.uint8) for width, height in cameras.sizes_wh)
        config = TrainConfig(num_steps=1, long_side_px=48, density=NoDensification(), max_extent_per_distance=limit, means_lr_end=1.0)
        fitted = fit_splats(splats, TrainingViews(cameras=cameras, images=images), config, FitOptions(backend="native")).splats
        moved[length_m, limit] = float(np.abs(fitted.means - splats.means).max())
    assert moved[400.0, 2.0] == pytest.approx(1.6e-4 * 2 * HEIGHT_M, rel=0.05)
    assert moved[8.0, 2.0] == pytest.approx(1.6e-4 * 1.1 * 4, rel=0.05)
    assert moved[400.0, None] == pytest.approx(1.6e-4 * 220, rel=0.05)


def test_plain_3dgs_keeps_the_extent_of_its_cameras() -> None:
    limits = {name: train_preset(name).max_extent_per_distance for name in ("draft", "default", "standard", "paper")}
    assert limits == {"draft": 2.0, "default": 2.0, "standard": None, "paper": None}
    with pytest.raises(BadInput, match="max_extent_per_distance"):
        TrainConfig(max_extent_per_distance=0.0)
