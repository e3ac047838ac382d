"""Where the photographs were taken from, with small errors of their own.

    survey  a drone's lawn-mower flight of nadir photographs, then obliques from a ring
    orbit   two rings around the block in the middle, looking at it from all sides
    street  a walk along the street in the middle at the height of a head, looking ahead and aside
    facade  passes along the fronts of three houses (`facade.py`)
    room    from places inside a furnished room, outwards (`room.py`)
    turntable  rounds of a still camera's pictures of a house that turns (`turntable.py`)

Once per scene. Of a survey, n nadir photographs over width x height make round(√(n · 3/4 · height /
width)) rows, so that spacing along : across = 3 : 4, as the image's sides; at 60 photographs over
120 x 80 m neighbours share 78 % along and across. GPS positions are the true ones moved by at most
`gps_error_m` in a random direction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenegen.config import SceneConfig
from scenegen.facade import facade_views
from scenegen.layout import BLOCK_U_M, BLOCK_V_M, Layout
from scenegen.room import room_views
from scenegen.turntable import TARGET_M, turntable_centers

SECONDS_PER_PHOTO = 2.0
IN_A_ROW, SECOND_CAMERA_EV = 3, 0.4
"""Cameras take so many photographs by turns; the second one's are brighter by so many stops."""
ORBIT_HEIGHTS_M = (9.0, 17.0)
EYE_HEIGHT_M = 1.8
STREET_TURNS_DEG = (0.0, 45.0, -45.0, 20.0, -20.0)
OBLIQUE_PITCHES_DEG = (48.0, 25.0, 40.0, 33.0)
GOLDEN = 0.6180339887498949


@dataclass(frozen=True, kw_only=True)
class Shot:
    """One photograph's name, cam_from_world (4,4), GPS position (3,) m east-north-up, time s,
    exposure in stops, camera and shake."""

    name: str
    cam_from_world: NDArray[np.float64]
    gps_position_m: NDArray[np.float64]
    time_s: float
    exposure_ev: float
    camera: int = 0
    """Which of the scene's cameras took it."""
    shake_px: tuple[float, float] = (0.0, 0.0)
    """How far the picture moved while the shutter was open."""

    @property
    def center_m(self) -> NDArray[np.float64]:
        """The camera's true centre (3,) in the world."""
        return -self.cam_from_world[:3, :3].T @ self.cam_from_world[:3, 3]


def survey_lines(config: SceneConfig) -> tuple[int, int]:
    """How many rows a survey flies, and how many nadir photographs it takes on them."""
    count = config.num_cameras - round(config.num_cameras * config.oblique_fraction)
    width, height = config.extent_m
    return min(count, max(1, round(np.sqrt(count * 0.75 * height / width)))), count


def plan_flight(config: SceneConfig) -> list[Shot]:
    """The photographs of one flight, in the order they were taken."""
    rng = np.random.default_rng([config.seed, 1] if config.date == 0 else [config.seed, 1, config.date])
    poses = _POSES[config.flight](config, rng)
    errors = _gps_errors(config, rng)
    drift, shakes = _exposures_ev(config), _shakes_px(config)
    return [
        Shot(
            name=f"drone_{k:04d}.jpg",
            cam_from_world=pose,
            gps_position_m=-pose[:3, :3].T @ pose[:3, 3] + errors[k],
            time_s=k * SECONDS_PER_PHOTO,
            exposure_ev=float(drift[k]) + SECOND_CAMERA_EV * (k // IN_A_ROW % config.num_lenses),
            camera=k // IN_A_ROW % config.num_lenses,
            shake_px=shakes[k],
        )
        for k, pose in enumerate(poses)
    ]


def look_pose(center: NDArray, forward: NDArray, up: NDArray) -> NDArray[np.float64]:
    """cam_from_world (4,4), OpenCV axes, of a camera at center (3,) looking along forward with its
    top towards up."""
    z = forward / np.linalg.norm(forward)
    x = np.cross(z, up)
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ center
    return pose


def _survey_poses(config: SceneConfig, rng: np.random.Generator) -> list[NDArray[np.float64]]:
    num_nadir = survey_lines(config)[1]
    return _nadir_poses(config, rng) + _oblique_poses(config, config.num_cameras - num_nadir, rng)


def _orbit_poses(config: SceneConfig, rng: np.random.Generator) -> list[NDArray[np.float64]]:
    """Over the four streets around the block in the middle, from two heights in turn."""
    layout = Layout(extent_m=config.extent_m, seed=config.seed)
    middle = layout.world_from_town(BLOCK_U_M / 2, BLOCK_V_M / 2)
    target = np.array([*middle, float(layout.height_m(*np.array(middle)[:, None])[0]) + 2.0])
    poses = []
    for k in range(config.num_cameras):
        angle = 2.0 * np.pi * (k + rng.uniform(-0.2, 0.2)) / config.num_cameras
        place = layout.world_from_town(BLOCK_U_M * (0.5 + 0.52 * np.cos(angle)), BLOCK_V_M * (0.5 + 0.52 * np.sin(angle)))
        center = np.array([*place, target[2] + ORBIT_HEIGHTS_M[k % 2] + rng.uniform(-0.5, 0.5)])
        poses.append(look_pose(center, target + rng.uniform(-1.0, 1.0, 3) - center, np.array([0.0, 0.0, 1.0])))
    return poses


def _street_poses(config: SceneConfig, rng: np.random.Generator) -> list[NDArray[np.float64]]:
    """Along the width of the area, by turns ahead and to either side."""
    layout = Layout(extent_m=config.extent_m, seed=config.seed)
    poses = []
    for k in range(config.num_cameras):
        u, v = ((k + 0.5) / config.num_cameras - 0.5) * config.extent_m[0], rng.uniform(-1.0, 1.0)
        x, y = layout.world_from_town(u, v)
        z = float(layout.height_m(np.array([x]), np.array([y]))[0]) + EYE_HEIGHT_M + rng.uniform(-0.1, 0.1)
        heading = layout.heading_rad(u, v) + np.deg2rad(STREET_TURNS_DEG[k % len(STREET_TURNS_DEG)] + rng.uniform(-4.0, 4.0))
        forward = np.array([np.cos(heading), np.sin(heading), rng.uniform(-0.05, 0.12)])
        poses.append(look_pose(np.array([x, y, z]), forward, np.array([0.0, 0.0, 1.0])))
    return poses


def _turntable_poses(config: SceneConfig, rng: np.random.Generator) -> list[NDArray[np.float64]]:
    del rng
    return [look_pose(center, TARGET_M - center, np.array([0.0, 0.0, 1.0])) for center in turntable_centers(config)]


def _facade_poses(config: SceneConfig, rng: np.random.Generator) -> list[NDArray[np.float64]]:
    return [look_pose(center, forward, np.array([0.0, 0.0, 1.0])) for center, forward in facade_views(config, rng)]


def _room_poses(config: SceneConfig, rng: np.random.Generator) -> list[NDArray[np.float64]]:
    return [look_pose(center, forward, np.array([0.0, 0.0, 1.0])) for center, forward in room_views(config, rng)]


def _nadir_poses(config: SceneConfig, rng: np.random.Generator) -> list[NDArray[np.float64]]:
    """Rows along x, flown to and fro; the image's top points along the flight, tilted by a few
    degrees."""
    width, height = config.extent_m
    num_rows, count = survey_lines(config)
    poses = []
    for row in range(num_rows):
        in_row = count // num_rows + (row < count % num_rows)
        sense = 1.0 if row % 2 == 0 else -1.0
        for k in range(in_row):
            x = sense * ((k + 0.5) / in_row - 0.5) * width + rng.uniform(-0.8, 0.8)
            y = ((row + 0.5) / num_rows - 0.5) * height + rng.uniform(-0.8, 0.8)
            z = config.altitude_m + rng.uniform(-2.0, 2.0)
            tilt = np.tan(np.deg2rad(rng.uniform(-6.0, 6.0, 2)))
            flight = np.array([sense, rng.uniform(-0.06, 0.06), 0.0])
            poses.append(look_pose(np.array([x, y, z]), np.array([tilt[0], tilt[1], -1.0]), flight))
    return poses


def _oblique_poses(config: SceneConfig, count: int, rng: np.random.Generator) -> list[NDArray[np.float64]]:
    """Around the area, looking inwards; every fourth is flat enough to see the horizon."""
    half = np.array(config.extent_m) / 2.0
    poses = []
    for k in range(count):
        angle = 2.0 * np.pi * (k + 0.25) / count
        outward = np.array([np.cos(angle), np.sin(angle)])
        radius = 1.1 - 0.35 * ((k * GOLDEN) % 1.0)
        center = np.array([*(outward * half * radius), config.altitude_m * rng.uniform(0.80, 0.95)])
        inward = -outward * half / np.linalg.norm(outward * half)
        turn = rng.uniform(-0.25, 0.25)
        heading = np.array([inward[0] - turn * inward[1], inward[1] + turn * inward[0]])
        pitch = np.deg2rad(OBLIQUE_PITCHES_DEG[k % len(OBLIQUE_PITCHES_DEG)] + rng.uniform(-1.5, 1.5))
        forward = np.array([*(heading / np.linalg.norm(heading) * np.cos(pitch)), -np.sin(pitch)])
        poses.append(look_pose(center, forward, np.array([0.0, 0.0, 1.0])))
    return poses


def _gps_errors(config: SceneConfig, rng: np.random.Generator) -> NDArray[np.float64]:
    """Uniform in a ball of radius gps_error_m (C,3)."""
    direction = rng.normal(size=(config.num_cameras, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return direction * config.gps_error_m * np.cbrt(rng.uniform(size=(config.num_cameras, 1)))


def _exposures_ev(config: SceneConfig) -> NDArray[np.float64]:
    """A slow wave over the flight (C,), of amplitude exposure_drift_ev; the next date's is half a
    wave ahead."""
    phase = np.arange(config.num_cameras) / config.num_cameras
    return config.exposure_drift_ev * np.sin(2.0 * np.pi * (1.5 * phase + 0.1 + 0.5 * config.date))


def _shakes_px(config: SceneConfig) -> list[tuple[float, float]]:
    """How far each picture moves (C), some 1.5 % of its width in the shaken ones."""
    rng = np.random.default_rng([config.seed, 5])
    shaken = rng.permutation(config.num_cameras) < round(config.shaken_share * config.num_cameras)
    angles = rng.uniform(0.0, 2.0 * np.pi, config.num_cameras)
    lengths = shaken * rng.uniform(0.01, 0.02, config.num_cameras) * config.width_px
    return [(float(length * np.cos(angle)), float(length * np.sin(angle))) for length, angle in zip(lengths, angles, strict=True)]


_POSES = {
    "survey": _survey_poses, "orbit": _orbit_poses, "street": _street_poses,
    "facade": _facade_poses, "room": _room_poses, "turntable": _turntable_poses,
}  # fmt: skip
