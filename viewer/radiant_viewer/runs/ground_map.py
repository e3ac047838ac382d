"""`GroundMap`: a coarse height of the ground under any place, from points. Once per reading."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt

from radiant_core.numerics import FloatArray, check_array

CELLS, LOW_SHARE, LEAST_POINTS = 48, 0.1, 3
"""Cells along each side; the share of a cell's points that may lie below its ground; cells with
fewer points have that of the nearest one that has more."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GroundMap:
    """heights (CELLS,CELLS) by east and north over the box low, high (2,)."""

    low: FloatArray
    high: FloatArray
    heights: FloatArray

    @staticmethod
    def of(points: FloatArray) -> GroundMap | None:
        """Of points (N,3); None where they are too few for any cell."""
        points = check_array("points", points, (None, 3))
        if len(points) < LEAST_POINTS:
            return None
        # Strays would stretch the cells over nothing.
        low, high = np.quantile(points[:, :2], [0.01, 0.99], axis=0)
        cells = np.floor((points[:, :2] - low) / np.maximum(high - low, 1e-9) * CELLS).astype(np.int64)
        inside = ((cells >= 0) & (cells < CELLS)).all(axis=1)
        flat, rises = cells[inside] @ np.array([CELLS, 1]), points[inside, 2]
        order = np.lexsort([rises, flat])
        names, starts, counts = np.unique(flat[order], return_index=True, return_counts=True)
        is_measured = counts >= LEAST_POINTS
        if not is_measured.any():
            return None
        heights = np.full(CELLS * CELLS, np.nan)
        heights[names[is_measured]] = rises[order][(starts + (LOW_SHARE * counts).astype(np.int64))[is_measured]]
        grid = heights.reshape(CELLS, CELLS)
        nearest = np.asarray(distance_transform_edt(np.isnan(grid), return_distances=False, return_indices=True))
        return GroundMap(low=low, high=high, heights=grid[nearest[0], nearest[1]])

    def under(self, place: FloatArray) -> float:
        """Height of the ground under a place (3,); beside the map that of its rim."""
        cell = np.floor((np.asarray(place)[:2] - self.low) / np.maximum(self.high - self.low, 1e-9) * CELLS)
        east, north = np.clip(cell, 0, CELLS - 1).astype(np.int64)
        return float(self.heights[east, north])
