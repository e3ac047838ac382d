"""Borders between the devices of an edge: strips of its cell cut by lines, where the distance is
the least to a cut. Once per mask. P positions, R regions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.evaluate.borders import NearestBorder, edge_owners
from radiant_core.numerics import FloatArray
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.regions.power_diagram import polygon_area_m2


class Borders(Protocol):
    """Regions of the ground and the borders between them."""

    @property
    def names(self) -> tuple[str, ...]:
        """The R regions."""
        ...

    def nearest(self, points_xy: FloatArray) -> NearestBorder:
        """The border of its own region that is nearest to each of the positions (P,2) m, finite."""
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class DeviceBorders:
    """Borders between the devices of each edge, none between edges; cuts span the edge's cell."""

    plan: CloudPlan
    edge_plans: Sequence[EdgePlan]

    def __post_init__(self) -> None:
        if tuple(plan.edge_id for plan in self.edge_plans) != self.plan.edge_ids:
            raise BadInput("the plans of the edges are not those of the regions, or in another order: pass both of one plan.")

    @property
    def names(self) -> tuple[str, ...]:
        """Ids of the devices, edge by edge."""
        return tuple(device for plan in self.edge_plans for device in plan.device_ids)

    def nearest(self, points_xy: FloatArray) -> NearestBorder:
        """See `Borders`."""
        distances, pairs = np.full(len(points_xy), np.inf), np.full((len(points_xy), 2), -1)
        owners = edge_owners(points_xy, self.plan)
        first = 0
        for edge, plan in enumerate(self.edge_plans):
            inside = np.flatnonzero(owners == edge)
            for pair, normal, offset in _cuts(plan):
                gaps = np.abs(points_xy[inside] @ normal - offset)
                nearer = gaps < distances[inside]
                distances[inside[nearer]] = gaps[nearer]
                pairs[inside[nearer]] = np.sort(pair) + first
            first += len(plan.device_ids)
        return NearestBorder(distance_m=distances, pair=pairs)


def _cuts(plan: EdgePlan) -> list[tuple[tuple[int, int], FloatArray, float]]:
    """Devices on either side, unit normal (2,) and offset of the line between each two consecutive
    strips that hold ground."""
    used = [index for index, strip in enumerate(plan.strips) if len(strip) >= 3]
    return [((a, b), *_separating_side(plan.strips[a], plan.strips[b])) for a, b in pairwise(used)]


def _separating_side(strip: FloatArray, polygon: FloatArray) -> tuple[FloatArray, float]:
    """The side of a convex `strip` (V,2) that `polygon` lies farthest beyond: n and n · x."""
    strip = strip if polygon_area_m2(strip) > 0 else strip[::-1]
    sides = np.roll(strip, -1, axis=0) - strip
    lengths = np.linalg.norm(sides, axis=1)
    strip, sides, lengths = strip[lengths > 0], sides[lengths > 0], lengths[lengths > 0]
    normals = np.column_stack([sides[:, 1], -sides[:, 0]]) / lengths[:, None]
    beyond = ((polygon[None] - strip[:, None]) * normals[:, None]).sum(axis=2).min(axis=1)
    best = int(beyond.argmax())
    return normals[best], float(normals[best] @ strip[best])
