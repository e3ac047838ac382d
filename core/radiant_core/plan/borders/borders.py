"""The border that two regions share: at most a line, as power cells are convex. Once per plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiant_core.numerics import FloatArray
from radiant_core.plan.plans import CloudPlan


@dataclass(frozen=True, kw_only=True, eq=False)
class Border:
    """Between the regions `first` < `second`, indices of edges; ends (2,2) m, with `first` to the
    left on the way from end to end."""

    first: int
    second: int
    ends: FloatArray

    @property
    def length_m(self) -> float:
        """Metres from end to end."""
        return float(np.linalg.norm(self.ends[1] - self.ends[0]))

    @property
    def toward_first(self) -> FloatArray:
        """Unit vector (2,) across the border into the first region."""
        along = self.ends[1] - self.ends[0]
        return np.array([-along[1], along[0]]) / max(self.length_m, 1e-300)

    def distances_m(self, points: FloatArray) -> FloatArray:
        """Distances (K,) of points (K,2) from the border as a line segment."""
        return _segment_distances_m(points, self.ends[0], self.ends[1])


def shared_borders(plan: CloudPlan) -> tuple[Border, ...]:
    """All borders between two regions, by `first`, then around it; not the scene's outer edge."""
    borders: list[Border] = []
    for edge, polygon in enumerate(plan.borders):
        if len(polygon) < 3:
            continue
        ends = np.stack([polygon, np.roll(polygon, -1, axis=0)], axis=1)
        neighbours = neighbours_across(plan, edge, ends.mean(axis=1)).tolist()
        # Both regions have this side: the lower index keeps it.
        borders += [
            Border(first=edge, second=neighbour, ends=side) for side, neighbour in zip(ends, neighbours, strict=True) if neighbour > edge
        ]
    return tuple(border for border in borders if border.length_m > 0)


def neighbours_across(plan: CloudPlan, edge: int, points: FloatArray) -> NDArray[np.int64]:
    """For points (K,2) on the outline of region `edge` the region behind, −1 where the scene ends:
    at a border two regions are equally near by power distance ‖x − P‖² − w."""
    distances = ((points[:, None] - plan.sites) ** 2).sum(axis=2) - plan.weights
    to_edge = distances[:, edge].copy()
    distances[:, edge] = np.inf
    if distances.shape[1] < 2:
        return np.full(len(points), -1)
    nearest = distances.argmin(axis=1)
    corners = np.concatenate(plan.borders)
    # m²: corners rounded to 1e-6 of the scene move the difference by about 1e-6 · diameter².
    tolerance = 1e-6 * float((np.ptp(corners, axis=0) ** 2).sum())
    shared = np.abs(distances[np.arange(len(points)), nearest] - to_edge) <= tolerance
    return np.where(shared, nearest, -1)


def distance_outside_m(points: FloatArray, polygon: FloatArray) -> FloatArray:
    """Distances (K,) of points (K,2) from a convex counter-clockwise polygon (V,2), 0 inside."""
    sides = np.roll(polygon, -1, axis=0) - polygon
    inside = np.ones(len(points), bool)
    away_m = np.full(len(points), np.inf)
    for corner, side in zip(polygon, sides, strict=True):
        local = points - corner
        inside &= side[0] * local[:, 1] - side[1] * local[:, 0] >= 0
        away_m = np.minimum(away_m, _segment_distances_m(points, corner, corner + side))
    return np.where(inside, 0.0, away_m)


def _segment_distances_m(points: FloatArray, start: FloatArray, stop: FloatArray) -> FloatArray:
    along = stop - start
    local = points - start
    share = np.clip(local @ along / max(float(along @ along), 1e-300), 0, 1)
    return np.linalg.norm(local - share[:, None] * along, axis=1)
