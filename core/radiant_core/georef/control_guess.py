"""Where a point of ground control should be in photographs, before it is marked there.

With two marks or more the point is where their rays meet, X = (Σ I − d dᵀ)⁻¹ Σ (I − d dᵀ) c; else
where the survey has it. Once per point and mark.

Places in pictures are shares of width and height: cameras are those of the undistorted photographs,
marks are made in the stored ones, and what a lens bends is left out. It is a guess.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core.cameras import Cameras
from radiant_core.numerics import FloatArray, check_array

MIN_ANGLE_DEG = 1.0


def guess_place(cameras: Cameras, rows: NDArray[np.int64], shares: ArrayLike, surveyed: ArrayLike) -> FloatArray:
    """A point (3,) of the world from its marks in the cameras of M rows, shares (M,2) of their
    pictures; with fewer than two, or rays within a degree of each other, the place `surveyed` (3,),
    which may be NaN."""
    shares = check_array("shares", shares, (len(rows), 2))
    if len(rows) < 2:
        return np.asarray(surveyed, np.float64)
    pixels = np.column_stack([shares * cameras.sizes_wh[rows], np.ones(len(rows))])
    local = np.linalg.solve(cameras.Ks[rows], pixels[:, :, None])
    rays = (cameras.cam_from_world[rows, :3, :3].transpose(0, 2, 1) @ local)[:, :, 0]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    normal = across.sum(axis=0)
    if np.linalg.eigvalsh(normal)[0] <= np.sin(np.radians(MIN_ANGLE_DEG)) ** 2:
        return np.asarray(surveyed, np.float64)
    return np.linalg.solve(normal, np.einsum("mij,mj->i", across, cameras.centers[rows]))


def shares_of(cameras: Cameras, place: ArrayLike) -> FloatArray:
    """Shares (C,2) of width and height at which C cameras see a point (3,); NaN where it is outside
    of the picture, behind the camera, or not known."""
    place = np.asarray(place, np.float64)
    local = cameras.cam_from_world[:, :3, :3] @ place + cameras.cam_from_world[:, :3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = np.einsum("cij,cj->ci", cameras.Ks, local)[:, :2] / local[:, 2:]
        shares = pixels / cameras.sizes_wh
        is_visible = (local[:, 2] > 0) & ((shares > 0) & (shares < 1)).all(axis=1)
    return np.where(is_visible[:, None], shares, np.nan)
