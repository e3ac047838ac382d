"""Captures with one fault each, which is named, and a good one, which is not."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.cameras import Cameras
from radiant_core.frames import Frame
from radiant_core.next_flight.capture_faults import capture_faults
from radiant_core.render.trajectories import Lens, cameras_looking_at
from radiant_core.scene import SfmScene

LENS = Lens(size_wh=(80, 60), field_of_view_deg=60.0)
DEPTH_M = 30.0


def scene_of(places: np.ndarray, targets: np.ndarray, half_m: float = 40.0) -> SfmScene:
    """A level ground of 4,000 points, with all that each camera has in its picture."""
    cameras: Cameras = cameras_looking_at(places, targets, LENS)
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-half_m, half_m, (4000, 2)), np.zeros(4000)])
    observations = [
        np.column_stack([rows, np.full(len(rows), index)])
        for index in range(len(cameras))
        if len(rows := np.flatnonzero(cameras.select([index]).any_sees(points)))
    ]
    return SfmScene(
        cameras=cameras,
        points=points,
        colors=np.zeros((4000, 3), np.uint8),
        observations=np.concatenate(observations),
        frame=Frame(kind="unscaled", origin_lat_lon_alt=np.zeros(3)),
    )


def lawn(x0: float = -15.0) -> tuple[np.ndarray, np.ndarray]:
    places = np.array([[x0 + 6 * i, y, DEPTH_M] for y in (-8.0, 0.0, 8.0) for i in range(6)])
    targets = places * [1, 1, 0]
    targets[::3, 0] += 25.0
    return places, targets


def names(scene: SfmScene, images: list[np.ndarray] | None = None) -> list[str]:
    return [fault.name for fault in capture_faults(scene, DEPTH_M, images)]


def test_a_good_capture_has_no_fault() -> None:
    assert names(scene_of(*lawn())) == []


def test_turning_on_the_spot_is_only_rotation() -> None:
    angles = np.linspace(0, 1, 9)
    places = np.tile([0.0, 0.0, DEPTH_M], (9, 1)) + np.random.default_rng(0).normal(0, 0.1, (9, 3))
    targets = np.column_stack([20 * np.cos(angles), 20 * np.sin(angles), np.zeros(9)])
    assert names(scene_of(places, targets)) == ["only rotation"]


def test_one_line_is_named_with_its_figure() -> None:
    places = np.array([[x, 0.1 * (-1) ** i, DEPTH_M] for i, x in enumerate(np.linspace(-20, 20, 9))])
    faults = capture_faults(scene_of(places, places * [1, 1, 0] + [0, 15.0, 0]), DEPTH_M)
    assert [fault.name for fault in faults] == ["one line"]
    assert faults[0].figure == pytest.approx(0.1 / np.std(np.linspace(-20, 20, 9)), rel=0.05)
    assert "second line" in faults[0].sentence


def test_looking_down_alone_is_named() -> None:
    places, _ = lawn()
    (fault,) = capture_faults(scene_of(places, places * [1, 1, 0]), DEPTH_M)
    assert fault.name == "only down" and fault.sentence.startswith(f"only down ({fault.figure:.3g} degrees, limit 12): ")


def test_two_flights_without_overlap_are_named() -> None:
    first, aims = lawn(-75.0)
    aims[:, 0] = np.minimum(aims[:, 0], first[:, 0].max())
    second, second_aims = lawn(65.0)
    second_aims[:, 0] = np.maximum(first[:, 0].max() + 120, second[:, 0])
    scene = scene_of(np.concatenate([first, second]), np.concatenate([aims, second_aims]), 110.0)
    faults = capture_faults(scene, DEPTH_M)
    assert [fault.name for fault in faults] == ["no overlap"]
    assert faults[0].figure == 0


@pytest.mark.parametrize(("levels", "expected"), [((1.0, 1.5), ["exposure hunts"]), ((1.0, 1.02), [])])
def test_exposure_that_goes_up_and_down_is_named(levels: tuple[float, float], expected: list[str]) -> None:
    scene = scene_of(*lawn())
    images = [np.full((60, 80, 3), 120 * levels[index % 2], np.uint8) for index in range(len(scene.cameras))]
    assert names(scene, images) == expected


def test_a_drift_is_no_hunting() -> None:
    scene = scene_of(*lawn())
    images = [np.full((60, 80, 3), 60 + 8 * index, np.uint8) for index in range(len(scene.cameras))]
    assert names(scene, images) == []
