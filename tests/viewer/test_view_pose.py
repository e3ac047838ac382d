"""Views and cameras are inverse; flights pass through their keyframes with valid directions."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_viewer.pictures.fly_through import flight_poses
from radiant_viewer.pictures.view_pose import ViewPose, camera_pose
from tests.viewer.made_up_run import made_up_town

UTM = np.array([612_345.678, 5_411_234.567, 312.25])


def vtk_pixel(pose: ViewPose, place: np.ndarray, size_wh: tuple[int, int]) -> np.ndarray:
    """Where VTK itself draws a place: an independent projection, px from the upper left."""
    import pyvista as pv

    camera = pv.Camera()
    camera.position, camera.focal_point = tuple(pose.position - UTM), tuple(pose.focal_point - UTM)
    camera.up, camera.view_angle, camera.clipping_range = tuple(pose.up), pose.angle_deg, (0.1, 1000)
    matrix = camera.GetCompositeProjectionTransformMatrix(size_wh[0] / size_wh[1], -1, 1)
    clip = np.array([[matrix.GetElement(row, column) for column in range(4)] for row in range(4)]) @ [*(place - UTM), 1]
    return (clip[:2] / clip[3] * (1, -1) + 1) / 2 * size_wh


@pytest.mark.parametrize("origin", [np.zeros(3), UTM])
def test_a_view_projects_as_vtk_does(origin: np.ndarray) -> None:
    eye, target = origin + np.array([3, -20, 15]), origin + np.array([1, 2, 0])
    pose = ViewPose(position=eye, focal_point=target, up=np.array([0.1, 0, 3.0]), angle_deg=37)
    camera = pose.camera((640, 360))
    for offset in ([0, 0, 0], [4, 3, 1], [-5, 1, 2]):
        place = origin + offset
        in_camera = camera.cam_from_world[0] @ [*place, 1]
        ours = (camera.Ks[0] @ in_camera[:3])[:2] / in_camera[2]
        shifted = ViewPose(position=pose.position - origin + UTM, focal_point=pose.focal_point - origin + UTM, up=pose.up, angle_deg=37)
        # 1e-6 px: float64 at 5e6 m leaves 1e-9 m, some 1e-7 px here.
        np.testing.assert_allclose(ours, vtk_pixel(shifted, place - origin + UTM, (640, 360)), atol=1e-5)


def test_the_pose_of_a_camera_gives_that_camera_back() -> None:
    cameras = made_up_town().scene.cameras
    again = camera_pose(cameras, 9, distance=55.0).camera((640, 480))
    np.testing.assert_allclose(again.cam_from_world[0], cameras.cam_from_world[9], atol=1e-9)
    np.testing.assert_allclose(again.Ks[0], cameras.Ks[9], atol=1e-9)


def test_views_that_see_nothing_are_refused() -> None:
    for position, focal_point, up, angle in (
        ([0, 0, 1], [0, 0, 0], [0, 0, 1], 30),
        ([1, 1, 1], [1, 1, 1], [0, 0, 1], 30),
        ([0, 0, 1], [1, 0, 0], [0, 0, 1], 180),
        ([0, 0, 1], [1, 0, 0], [0, 0, 1], float("nan")),
        ([0, np.inf, 1], [1, 0, 0], [0, 0, 1], 30),
    ):
        with pytest.raises(BadInput):
            ViewPose(position=np.array(position), focal_point=np.array(focal_point), up=np.array(up), angle_deg=angle)


def pose_from_south(target: np.ndarray, distance: float) -> ViewPose:
    place = target + distance * np.array([0.0, -0.8, 0.6])
    return ViewPose(position=place, focal_point=target, up=np.array([0.0, 0, 1]), angle_deg=30.0)


def test_a_flight_passes_its_keyframes_and_overshoots_none() -> None:
    keys = [pose_from_south(UTM + np.array([40 * index, 0, 0]), 30.0 + index) for index in range(4)]
    frames = flight_poses(keys, seconds_per_leg=2.0, frames_per_s=10)
    assert len(frames) == 61
    for index, key in enumerate(keys):
        np.testing.assert_allclose(frames[20 * index].position, key.position, atol=1e-6)
        np.testing.assert_allclose(frames[20 * index].focal_point, key.focal_point, atol=1e-6)
    easts = np.array([frame.focal_point[0] for frame in frames])
    assert (np.diff(easts) >= 0).all()
    assert easts.max() <= keys[-1].focal_point[0] + 1e-6


def test_a_flight_over_the_top_and_one_on_the_spot_keep_a_direction() -> None:
    up = np.array([0.0, 0, 1])
    over = [ViewPose(position=np.array([x, 0.0, 10.0]), focal_point=np.zeros(3), up=up, angle_deg=30) for x in (-10.0, 10.0)]
    assert all(np.isfinite(frame.rotation).all() for frame in flight_poses(over, 1.0, 10))
    assert len(flight_poses([over[0], over[0]], 1.0, 5)) == 6


@pytest.mark.parametrize(("count", "seconds", "rate"), [(1, 1, 24), (2, 0, 24), (2, np.nan, 24), (2, 1, 500), (2, 1e6, 24), (2, 0.01, 1)])
def test_flights_that_cannot_be_flown_are_refused(count: int, seconds: float, rate: float) -> None:
    with pytest.raises(BadInput):
        flight_poses([pose_from_south(np.zeros(3), 10.0)] * count, seconds, rate)
