"""Up without GPS: made-up scenes of every way to photograph, turned at random, and the real sets
against GPS and the horizon."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.frames import Sim3
from radiant_core.geometry.align import robust_sim3
from radiant_core.io.colmap.model import read_model
from radiant_core.io.photos.listing import list_photographs
from radiant_core.numerics import FloatArray
from radiant_core.sfm.colmap.calls import pycolmap
from radiant_core.sfm.colmap.pairs import gps_positions
from radiant_core.sfm.world_frame.up import DOWN, GROUND, UpEstimate, estimate_up
from radiant_core.sfm.world_frame.world import cameras_of, scene_in_world
from tests.core.sfm.test_world import looking

Made = tuple[Cameras, FloatArray]
HORIZON_PX = {
    "img_4092.jpg": ((20, 520), (1124, 274)),
    "img_4120.jpg": ((308, 10), (1124, 113)),
    "img_4154.jpg": ((20, 269), (1124, 426)),
    "img_4242.jpg": ((20, 180), (1124, 379)),
    "img_4264.jpg": ((20, 26), (1116, 241)),
    "img_4344.jpg": ((20, 236), (748, 6)),
}
"""Lewis: two points per photograph between land and sky (column, row), to all sides."""


def posed(positions: FloatArray, yaw_deg: FloatArray | float, pitch_deg: FloatArray | float, roll_deg: FloatArray | float) -> Cameras:
    """Cameras at (C,3); pitch 90 looks straight down, roll 90 is a picture on its side."""
    count = len(positions)
    angles = (np.broadcast_to(angle, count) for angle in (yaw_deg, pitch_deg, roll_deg))
    poses = np.tile(np.eye(4), (count, 1, 1))
    for pose, position, yaw, pitch, roll in zip(poses, positions, *angles, strict=True):
        pose[:3, :3] = Rotation.from_euler("z", roll, degrees=True).as_matrix() @ looking(yaw, pitch)
        pose[:3, 3] = -pose[:3, :3] @ position
    K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    names = tuple(f"{index:03d}.jpg" for index in range(count))
    return Cameras(names=names, Ks=np.tile(K, (count, 1, 1)), cam_from_world=poses, sizes_wh=np.tile((640, 480), (count, 1)))


def lanes(rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Positions (40,3) of a lawn mower flight at 60 m, and its headings."""
    row, column = np.divmod(np.arange(40), 8)
    column = np.where(row % 2, 7 - column, column)
    positions = np.column_stack([14.0 * column - 49, 14.0 * row - 28, np.full(40, 60.0)]) + rng.normal(0, 0.5, (40, 3))
    return positions, np.where(row % 2, 180.0, 0.0)


def ring(radius: float, height: float, count: int = 36) -> tuple[FloatArray, FloatArray]:
    """Positions around the origin and the headings towards it."""
    yaw = np.linspace(0, 360, count, endpoint=False)
    return np.column_stack([-radius * np.sin(np.radians(yaw)), -radius * np.cos(np.radians(yaw)), np.full(count, height)]), yaw


def site(rng: np.random.Generator, slope_deg: float = 0.0) -> FloatArray:
    points = rng.uniform(-80, 80, (600, 3)) * (1, 1, 0.003)
    return points + np.outer(points[:, 0], (0, 0, np.tan(np.radians(slope_deg))))


def hills(rng: np.random.Generator) -> FloatArray:
    points = rng.uniform(-80, 80, (1500, 3))
    points[:, 2] = 12 * np.sin(points[:, 0] / 25) * np.cos(points[:, 1] / 20) + rng.normal(0, 0.3, 1500)
    return points


def box(rng: np.random.Generator, low: tuple[float, float, float], high: tuple[float, float, float], count: int = 500) -> FloatArray:
    """Points in a box, a flat one for a wall or a road, off by some centimetres."""
    return rng.uniform(low, high, (count, 3)) + rng.normal(0, 0.05, (count, 3))


def nadir(rng: np.random.Generator, points: FloatArray | None = None, pitch_deg: float = 90.0, heading: float | None = None) -> Made:
    positions, yaw = lanes(rng)
    yaw = yaw if heading is None else np.full(len(yaw), heading)
    sway = rng.normal(0, 2, (3, len(yaw)))
    return posed(positions, yaw + sway[0], pitch_deg + sway[1], sway[2]), site(rng) if points is None else points


def line(rng: np.random.Generator, heading: float) -> Made:
    """One flight line towards the north, straight down."""
    positions = np.column_stack([rng.normal(0, 0.4, 25), np.linspace(-60, 60, 25), 60 + rng.normal(0, 0.4, 25)])
    sway = rng.normal(0, 2, (3, 25))
    return posed(positions, heading + sway[0], 90 + sway[1], sway[2]), site(rng)


def street(rng: np.random.Generator, *, road: bool, turning: bool = False) -> Made:
    positions = np.column_stack([rng.normal(0, 0.3, 29), np.linspace(0, 60, 29), 1.6 + rng.normal(0, 0.05, 29)])
    walls = np.vstack([box(rng, (-8, 0, 0), (-8, 90, 10)), box(rng, (8, 0, 0), (8, 90, 10), 300)])
    points = np.vstack([walls, box(rng, (-4, 0, 0), (4, 90, 0), 400)]) if road else walls
    yaw = rng.uniform(-70, 70, 29) if turning else rng.normal(0, 4, 29)
    return posed(positions, yaw, rng.normal(0, 2, 29), rng.normal(0, 1, 29)), points


def object_on_a_table(rng: np.random.Generator, height: float, pitch_deg: float, roll_deg: float) -> Made:
    positions, yaw = ring(8, height)
    return posed(positions, yaw + rng.normal(0, 1, 36), pitch_deg, roll_deg + rng.normal(0, 1, 36)), rng.normal(0, 1, (800, 3)) * (
        1,
        1,
        1.6,
    )


def orbit(rng: np.random.Generator) -> Made:
    positions, yaw = ring(60, 40)
    return posed(positions + rng.normal(0, 1, (36, 3)), yaw, 35 + rng.normal(0, 3, 36), rng.normal(0, 2, 36)), hills(rng)


def by_hand(rng: np.random.Generator) -> Made:
    """Handheld around a thing at three heights, not level to within 5°."""
    rings = [ring(8, 1), ring(8, 4), ring(5, 7)]
    positions, yaw = (np.concatenate(parts) for parts in zip(*rings, strict=True))
    pitch = np.repeat([7.0, 27.0, 54.0], 36)
    return posed(positions, yaw, pitch + rng.normal(0, 3, 108), rng.normal(0, 5, 108)), rng.normal(0, 1, (800, 3))


def with_strays(rng: np.random.Generator) -> Made:
    points = site(rng)
    points[:90] = rng.normal(0, 400, (90, 3))
    return nadir(rng, points)


def city(rng: np.random.Generator, heading: float) -> Made:
    """Straight down on facades, whose points are more than those of the streets."""
    walls = [box(rng, (x, -80, 0), (x, 80, 35), 400) for x in (-40, 0, 40)]
    return nadir(rng, np.vstack([*walls, box(rng, (-80, -80, 0), (80, 80, 0), 250)]), heading=heading)


MADE = {
    "nadir over facades": lambda rng: city(rng, 30),
    "nadir, facades square to the pictures": lambda rng: city(rng, 90),
    "nadir": nadir,
    "nadir, one heading": lambda rng: nadir(rng, heading=30),
    "nadir, tilted mount": lambda rng: nadir(rng, pitch_deg=84),
    "nadir over a slope": lambda rng: nadir(rng, site(rng, 12)),
    "nadir over hills": lambda rng: nadir(rng, hills(rng)),
    "nadir, stray points": with_strays,
    "nadir in one line": lambda rng: line(rng, 0),
    "nadir in one line, sideways": lambda rng: line(rng, 90),
    "oblique": lambda rng: nadir(rng, pitch_deg=45),
    "oblique, one heading": lambda rng: nadir(rng, pitch_deg=60, heading=20),
    "orbit over hills": orbit,
    "turntable": lambda rng: object_on_a_table(rng, 2.5, 17, 0),
    "turntable, level": lambda rng: object_on_a_table(rng, 0, 0, 0),
    "turntable, upright pictures": lambda rng: object_on_a_table(rng, 2.5, 17, 90),
    "by hand": by_hand,
    "street": lambda rng: street(rng, road=True),
    "street, walls alone": lambda rng: street(rng, road=False),
    "street, looking about": lambda rng: street(rng, road=True, turning=True),
    "no points": lambda rng: nadir(rng, np.zeros((0, 3))),
    "points in a line": lambda rng: nadir(rng, np.outer(rng.uniform(-50, 50, 200), (1, 0.3, 0.2))),
    "points in one place": lambda rng: nadir(rng, np.ones((200, 3))),
}
IN_DOUBT = {"nadir in one line, sideways", "nadir, facades square to the pictures"}


def turned(made: Made, rotation: FloatArray, scale: float = 0.07) -> Made:
    cameras, points = made
    move = Sim3(scale=scale, rotation=rotation, translation=np.array([3.0, -1.0, 2.0]))
    return replace(cameras, cam_from_world=move.apply_to_poses(cameras.cam_from_world)), move.apply(points)


def any_rotation(seed: int) -> FloatArray:
    return Rotation.from_quat(np.random.default_rng(seed).normal(size=4)).as_matrix()


def angle_deg(a: FloatArray, b: FloatArray) -> float:
    return float(np.degrees(np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1))))


@pytest.mark.parametrize("name", list(MADE))
def test_up_is_found_however_a_scene_was_photographed_and_whatever_frame_it_is_in(name: str) -> None:
    rng = np.random.default_rng(11)
    rotation = any_rotation(5)
    estimate = estimate_up(*turned(MADE[name](rng), rotation))
    error_deg = angle_deg(estimate.up, rotation[:, 2])
    assert error_deg < 3.0
    assert error_deg < 3 * estimate.uncertainty_deg, "it is as sure as it says"
    assert (estimate.doubt is not None) == (name in IN_DOUBT)


def test_the_estimate_turns_with_the_scene() -> None:
    made = nadir(np.random.default_rng(2), hills(np.random.default_rng(3)))
    first = estimate_up(*made)
    for seed in range(5):
        rotation = any_rotation(seed)
        again = estimate_up(*turned(made, rotation))
        # 0.01°: the middle of the points is a median along each axis, so that with the frame a
        # point at the plane's rim comes or goes.
        assert angle_deg(rotation @ first.up, again.up) < 0.01
        assert again.source == first.source


def test_ground_and_path_that_climb_together_against_the_cameras_leave_a_doubt() -> None:
    positions, yaw = lanes(np.random.default_rng(4))
    positions[:, 2] += np.tan(np.radians(12)) * positions[:, 0]
    estimate = estimate_up(posed(positions, yaw, 90.0, 0.0), site(np.random.default_rng(5), 12))
    assert estimate.doubt is not None and "12° away" in estimate.doubt


def test_a_wall_that_was_walked_along_leaves_a_doubt() -> None:
    rng = np.random.default_rng(6)
    positions = np.column_stack([np.linspace(-12, 12, 25), np.full(25, -10.0), 1.6 + rng.normal(0, 0.05, 25)])
    estimate = estimate_up(posed(positions, 0.0, rng.normal(0, 2, 25), 0.0), box(rng, (-15, 0, 0), (15, 0, 9)))
    assert estimate.doubt is not None


def test_a_cue_that_the_scene_does_not_have_cannot_be_asked_for() -> None:
    cameras, points = nadir(np.random.default_rng(7))
    with pytest.raises(BadInput, match=r"ground plane.*19 points"):
        estimate_up(cameras, points[:19], only=(GROUND,))
    assert estimate_up(cameras, points[:19], only=(DOWN,)).source == DOWN


@pytest.mark.parametrize("count", [1, 2, 6])
def test_cameras_in_one_place_without_points_give_an_estimate_in_doubt_or_a_right_one(count: int) -> None:
    here = posed(np.zeros((count, 3)), np.arange(count) * 40.0, 10.0, 0.0)
    estimate = estimate_up(here, np.zeros((0, 3)))
    assert np.linalg.norm(estimate.up) == pytest.approx(1)
    assert estimate.doubt is not None or angle_deg(estimate.up, np.array([0.0, 0, 1])) < 10.0


@cache
def _set(folder: Path, sparse: str) -> tuple[UpEstimate, FloatArray, FloatArray]:
    """The estimate without GPS, up by the robust fit to GPS, and up as the product takes it with
    GPS, in the model's frame."""
    model = read_model(folder / "sparse_undistorted" / sparse)
    photos = list_photographs(folder / "images", lambda done, total: None).photographs
    cameras, by_name = cameras_of(model), {photo.name: photo for photo in photos}
    positions_m, _ = gps_positions(tuple(by_name[name] for name in cameras.names))
    fit = robust_sim3(cameras.centers, positions_m).target_from_source
    assert fit is not None
    placed = scene_in_world(model, photos, 0)
    return estimate_up(cameras, model.points.xyz), fit.rotation[2], placed.world_from_model.rotation[2]


@pytest.mark.parametrize("name", ["brighton", "caliterra", "lewis"])
def test_without_gps_up_is_within_3_degrees_of_what_gps_gives(name: str, data_folder: Path) -> None:
    estimate, _, with_gps = _set(data_folder / name, "0")
    assert angle_deg(estimate.up, with_gps) < 3.0
    assert estimate.doubt is None and estimate.uncertainty_deg < 3.0


def test_the_nadir_flight_agrees_with_its_gps_which_is_good_to_a_third_of_a_metre(data_folder: Path) -> None:
    estimate, by_gps, _ = _set(data_folder / "brighton", "0")
    assert angle_deg(estimate.up, by_gps) < 3.0


def test_the_nadir_flight_whose_gps_is_useless_flew_level_and_looked_down(data_folder: Path) -> None:
    """Heights of caliterra are off by 18 m on a site of 120: the plane through the centres, and the
    mean view, are better references."""
    folder = data_folder / "caliterra"
    estimate, by_gps, _ = _set(folder, "0")
    cameras = cameras_of(read_model(folder / "sparse_undistorted" / "0"))
    flight = np.linalg.svd(cameras.centers - np.median(cameras.centers, axis=0), full_matrices=False)[2][2]
    looks_up = -cameras.cam_from_world[:, 2, :3].mean(axis=0)
    assert angle_deg(estimate.up, flight * np.sign(flight @ looks_up)) < 3.0
    assert angle_deg(estimate.up, looks_up / np.linalg.norm(looks_up)) < 3.0
    assert angle_deg(estimate.up, by_gps) > 20.0, "its altitudes are no reference"


def test_the_horizon_says_that_the_estimate_is_right_where_drifting_altitudes_tilt_gps(data_folder: Path) -> None:
    folder = data_folder / "lewis"
    model = pycolmap.Reconstruction(folder / "sparse" / "0")
    normals = [_horizon(image, HORIZON_PX[image.name]) for image in model.images.values() if image.name in HORIZON_PX]
    assert len(normals) == len(HORIZON_PX)
    horizon = np.mean(normals, axis=0)
    # 2°: haze and treetops at the rim of a photograph move its line by less, and all photographs
    # agree to that.
    assert max(angle_deg(normal, horizon) for normal in normals) < 2.0
    estimate, by_gps, with_gps = _set(folder, "0")
    assert angle_deg(estimate.up, horizon) < 3.0
    assert angle_deg(with_gps, horizon) < 3.0
    assert angle_deg(by_gps, horizon) > 6.0, "the altitudes of this set are off by more than they seem"


def _horizon(image: pycolmap.Image, line_px: tuple[tuple[int, int], tuple[int, int]]) -> FloatArray:
    """Up from the horizon in one photograph: the normal of the plane through its centre and it."""
    assert image.camera is not None
    rays = np.column_stack([np.asarray(image.camera.cam_from_img(np.array(line_px, float))), np.ones(2)])
    normal = np.cross(rays[0], rays[1])
    upward = normal if normal[1] < 0 else -normal
    return upward / np.linalg.norm(upward) @ image.cam_from_world().rotation.matrix()
