"""Virtual cameras: the cloud's views of an edge's model, which hide the devices'. Once per edge.

    centre ← centre + r u,  r ≤ 2 % of the camera's median distance to the model
    rotation ← turn by at most 1° about u'

They come in a random order under names of their own, with one size and pinhole, so that nothing
tells which device took a picture. Not hidden: their number, and roughly where photographs were
taken.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray

MAX_MOVE = 0.02
"""As a share of the median distance to the Gaussians: beyond it a teacher would be guessing."""
MAX_TURN_DEG = 1.0
MAX_DISTANCES = 10_000
"""Gaussians that a median distance is taken over, evenly among all."""


def virtual_cameras(cameras: Cameras, means: NDArray[np.floating], rng: np.random.Generator) -> Cameras:
    """A virtual camera per camera (C), in random order, for a model of means (N,3) m.

    `rng` must be seeded by what is hidden from the cloud. Size and focal length are those of the
    camera with the median angle of view. Raises BadInput without cameras or Gaussians.
    """
    count = len(cameras)
    if not count or not len(means):
        raise BadInput(f"{count} cameras of a model of {len(means)} Gaussians: virtual cameras need at least one of either.")
    some = np.asarray(means, np.float64)[np.unique(np.linspace(0, len(means) - 1, MAX_DISTANCES).astype(np.int64))]
    order = rng.permutation(count)
    poses = cameras.cam_from_world[order].copy()
    distances = np.array([np.median(np.linalg.norm(some - center, axis=1)) for center in cameras.centers[order]])
    moved = cameras.centers[order] + _inside_ball(count, rng) * (MAX_MOVE * distances)[:, None]
    turns = Rotation.from_rotvec(_inside_ball(count, rng) * np.radians(MAX_TURN_DEG)).as_matrix()
    poses[:, :3, :3] = turns @ poses[:, :3, :3]
    poses[:, :3, 3] = -np.einsum("cij,cj->ci", poses[:, :3, :3], moved)
    size_wh, K = _common_pinhole(cameras)
    return Cameras(
        names=tuple(f"view-{number:016x}" for number in rng.integers(2**63, size=count)),
        Ks=np.tile(K, (count, 1, 1)),
        cam_from_world=poses,
        sizes_wh=np.tile(size_wh, (count, 1)),
    )


def _inside_ball(count: int, rng: np.random.Generator) -> FloatArray:
    """Points (count,3) spread evenly over the unit ball."""
    directions = rng.standard_normal((count, 3))
    directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-12)
    return directions * rng.random((count, 1)) ** (1 / 3)


def _common_pinhole(cameras: Cameras) -> tuple[NDArray[np.int64], FloatArray]:
    """Size (2,) px and K (3,3), centred, of the camera with the median focal length over side."""
    relative = cameras.Ks[:, 0, 0] / cameras.sizes_wh.max(axis=1)
    chosen = int(np.argsort(relative, kind="stable")[len(relative) // 2])
    size_wh, focal_px = cameras.sizes_wh[chosen], cameras.Ks[chosen, 0, 0]
    return size_wh, np.array([[focal_px, 0, size_wh[0] / 2], [0, focal_px, size_wh[1] / 2], [0, 0, 1]])
