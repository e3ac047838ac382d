"""Flights look where they should, go through their keyframes, and never roll."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.render.trajectories import Lens, along_border, cameras_looking_at, orbit, through_keyframes

LENS = Lens(size_wh=(320, 180), field_of_view_deg=60)


def pixels(cameras: Cameras, targets: np.ndarray) -> np.ndarray:
    in_camera = np.einsum("vij,vj->vi", cameras.cam_from_world[:, :3, :3], targets) + cameras.cam_from_world[:, :3, 3]
    assert (in_camera[:, 2] > 0).all()
    return np.einsum("vij,vj->vi", cameras.Ks, in_camera)[:, :2] / in_camera[:, 2:]


def test_the_target_is_in_the_middle_up_is_up_and_the_lens_has_its_angle() -> None:
    center = np.array([5e5, 5.2e6, 400.0])
    cameras = orbit(center, 80.0, 35.0, 24, LENS)
    assert pixels(cameras, np.tile(center, (24, 1))) == pytest.approx(np.tile([160, 90], (24, 1)), abs=1e-3)
    above = pixels(cameras, np.tile(center + np.array([0, 0, 5]), (24, 1)))
    assert (above[:, 1] < 90).all()
    assert above[:, 0] == pytest.approx(np.full(24, 160), abs=1e-3)
    assert np.linalg.norm(cameras.centers - center, axis=1) == pytest.approx(np.full(24, 80.0))
    turns = np.degrees(np.arctan2(*(cameras.centers - center)[:, :2].T))
    assert np.diff(np.unwrap(turns, period=360)) == pytest.approx(np.full(23, 15.0), abs=1e-6)
    side = center + np.array([[np.tan(np.radians(30)) * 80, 0, 0]])
    north = cameras_looking_at(center[None] - np.array([0, 80, 0]), center[None], LENS)
    assert pixels(north, side)[0] == pytest.approx([320, 90], abs=1e-3)


def test_a_flight_follows_its_border_and_keyframes_are_met() -> None:
    ends = np.array([[10.0, 20.0], [70.0, 100.0]])
    cameras = along_border(ends, 3.0, 12.0, 11, LENS)
    targets = np.column_stack([np.linspace(ends[0], ends[1], 11), np.full(11, 3.0)])
    assert pixels(cameras, targets) == pytest.approx(np.tile([160, 90], (11, 1)), abs=1e-9)
    assert cameras.centers[:, 2] == pytest.approx(np.full(11, 15.0))
    stands, looks = np.array([[0, 0, 10], [10, 0, 12], [10, 20, 30.0]]), np.array([[5, 5, 0], [5, 5, 0], [0, 0, 0.0]])
    film = through_keyframes([0, 1, 3], stands, looks, 10, LENS)
    assert len(film) == 31
    assert film.centers[[0, 10, 30]] == pytest.approx(stands)
    assert pixels(film, looks[np.searchsorted([0, 10, 30], np.arange(31))])[[0, 10, 30]] == pytest.approx(
        np.tile([160, 90], (3, 1)), abs=1e-6
    )
    steps = np.linalg.norm(np.diff(film.centers, axis=0), axis=1)
    # 27 m in the 2 s of the second leg, 10 m in the first: no frame jumps.
    assert steps.max() < 3 * np.median(steps)


def test_straight_down_has_north_up() -> None:
    (pixel,) = pixels(cameras_looking_at([[0, 0, 10.0]], [[0, 0, 0.0]], LENS), np.array([[0.0, 1, 0]]))
    assert pixel[1] < 90
    assert pixel[0] == pytest.approx(160, abs=1e-6)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Lens(size_wh=(0, 100)),
        lambda: Lens(field_of_view_deg=180),
        lambda: cameras_looking_at([[1, 2, 3.0]], [[1, 2, 3.0]], LENS),
        lambda: cameras_looking_at(np.zeros((0, 3)), np.zeros((0, 3)), LENS),
        lambda: cameras_looking_at([[np.nan, 0, 0]], [[0, 0, 0]], LENS),
        lambda: orbit([0, 0, 0], -1, 30, 5, LENS),
        lambda: along_border(np.zeros((2, 2)), 0, 5, 5, LENS),
        lambda: through_keyframes([0, 0], np.ones((2, 3)), np.zeros((2, 3)), 24, LENS),
        lambda: through_keyframes([0, 1e9], np.ones((2, 3)), np.zeros((2, 3)), 24, LENS),
    ],
)
def test_impossible_flights_are_refused(make: object) -> None:
    assert callable(make)
    with pytest.raises(BadInput):
        make()
