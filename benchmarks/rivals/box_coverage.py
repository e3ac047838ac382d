"""The share of an image that a box covers (VastGaussian, Lin 2024). Once per camera and cell.

    share = |hull(π(box ∩ {z ≥ near})) ∩ image| / |image|
The box is cut at the near plane before the division by depth: a corner behind the camera has no
place in the image.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array

NEAR_SHARE = 1e-4
"""The near plane as a share of the box's diagonal: what is cut hides nothing of thicker boxes."""

_CORNERS = np.array(list(product((0, 1), repeat=3)))
_EDGES = np.array([(a, b) for a in range(8) for b in range(a) if np.abs(_CORNERS[a] - _CORNERS[b]).sum() == 1])


def box_coverage(cameras: Cameras, low: ArrayLike, high: ArrayLike) -> FloatArray:
    """Share (C,) in 0..1 of each image that the box from `low` to `high` (3,) m covers, unoccluded.

    0 for a box without extent or behind the camera, 1 where the camera looks through all of it from
    inside. BadInput for a corner that is not finite or below the other one.
    """
    low, high = check_array("low", low, (3,)), check_array("high", high, (3,))
    if (high < low).any():
        raise BadInput(f"the box ends at {high.tolist()}, before it begins at {low.tolist()}: pass low and high in this order.")
    near_m = NEAR_SHARE * float(np.linalg.norm(high - low))
    if not len(cameras) or not near_m:
        return np.zeros(len(cameras))
    corners = low + _CORNERS * (high - low)
    in_camera = np.einsum("cij,kj->cki", cameras.cam_from_world[:, :3, :3], corners) + cameras.cam_from_world[:, None, :3, 3]
    vertices, exists = _cut_at_near(in_camera, near_m)
    pixels = np.einsum("cij,ckj->cki", cameras.Ks, vertices)[..., :2] / vertices[..., 2:]
    width, height = cameras.sizes_wh.T.astype(np.float64)
    seeing, owners = np.unique(np.nonzero(exists)[0], return_inverse=True)
    hulls = shapely.convex_hull(shapely.multipoints(pixels[exists], indices=owners))
    shares = np.zeros(len(cameras))
    shares[seeing] = shapely.area(shapely.intersection(hulls, shapely.box(0, 0, width[seeing], height[seeing]))) / (width * height)[seeing]
    return shares


def _cut_at_near(corners: FloatArray, near_m: float) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Vertices (C,20,3) of boxes (C,8,3) cut at z = near, in camera axes; which exist (C,20)."""
    from_, to = corners[:, _EDGES[:, 0]], corners[:, _EDGES[:, 1]]
    crosses = (from_[..., 2] >= near_m) != (to[..., 2] >= near_m)
    rise = np.where(crosses, to[..., 2] - from_[..., 2], 1.0)
    cuts = from_ + ((near_m - from_[..., 2]) / rise)[..., None] * (to - from_)
    exists = np.concatenate([corners[..., 2] >= near_m, crosses], axis=1)
    return np.where(exists[..., None], np.concatenate([corners, cuts], axis=1), 1.0), exists
