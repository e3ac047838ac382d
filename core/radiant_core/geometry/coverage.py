"""How well cameras cover places. O(C P), once per join and per picture of borders.

    coverage of x by cameras = Σ over the images that show x of  min(1, 4 r) / z · f / width

r is how far inside the image x lies (0 at its rim, 1 in its middle), so that what is only grazed
counts little; z is depth. Occlusion does not count: with depths compared, models whose depths are
wrong in places lost those to neighbours that were no better (docs/experiments/aggregation.md).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core.cameras import Cameras
from radiant_core.numerics import FloatArray
from radiant_core.splats import Splats

_RIM = 0.25


def coverage(places: ArrayLike, cameras: Cameras) -> FloatArray:
    """How well cameras cover places (P,3), as above, in image widths per unit of length."""
    # Rows of coordinates, and only what is shown goes on: half the time of (P,3) arrays.
    rows = np.ascontiguousarray(np.asarray(places, np.float64).T)
    covered = np.zeros(rows.shape[1])
    for K, pose, (width, height) in zip(cameras.Ks, cameras.cam_from_world, cameras.sizes_wh, strict=True):
        projection = K @ pose[:3]
        depths = projection[2, :3] @ rows + projection[2, 3]
        front = np.flatnonzero(depths > 0)
        visible, depths = rows[:, front], depths[front]
        columns = np.abs((projection[0, :3] @ visible + projection[0, 3]) / depths * (2 / width) - 1)
        lines = np.abs((projection[1, :3] @ visible + projection[1, 3]) / depths * (2 / height) - 1)
        inside = 1 - np.maximum(columns, lines)
        inside_rows = np.flatnonzero(inside > 0)
        covered[front[inside_rows]] += np.minimum(1.0, inside[inside_rows] / _RIM) * (K[0, 0] / width) / depths[inside_rows]
    return covered


def reached_by(splats: Splats, cameras: Cameras) -> NDArray[np.bool_]:
    """Which Gaussians (N,) may show in an image: 3 standard deviations reach a camera's pyramid."""
    radii = 3 * np.exp(splats.log_scales.astype(np.float64).max(axis=1))
    means = splats.means.T.astype(np.float64)
    reached = np.zeros(len(splats), bool)
    for K, pose, (width, height) in zip(cameras.Ks, cameras.cam_from_world, cameras.sizes_wh, strict=True):
        unreached = np.flatnonzero(~reached)
        # The sides of the pyramid, pointing inwards: columns 0 and width, rows 0 and height.
        sides = np.array([K[0] * [1, 0, 1], [-K[0, 0], 0, width - K[0, 2]], K[1] * [0, 1, 1], [0, -K[1, 1], height - K[1, 2]], [0, 0, 1]])
        sides /= np.linalg.norm(sides, axis=1, keepdims=True)
        heights = (sides @ pose[:3, :3]) @ means[:, unreached] + (sides @ pose[:3, 3])[:, None]
        reached[unreached] = heights.min(axis=0) + radii[unreached] > 0
    return reached
