"""A made-up site that knows its own geometry: hilly ground with coloured patches, and models of
parts of it, each sampled by itself."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from radiant_core.cameras import Cameras
from radiant_core.frames import FrameUncertainty, Sim3
from radiant_core.geometry.frame_refinement import PlacedModel
from radiant_core.geometry.similarity import move_splats
from radiant_core.splats import SH_C0, Splats

CELL_M = 1.0
"""Smooth between random colours, so that how a model samples them matters little."""
STEP_M = 0.18
"""Between the Gaussians of a model; each sample puts them elsewhere."""
GPS_LIKE = FrameUncertainty(position_m=1.7, scale=0.017, rotation_rad=np.radians(1.7))


def heights(x: np.ndarray, y: np.ndarray, seed: int = 0) -> np.ndarray:
    """Metres; hills of 8 to 30 m length."""
    phase = np.random.default_rng(seed).uniform(0, 6, 4)
    hills = 0.8 * np.sin(0.5 * x + phase[0]) * np.cos(0.4 * y + phase[1]) + 0.6 * np.sin(0.21 * x - 0.3 * y + phase[2])
    return hills + 0.5 * np.cos(0.75 * x + phase[3]) * np.sin(0.7 * y)


def ground_model(
    x_range: tuple[float, float], *, place: int = 0, sample: int = 0, colored: bool = True, half_width_m: float = 12.0
) -> Splats:
    """Gaussians of the site `place` within x_range, at points of their own for each `sample`."""
    rng = np.random.default_rng([place, sample, 7])
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(*x_range, STEP_M), np.arange(-half_width_m, half_width_m, STEP_M)))
    x, y = x + rng.uniform(-0.4, 0.4, len(x)) * STEP_M, y + rng.uniform(-0.4, 0.4, len(y)) * STEP_M
    count = len(x)
    palette = np.random.default_rng([place, 3]).uniform(-0.3, 1.3, (97, 89, 3))
    at = np.stack([x / CELL_M, y / CELL_M])
    rgb = np.stack([map_coordinates(palette[..., c], at, order=3, mode="grid-wrap") for c in range(3)], axis=1).clip(0.02, 0.98)
    rgb = rgb if colored else np.full((count, 3), 0.5)
    return Splats(
        means=np.column_stack([x, y, heights(x, y, place)]),
        quats=np.tile([1.0, 0, 0, 0], (count, 1)),
        log_scales=np.tile(np.log([0.7 * STEP_M, 0.7 * STEP_M, 0.3 * STEP_M]), (count, 1)),
        logit_opacities=np.full(count, 3.0),
        sh0=((rgb - 0.5) / SH_C0)[:, None],
        shN=np.zeros((count, 3, 3)),
    )


def cameras_over(x_range: tuple[float, float], *, half_width_m: float = 12.0, height_m: float = 16.0) -> Cameras:
    """Cameras 6 m apart looking down, tilted by up to 12°, 200 px wide."""
    rng = np.random.default_rng(int(1000 + x_range[0]))
    poses, names = [], []
    for x in np.arange(x_range[0] + 5, x_range[1] - 4, 6.0):
        for y in np.arange(-half_width_m + 5, half_width_m - 4, 6.0):
            tilt = Rotation.from_rotvec(np.radians(rng.uniform(-12, 12, 3) * (1, 1, 5))).as_matrix()
            rotation = tilt @ np.diag([1.0, -1.0, -1.0])
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = rotation, -rotation @ [x, y, height_m + rng.uniform(-1, 1)]
            poses.append(pose)
            names.append(f"{x_range[0]:+.0f}_{x:+.1f}_{y:+.1f}.jpg")
    K = [[170.0, 0, 100], [0, 170, 75], [0, 0, 1]]
    return Cameras(names=tuple(names), Ks=[K] * len(poses), cam_from_world=poses, sizes_wh=[(200, 150)] * len(poses))


def moved_model(splats: Splats, cameras: Cameras, move: Sim3, uncertainty: FrameUncertainty = GPS_LIKE) -> PlacedModel:
    """A model and its cameras put elsewhere by `move`, whatever its uncertainty says."""
    poses = move.apply_to_poses(cameras.cam_from_world)
    placed = Cameras(names=cameras.names, Ks=cameras.Ks, cam_from_world=poses, sizes_wh=cameras.sizes_wh)
    return PlacedModel(splats=move_splats(splats, move), cameras=placed, uncertainty=uncertainty)


def move_about(
    center: np.ndarray, *, shift_m: tuple[float, float, float] = (0, 0, 0), turn_deg: tuple = (0, 0, 0), scale: float = 1.0
) -> Sim3:
    """Turn and grow about `center`, then shift."""
    rotation = Rotation.from_rotvec(np.radians(turn_deg)).as_matrix()
    return Sim3(scale=scale, rotation=rotation, translation=center + shift_m - scale * rotation @ center)


def gps_like_move(center: np.ndarray, seed: int, shift_m: float = 3.0) -> Sim3:
    """Scale ±3 %, rotation ±3° about any axis, shift ±3 m per axis."""
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    turn = axis / np.linalg.norm(axis) * rng.uniform(-3, 3)
    return move_about(center, shift_m=tuple(rng.uniform(-shift_m, shift_m, 3)), turn_deg=tuple(turn), scale=1 + rng.uniform(-0.03, 0.03))
