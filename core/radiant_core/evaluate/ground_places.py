"""Where on the ground a camera's pixels lie, by their depths. Once per image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.numerics import FloatArray


def ground_places(cameras: Cameras, index: int, depth_m: NDArray[np.floating]) -> FloatArray:
    """Horizontal place (H,W,2) m of what each pixel of one camera sees at depths (H,W) m along its
    z axis, NaN where there is none."""
    depth = depth_or_nan(depth_m)
    return cameras.centers[index, :2] + horizontal_rays(cameras, index, depth.shape) * depth[..., None]


def depth_or_nan(depth_m: NDArray[np.floating]) -> FloatArray:
    """Depths (H,W) m, NaN where there is none."""
    return np.where(np.isfinite(depth_m) & (depth_m > 0), depth_m, np.nan).astype(np.float64)


def horizontal_rays(cameras: Cameras, index: int, shape: tuple[int, ...]) -> FloatArray:
    """Horizontal move (H,W,2) per unit of depth along the ray of each pixel."""
    height, width = shape
    K, pose = cameras.Ks[index], cameras.cam_from_world[index]
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return np.stack([(columns - K[0, 2]) / K[0, 0], (rows - K[1, 2]) / K[1, 1], np.ones_like(columns)], axis=2) @ pose[:3, :2]
