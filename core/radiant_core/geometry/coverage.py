"""How well cameras cover places. O(C P), once per join and per picture of borders.

    coverage of x by cameras = Σ over the images that show x of  min(1, 4 r) / z · f / width

r is how far inside the image x lies (0 at its rim, 1 in its middle); z is depth. Occlusion does not
count: with depths compared, models whose depths are wrong in places lost those to neighbours that
were no better (docs/experiments/aggregation.md).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from radiant_core.cameras import Cameras
from radiant_core.numerics import FloatArray

_RIM = 0.25


def coverage(places: ArrayLike, cameras: Cameras) -> FloatArray:
    """Coverage (P,) of places (P,3) m as above, in image widths per unit of length; 0 unseen."""
    # Rows of coordinates, and only what is shown goes on: half the time of (P,3) arrays.
    rows = np.ascontiguousarray(np.asarray(places, np.float64).T)
    covered = np.zeros(rows.shape[1])
    for K, pose, (width, height) in zip(cameras.Ks, cameras.cam_from_world, cameras.sizes_wh, strict=True):
        projection = K @ pose[:3]
        depths = projection[2, :3] @ rows + projection[2, 3]
        front = np.flatnonzero(depths > 0)
        shown, depths = rows[:, front], depths[front]
        columns = np.abs((projection[0, :3] @ shown + projection[0, 3]) / depths * (2 / width) - 1)
        lines = np.abs((projection[1, :3] @ shown + projection[1, 3]) / depths * (2 / height) - 1)
        inside = 1 - np.maximum(columns, lines)
        seen = np.flatnonzero(inside > 0)
        covered[front[seen]] += np.minimum(1.0, inside[seen] / _RIM) * (K[0, 0] / width) / depths[seen]
    return covered
