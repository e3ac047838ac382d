"""The world frame: metric and upright where GPS allows, and said plainly where it does not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from radiant_core.cameras import Cameras
from radiant_core.decisions import Decision
from radiant_core.frames import Sim3, enu_from_geodetic
from radiant_core.io.colmap.records import ColmapCamera, ColmapImage, ColmapModel, ColmapPoints
from radiant_core.io.photos.listing import CameraKey, Photograph
from radiant_core.scene import SfmScene
from radiant_core.sfm.world_frame.orient import MEDIAN_DEPTH_UNITS, level_fit, level_rotation
from radiant_core.sfm.world_frame.placement import Placement
from radiant_core.sfm.world_frame.up import estimate_up
from radiant_core.sfm.world_frame.world import cameras_of, scene_in_world

ORIGIN = np.array([46.8, -91.9, 200.0])
DEGREES_PER_M = np.array([1 / 111_170.0, 1 / 76_300.0])
SIZE_WH = (640, 480)


def looking(yaw_deg: float, pitch_deg: float) -> np.ndarray:
    """Rotation cam_from_world of a level camera, pitch 0 horizontal and 90 straight down."""
    yaw, pitch = np.radians([yaw_deg, pitch_deg])
    right = np.array([np.cos(yaw), -np.sin(yaw), 0])
    forward = np.array([np.sin(yaw) * np.cos(pitch), np.cos(yaw) * np.cos(pitch), -np.sin(pitch)])
    return np.stack([right, np.cross(forward, right), forward])


def flight(positions_m: np.ndarray, rng: np.random.Generator, pitch_deg: float = 75.0) -> Cameras:
    """Level cameras at `positions_m` (C,3) with any heading."""
    rotations = [looking(yaw, pitch_deg) for yaw in rng.uniform(0, 360, len(positions_m))]
    poses = np.tile(np.eye(4), (len(positions_m), 1, 1))
    poses[:, :3, :3] = rotations
    poses[:, :3, 3] = -np.einsum("cij,cj->ci", poses[:, :3, :3], positions_m)
    K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    names = tuple(f"{index:03d}.jpg" for index in range(len(poses)))
    return Cameras(names=names, Ks=np.tile(K, (len(poses), 1, 1)), cam_from_world=poses, sizes_wh=np.tile(SIZE_WH, (len(poses), 1)))


def ground(rng: np.random.Generator) -> np.ndarray:
    """Points of a nearly flat site (P,3) with some houses."""
    points = rng.uniform(-60, 60, (400, 3)) * (1, 1, 0.005)
    points[:60, 2] += rng.uniform(0, 12, 60)
    return points


def model_of(cameras: Cameras, points: np.ndarray) -> ColmapModel:
    """All cameras see all points."""
    images = []
    for index, pose in enumerate(cameras.cam_from_world):
        x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
        images.append(
            ColmapImage(
                image_id=index + 1,
                name=cameras.names[index],
                camera_id=1,
                quat_wxyz=np.array([w, x, y, z]),
                translation=pose[:3, 3],
                points2d=np.zeros((len(points), 2)),
                point3d_ids=np.arange(len(points)),
            )
        )
    point, image = (axis.ravel() for axis in np.meshgrid(np.arange(len(points)), np.arange(len(images)), indexing="ij"))
    sparse = ColmapPoints(
        ids=np.arange(len(points)),
        xyz=points,
        colors=np.zeros((len(points), 3), np.uint8),
        errors_px=np.zeros(len(points)),
        tracks=np.stack([point, image + 1, point], axis=1),
    )
    camera = ColmapCamera(camera_id=1, model="PINHOLE", size_wh=SIZE_WH, params=(500.0, 500.0, 320.0, 240.0))
    return ColmapModel(cameras={1: camera}, images=tuple(images), points=sparse)


def photographs_at(names: tuple[str, ...], positions_m: np.ndarray | None) -> tuple[Photograph, ...]:
    key = CameraKey(make="", model="", focal_mm=None, size_wh=SIZE_WH)
    photos = []
    for index, name in enumerate(names):
        place = None
        if positions_m is not None and np.isfinite(positions_m[index]).all():
            east, north, up = positions_m[index]
            place = (ORIGIN[0] + north * DEGREES_PER_M[0], ORIGIN[1] + east * DEGREES_PER_M[1], ORIGIN[2] + up)
        photos.append(Photograph(name=name, path=Path(name), size_wh=SIZE_WH, lat_lon_alt=place, camera=key))
    return tuple(photos)


def metres_of(photos: tuple[Photograph, ...], origin: np.ndarray) -> np.ndarray:
    return enu_from_geodetic([photo.lat_lon_alt or (0, 0, 0) for photo in photos], origin)


def in_any_frame(cameras: Cameras, points: np.ndarray, rng: np.random.Generator) -> ColmapModel:
    rotation = Rotation.from_quat(rng.normal(size=4)).as_matrix()
    move = Sim3(scale=0.07, rotation=rotation, translation=rng.normal(scale=3, size=3))
    turned = Cameras(
        names=cameras.names, Ks=cameras.Ks, cam_from_world=move.apply_to_poses(cameras.cam_from_world), sizes_wh=cameras.sizes_wh
    )
    return model_of(turned, move.apply(points))


def in_world(
    model: ColmapModel, photos: tuple[Photograph, ...], placement: Placement | None = None
) -> tuple[SfmScene, tuple[Decision, ...], tuple[str, ...]]:
    placed = scene_in_world(model, photos, 0, placement or Placement())
    return placed.scene, placed.decisions, placed.warnings


def grid(rng: np.random.Generator, count: int = 30) -> np.ndarray:
    return np.column_stack([rng.uniform(-50, 50, (count, 2)), rng.uniform(38, 42, count)])


@pytest.mark.parametrize("seed", range(5))
def test_with_gps_the_scene_comes_back_in_metres_whatever_frame_it_was_in(seed: int) -> None:
    rng = np.random.default_rng(seed)
    names = tuple(f"{index:03d}.jpg" for index in range(30))
    photos = photographs_at(names, grid(rng))
    cameras, points = flight(metres_of(photos, ORIGIN), rng), ground(rng)
    scene, decisions, warnings = in_world(in_any_frame(cameras, points, rng), photos)
    assert (scene.frame.kind, warnings) == ("metric", ())
    expected = metres_of(photos, scene.frame.origin_lat_lon_alt)
    # 1e-6 m: positions went through degrees (1e-9 m) and a fit of exact pairs.
    assert np.abs(scene.cameras.centers - expected).max() < 1e-6
    assert scene.frame.residual_m is not None
    assert scene.frame.residual_m < 1e-6
    assert decisions[0].choice == "metric, from GPS"


def test_projections_do_not_change_with_the_frame() -> None:
    rng = np.random.default_rng(1)
    positions_m = grid(rng)
    model = in_any_frame(flight(positions_m, rng), ground(rng), rng)
    before = cameras_of(model)
    scene, _, _ = in_world(model, photographs_at(before.names, positions_m))

    def rays(cameras: Cameras, points: np.ndarray) -> np.ndarray:
        in_camera = np.einsum("cij,pj->cpi", cameras.cam_from_world[:, :3, :3], points) + cameras.cam_from_world[:, None, :3, 3]
        return in_camera[..., :2] / in_camera[..., 2:]

    assert np.allclose(rays(before, model.points.xyz), rays(scene.cameras, scene.points), atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_without_gps_z_is_up_the_frame_unscaled_and_the_median_distance_ten_units(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cameras, points = flight(grid(rng), rng), ground(rng)
    scene, decisions, warnings = in_world(in_any_frame(cameras, points, rng), photographs_at(cameras.names, None))
    assert scene.frame.kind == "unscaled"
    assert scene.frame.residual_m is None
    assert any("no metric scale" in warning for warning in warnings)
    assert decisions[-1].choice.startswith("unscaled")
    distances = np.linalg.norm(scene.points[:, None] - scene.cameras.centers[None], axis=2)
    assert np.median(distances) == pytest.approx(MEDIAN_DEPTH_UNITS)
    assert scene.cameras.centers[:, 2].min() > scene.points[:, 2].max()
    heights = np.linalg.lstsq(np.column_stack([scene.points[60:, :2], np.ones(340)]), scene.points[60:, 2], rcond=None)[0]
    # 1°: 60 house points of 400 and 0.3 m of bumps over 120 m tilt the fitted ground by a few
    # tenths of a degree.
    assert np.degrees(np.arctan(np.linalg.norm(heights[:2]))) < 1.0


@pytest.mark.parametrize("pitch_deg", [0.0, 30.0, 90.0])
def test_up_is_found_for_street_oblique_and_nadir_photographs(pitch_deg: float) -> None:
    rng = np.random.default_rng(2)
    cameras = flight(grid(rng), rng, pitch_deg)
    estimate = estimate_up(cameras, ground(rng))
    assert np.degrees(np.arccos(np.clip(estimate.up[2], -1, 1))) < 2.0


def test_a_wall_is_not_taken_for_the_ground_when_the_cameras_are_level() -> None:
    rng = np.random.default_rng(3)
    wall = ground(rng)[:, [0, 2, 1]]
    estimate = estimate_up(flight(grid(rng), rng, 0.0), wall)
    assert "ground plane" not in estimate.source
    assert [name for name, _ in estimate.left_out] == ["ground plane"]
    assert estimate.up[2] > 0.999


def test_a_straight_flight_line_keeps_metres_and_takes_up_from_the_ground() -> None:
    rng = np.random.default_rng(4)
    positions_m = np.column_stack([np.linspace(-50, 50, 25), np.linspace(-20, 20, 25), np.full(25, 40.0)])
    cameras, points = flight(positions_m, rng), ground(rng)
    photos = photographs_at(cameras.names, positions_m + rng.normal(scale=0.3, size=(25, 3)))
    scene, decisions, warnings = in_world(in_any_frame(cameras, points, rng), photos)
    assert scene.frame.kind == "metric"
    assert any("on a line" in warning for warning in warnings)
    assert decisions[-1].unit == "deg roll uncertainty"
    # 1.5 m: GPS noise of up to 1 m on one position, and up to 1° of ground estimate over the 40 m
    # from ground to camera.
    assert np.abs(scene.cameras.centers - metres_of(photos, scene.frame.origin_lat_lon_alt)).max() < 1.5
    assert np.ptp(scene.cameras.centers[:, 2]) < 1.5


def test_altitudes_that_drift_by_a_hundred_metres_do_not_tilt_the_world() -> None:
    rng = np.random.default_rng(5)
    positions_m = grid(rng, 60)
    told_m = positions_m + rng.normal(scale=1.0, size=(60, 3)) + np.outer(positions_m[:, 0], [0, 0, 1.0])
    cameras, points = flight(positions_m, rng), ground(rng)
    scene, decisions, warnings = in_world(in_any_frame(cameras, points, rng), photographs_at(cameras.names, told_m))
    assert scene.frame.kind == "metric"
    assert any("altitudes" in warning for warning in warnings)
    assert "roll" in decisions[-1].unit
    # Without the check the drift of 1 m per metre would tilt the scene by 45° and spread the
    # cameras over 70 m of height.
    assert np.ptp(scene.cameras.centers[:, 2]) < 8.0


@pytest.mark.parametrize("case", ["two", "all alike", "nonsense"])
def test_gps_that_cannot_carry_a_frame_gives_an_unscaled_one_and_says_so(case: str) -> None:
    rng = np.random.default_rng(6)
    positions_m = grid(rng)
    cameras, points = flight(positions_m, rng), ground(rng)
    told_m = {
        "all alike": np.full((30, 3), 5.0),
        "nonsense": rng.normal(scale=80, size=(30, 3)),
        "two": np.full((30, 3), np.nan),
    }[case]
    if case == "two":
        told_m[:2] = positions_m[:2]
    scene, _, warnings = in_world(in_any_frame(cameras, points, rng), photographs_at(cameras.names, told_m))
    assert scene.frame.kind == "unscaled"
    assert len(warnings) == 1


@pytest.mark.parametrize("up", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0.6, 0, -0.8), (1e-9, 0, -1)])
def test_the_level_rotation_turns_up_to_z_and_is_a_rotation(up: tuple[float, float, float]) -> None:
    rotation = level_rotation(np.array(up))
    assert np.allclose(rotation @ up / np.linalg.norm(up), (0, 0, 1), atol=1e-7)
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-7)
    assert np.linalg.det(rotation) == pytest.approx(1)


def test_a_level_fit_of_positions_above_each_other_is_none() -> None:
    column = np.outer(np.arange(5.0), [0, 0, 1])
    assert level_fit(column, column, np.array([0.0, 0, 1])) is None
