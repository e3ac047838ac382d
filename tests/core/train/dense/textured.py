"""Photographs of a textured step of known heights from cameras above it."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.frames import Frame
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene
from radiant_core.train.views import TrainingViews
from tests.core.scenes import cameras_above

SIZE_WH = (120, 90)
HEIGHT_M = 6.0
GRID = [(x, y) for y in (-0.8, 0.0, 0.8) for x in (-0.8, 0.0, 0.8)]
TEXELS_PER_M = 12


def texture(seed: int = 0) -> NDArray[np.uint8]:
    """Smooth random colours (480,480,3) of 40 × 40 m about the origin."""
    noise = np.random.default_rng(seed).normal(size=(480, 480, 3)).astype(np.float32)
    soft = cv2.GaussianBlur(noise, (0, 0), 1.2)
    return np.clip(128 + 45 * soft / soft.std(), 0, 255).astype(np.uint8)


def step_height(xy: FloatArray, height_m: float, half_side_m: float = 1.0) -> FloatArray:
    """The height (…) of a square step in the middle at places (…,2)."""
    return np.where((np.abs(xy) < half_side_m).all(axis=-1), height_m, 0.0)


def surface_of(cameras: Cameras, index: int, height_m: float) -> FloatArray:
    """What each pixel of a camera sees (H,W,3): the step, or the ground around it."""
    width, height = cameras.sizes_wh[index]
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(cameras.Ks[index]).T @ cameras.cam_from_world[index, :3, :3]
    center = cameras.centers[index]
    top = center + rays * ((height_m - center[2]) / rays[..., 2])[..., None]
    ground = center + rays * (-center[2] / rays[..., 2])[..., None]
    return np.where((step_height(top[..., :2], height_m) > 0)[..., None], top, ground)


def step_scene(height_m: float = 0.0, *, seed: int = 0, num_points: int = 150) -> tuple[SfmScene, TrainingViews]:
    """Nine photographs of the step, or of a plane, and sparse points on it that all of them see."""
    cameras = cameras_above(GRID, height_m=HEIGHT_M, size_wh=SIZE_WH)
    colors = texture(seed)
    images = []
    for index in range(len(cameras)):
        places = (surface_of(cameras, index, height_m)[..., :2] * TEXELS_PER_M + 240).astype(np.float32)
        images.append(cv2.remap(colors, places[..., 0], places[..., 1], cv2.INTER_LINEAR))
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-2.2, 2.2, (num_points, 2))
    points = np.column_stack([xy, step_height(xy, height_m)])
    observations = np.array([(point, camera) for point in range(num_points) for camera in range(len(cameras))]).reshape(-1, 2)
    frame = Frame(kind="metric", origin_lat_lon_alt=np.zeros(3))
    scene = SfmScene(cameras=cameras, points=points, colors=np.full((num_points, 3), 99, np.uint8), observations=observations, frame=frame)
    return scene, TrainingViews(cameras=cameras, images=tuple(images))
