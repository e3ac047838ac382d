"""Power diagrams: which cell a position lies in, and the cells as polygons.

    cell e = { x : ‖x − P_e‖² − w_e ≤ ‖x − P_j‖² − w_j for all j }   (weights 0: Voronoi diagram)

The border of i and j is a line across P_i P_j; a weight change Δw moves it by Δw / (2 ‖P_i − P_j‖).
Cells are convex, disjoint and cover the plane (Aurenhammer, Power diagrams, SIAM J. Comput. 1987).
`assign` runs once per candidate plan, the polygons once per plan.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core._native import assign_power_cells
from radiant_core._native import cell_polygons as native_cell_polygons
from radiant_core.numerics import FloatArray, check_array


def assign(positions: FloatArray, sites: FloatArray, weights: FloatArray) -> NDArray[np.int64]:
    """Cell (C,) of positions (C,2) m, sites (E,2) m, weights (E,) m²; ties: the smallest index."""
    return assign_power_cells(positions, sites, weights).astype(np.int64)


def cell_polygons(sites: ArrayLike, weights: ArrayLike, outline: ArrayLike) -> tuple[FloatArray, ...]:
    """Cells clipped to a convex counter-clockwise outline (V,2) m: a polygon (V,2) per site, (0,2)
    if empty. Of sites at one spot the heaviest has the whole cell, the first among equals."""
    corners = check_array("outline", outline, (None, 2))
    centre = corners.mean(axis=0)  # UTM-sized coordinates would lose half the digits when squared
    local_sites = check_array("sites", sites, (None, 2)) - centre
    checked_weights = check_array("weights", weights, (len(local_sites),))
    local_outline: FloatArray = corners - centre
    tolerance_m = 1e-13 * float(np.ptp(local_outline, axis=0).max())
    negligible_m2 = 1e-15 * polygon_area_m2(local_outline)
    polygons = native_cell_polygons(local_sites, checked_weights, local_outline, tolerance_m)
    return tuple(polygon + centre if polygon_area_m2(polygon) > negligible_m2 else np.empty((0, 2)) for polygon in polygons)


def clip_polygon(polygon: FloatArray, normal: FloatArray, offset: float) -> FloatArray:
    """The part of a convex polygon (V,2) with normal · x ≤ offset; (0,2) where it has no area."""
    heights = polygon @ normal - offset
    corners: list[FloatArray] = []
    for here, there, low, high in zip(polygon, np.roll(polygon, -1, axis=0), heights, np.roll(heights, -1), strict=True):
        if low <= 0:
            corners.append(here)
        if min(low, high) < 0 < max(low, high):
            corners.append(here + (there - here) * (low / (low - high)))
    return np.array(corners) if len(corners) > 2 else np.empty((0, 2))


def polygon_area_m2(polygon: FloatArray) -> float:
    """Signed area of a polygon (V,2) m, positive when counter-clockwise (shoelace formula)."""
    if len(polygon) < 3:
        return 0.0
    x, y = (polygon - polygon[0]).T
    return float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2)


def bounds(positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bounds (2,) of positions (C,2), by column: 40 times as fast as along axis 0 at 10⁶ rows."""
    columns = positions.T
    return np.array([column.min() for column in columns]), np.array([column.max() for column in columns])


def rectangle(low: FloatArray, high: FloatArray) -> FloatArray:
    """Counter-clockwise corners (4,2) of the box between two corners (2,)."""
    return np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
