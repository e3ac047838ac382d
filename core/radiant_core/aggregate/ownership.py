"""Which model owns a place: its region's, unless another one saw it better. Once per join."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from shapely import Polygon, contains_xy, distance, points, prepare

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.geometry.coverage import coverage
from radiant_core.numerics import FloatArray, check_array
from radiant_core.plan.regions.power_diagram import assign

KEPT_COVERAGE = 0.8
"""An owner keeps a place that its cameras cover at least this well, compared with the best."""
CONTESTED_COVERAGE = 0.1
"""A place is contested where a second model covers it this well, compared with the best."""

Claims = Callable[[FloatArray], NDArray[np.int64]]
"""Positions (P,2) m → whose region each lies in (P,), as the plan says."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Ownership:
    """Of P places: owner (P,) a model's index; contested (P,) where a second one covers it too."""

    owner: NDArray[np.int64]
    contested: NDArray[np.bool_]

    def at(self, chosen: NDArray[np.bool_]) -> Ownership:
        """Of the places where `chosen` (P,) is true."""
        return Ownership(owner=self.owner[chosen], contested=self.contested[chosen])


def ownership(places: ArrayLike, cameras: Sequence[Cameras], claims: Claims | None = None) -> Ownership:
    """Owners of places (P,3) m by `claims` of regions, without them the model that covers it best.

    A place that no camera sees belongs to the region's owner, to the first model without claims.
    Raises BadInput without models.
    """
    if not cameras:
        raise BadInput("no cameras of any model were given to say whose a place is: pass one set per model.")
    checked = check_array("places", places, (None, 3))
    covered = np.stack([coverage(checked, own) for own in cameras], axis=1)
    best = covered.max(axis=1)
    owner = covered.argmax(axis=1)
    if claims is not None:
        claimed = claims(checked[:, :2])
        keeps = covered[np.arange(len(checked)), claimed] >= KEPT_COVERAGE * best
        owner = np.where(keeps, claimed, owner)
    second = np.partition(covered, -2, axis=1)[:, -2] if len(cameras) > 1 else np.zeros(len(checked))
    return Ownership(owner=owner, contested=(second > 0) & (second >= CONTESTED_COVERAGE * best))


def claims_of_cells(sites: FloatArray, weights: FloatArray) -> Claims:
    """Claims of the cells of a power diagram, sites (M,2) m and weights (M,) m²."""
    sites = check_array("sites", sites, (None, 2))
    weights = check_array("weights", weights, (len(sites),))
    return lambda positions: assign(positions, sites, weights)


def claims_of_polygons(polygons: Sequence[FloatArray]) -> Claims | None:
    """Claims of polygons (V,2) m; outside of all the nearest. None where none has corners."""
    areas = {index: Polygon(polygon) for index, polygon in enumerate(polygons) if len(polygon) > 2}
    if not areas:
        return None
    indices = np.array(list(areas), np.int64)
    prepare(list(areas.values()))

    def claim(positions: FloatArray) -> NDArray[np.int64]:
        inside = np.array([contains_xy(area, positions[:, 0], positions[:, 1]) for area in areas.values()])
        nearest = inside.argmax(axis=0)
        # Distances take ten times as long: only of those in none.
        outside = np.flatnonzero(~inside.any(axis=0))
        places = points(positions[outside])
        nearest[outside] = np.argmin([distance(area, places) for area in areas.values()], axis=0)
        return indices[nearest]

    return claim
