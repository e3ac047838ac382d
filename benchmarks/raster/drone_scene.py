"""Synthetic models for measuring rasterizers: Gaussians on bumpy terrain with boxes, from a drone.

z(x, y) = Σ a sin(kx x + φ) sin(ky y + ψ), plus boxes. Gaussians are uniform over the ground, flat,
as wide as their spacing, of all opacities. The ground is cut so that 84 % of them are in the
frustum. Drawn once per size from a fixed seed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from radiant_core.cameras import Cameras
from radiant_core.numerics import FloatArray
from radiant_core.splats import SH_C0, Splats

SHARE_IN_FRUSTUM = 0.84
_HEIGHT_M, _PITCH_DEG, _NUM_BOXES = 60.0, 20.0, 40
_WAVES = ((1.5, 0.11, 0.07), (0.6, 0.31, 0.23), (0.2, 0.9, 1.1))
"""Amplitude in metres, angular frequencies in 1/m of x and y."""


@dataclass(frozen=True, kw_only=True)
class SceneSize:
    """Number of Gaussians and size of the image in px."""

    num_splats: int
    width: int
    height: int


SIZES = {
    "S": SceneSize(num_splats=20_000, width=320, height=240),
    "M": SceneSize(num_splats=100_000, width=576, height=432),
    "L": SceneSize(num_splats=500_000, width=1152, height=864),
}


def drone_scene(size: SceneSize, seed: int = 0) -> tuple[Splats, Cameras]:
    """The model in random order and its one camera."""
    rng = np.random.default_rng(seed)
    cameras = drone_camera(size)
    # Uniform over a square whose side is three times the height; those farthest from the image
    # centre are cut until 84 % are inside.
    places = rng.uniform(-1.5 * _HEIGHT_M, 1.5 * _HEIGHT_M, (8 * size.num_splats, 2))
    boxes = rng.uniform([-60, -60, 4, 4, 3], [60, 60, 14, 14, 12], (_NUM_BOXES, 5))
    heights, normals = _surface(places, boxes, rng)
    points = np.column_stack([places, heights])
    excess = _excess(points, cameras)
    inside = np.flatnonzero(excess <= 1)[: round(SHARE_IN_FRUSTUM * size.num_splats)]
    outside = np.flatnonzero(excess > 1)
    outside = outside[np.argsort(excess[outside])][: size.num_splats - len(inside)]
    # Those inside are a random subset, whose spacing sets the width.
    spacing_m = np.sqrt((3 * _HEIGHT_M) ** 2 / len(places) * np.count_nonzero(excess <= 1) / len(inside))
    chosen = rng.permutation(np.concatenate([inside, outside]))
    return _splats(points[chosen], normals[chosen], spacing_m, rng), cameras


def drone_camera(size: SceneSize) -> Cameras:
    """A camera 60 m above the ground, tilted 20° from straight down."""
    cam_from_world = np.eye(4)
    # Looking down (z of the camera along −z of the world), tilted forward.
    down = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
    cam_from_world[:3, :3] = Rotation.from_euler("x", _PITCH_DEG, degrees=True).as_matrix() @ down
    cam_from_world[:3, 3] = -cam_from_world[:3, :3] @ np.array([0, -_HEIGHT_M * np.tan(np.radians(_PITCH_DEG)), _HEIGHT_M])
    focal_px = 0.9 * size.width
    K = [[focal_px, 0, size.width / 2], [0, focal_px, size.height / 2], [0, 0, 1]]
    return Cameras(
        names=("drone",),
        Ks=np.array([K]),
        cam_from_world=cam_from_world[None],
        sizes_wh=np.array([[size.width, size.height]], dtype=np.int64),
    )


def _surface(places: FloatArray, boxes: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Heights (P,) and normals (P,3) on terrain and roofs; one in three of a box on walls."""
    x, y = places.T
    heights, slopes = np.zeros(len(places)), np.zeros((len(places), 2))
    for amplitude, along_x, along_y in _WAVES:
        heights += amplitude * np.sin(along_x * x) * np.sin(along_y * y + 1)
        slopes[:, 0] += amplitude * along_x * np.cos(along_x * x) * np.sin(along_y * y + 1)
        slopes[:, 1] += amplitude * along_y * np.sin(along_x * x) * np.cos(along_y * y + 1)
    normals = np.column_stack([-slopes, np.ones(len(places))])
    for left, bottom, width, depth, height in boxes:
        within = (x > left) & (x < left + width) & (y > bottom) & (y < bottom + depth)
        heights[within] += height
        normals[within] = [0, 0, 1]
        wall = within & (rng.random(len(places)) < 1 / 3)
        heights[wall] -= height * rng.random(np.count_nonzero(wall))
        normals[wall] = [1, 0, 0]
    return heights, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def _excess(points: FloatArray, cameras: Cameras) -> FloatArray:
    """Distance (P,) from the image centre, 1 at the image border."""
    pose, K, (width, height) = cameras.cam_from_world[0], cameras.Ks[0], cameras.sizes_wh[0]
    inside = points @ pose[:3, :3].T + pose[:3, 3]
    pixels = inside[:, :2] / inside[:, 2:] * K[0, 0]
    return np.maximum(np.abs(pixels[:, 0]) / (width / 2), np.abs(pixels[:, 1]) / (height / 2))


def _splats(points: FloatArray, normals: FloatArray, spacing_m: float, rng: np.random.Generator) -> Splats:
    count = len(points)
    # The rotation that takes z to the normal, after a turn about z.
    turn = Rotation.from_rotvec(rng.uniform(0, 2 * np.pi, (count, 1)) * [0.0, 0.0, 1.0])
    axes = np.cross([0.0, 0.0, 1.0], normals)
    sines = np.linalg.norm(axes, axis=1)
    tilt = Rotation.from_rotvec(axes / np.maximum(sines, 1e-9)[:, None] * np.arctan2(sines, normals[:, 2])[:, None])
    xyzw = (tilt * turn).as_quat()
    scales = spacing_m * 0.7 * np.exp(rng.normal(0, 0.4, (count, 3))) * [1, 1, 0.2]
    color = 0.5 + 0.3 * np.sin(points * [0.4, 0.3, 0.9] + [0, 2, 4]) + rng.normal(0, 0.08, (count, 3))
    arrays = {
        "means": points,
        "quats": xyzw[:, [3, 0, 1, 2]],
        "log_scales": np.log(scales),
        "logit_opacities": rng.normal(1.0, 1.5, count),
        "sh0": ((color - 0.5) / SH_C0)[:, None],
        "shN": rng.normal(0, 0.05, (count, 15, 3)),
    }
    return Splats(**{name: array.astype(np.float32) for name, array in arrays.items()})
