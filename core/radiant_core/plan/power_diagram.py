"""Power diagrams: which cell a position lies in, and the cells as polygons.

    cell e = { x : ‖x − P_e‖² − w_e ≤ ‖x − P_j‖² − w_j for all j }     (weights 0: the Voronoi diagram)

The border between i and j is a line across P_i P_j; a weight change Δw moves it by Δw / (2 ‖P_i − P_j‖). Cells are convex,
disjoint and cover the plane (Aurenhammer, Power diagrams, SIAM J. Comput. 1987). `assign` runs once per candidate plan, the
polygons once per plan.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core._native import assign_power_cells
from radiant_core.numerics import FloatArray, checked_array


def assign(positions: FloatArray, sites: FloatArray, weights: FloatArray) -> NDArray[np.int64]:
    """Cell (C,) of positions (C,2) m among sites (E,2) m with weights (E,) m²; ties go to the smallest index."""
    return assign_power_cells(positions, sites, weights).astype(np.int64)


def cell_polygons(sites: ArrayLike, weights: ArrayLike, outline: ArrayLike) -> tuple[FloatArray, ...]:
    """Cells clipped to a convex counter-clockwise outline (V,2) m: per site a polygon (V,2), or (0,2) for an empty cell.

    Of sites at one spot the heaviest has the whole cell, the first among equals.
    """
    corners = checked_array("outline", outline, (None, 2))
    centre = corners.mean(axis=0)  # UTM-sized coordinates would lose half the digits when squared
    local_sites = checked_array("sites", sites, (None, 2)) - centre
    checked_weights = checked_array("weights", weights, (len(local_sites),))
    polygons = (_cell_polygon(index, local_sites, checked_weights, corners - centre) for index in range(len(local_sites)))
    return tuple(polygon + centre for polygon in polygons)


def clip_polygon(polygon: FloatArray, normal: FloatArray, offset: float) -> FloatArray:
    """The part of a convex polygon (V,2) with normal · x ≤ offset, turning as before; (0,2) where no area is left."""
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


def rectangle(low: FloatArray, high: FloatArray) -> FloatArray:
    """Counter-clockwise corners (4,2) of the box between two corners (2,)."""
    return np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])


def _cell_polygon(index: int, sites: FloatArray, weights: FloatArray, outline: FloatArray) -> FloatArray:
    """Cut the outline by the border that it crosses farthest until it crosses none; each border cuts once."""
    normals = 2 * (sites - sites[index])
    offsets = np.sum((sites - sites[index]) * (sites + sites[index]), axis=1) - weights + weights[index]
    same_spot = ~normals.any(axis=1)
    loses = same_spot & ((offsets < 0) | ((offsets == 0) & (np.arange(len(sites)) < index)))
    if loses.any():
        return np.empty((0, 2))
    lengths = np.where(same_spot, 1.0, np.linalg.norm(normals, axis=1))
    open_borders = ~same_spot
    tolerance_m = 1e-13 * float(np.ptp(outline, axis=0).max())
    polygon = outline
    while len(polygon):
        overshoot = np.max(polygon @ normals.T - offsets, axis=0) / lengths
        worst = int(np.where(open_borders, overshoot, -np.inf).argmax())
        if not open_borders[worst] or overshoot[worst] <= tolerance_m:
            break
        polygon = clip_polygon(polygon, normals[worst], float(offsets[worst]))
        open_borders[worst] = False
    negligible_m2 = 1e-15 * polygon_area_m2(outline)
    return polygon if polygon_area_m2(polygon) > negligible_m2 else np.empty((0, 2))
