"""Whose region or strip a place lies in, as the plan says. Once per join and plan."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import Polygon, contains_xy, points, prepare

from radiant_core.numerics import FloatArray, check_array
from radiant_core.plan.regions.power_diagram import assign

Claims = Callable[[FloatArray], NDArray[np.int64]]
"""Positions (P,2) m → whose region each lies in (P,), as the plan says."""


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
        typed: Any = shapely
        nearest[outside] = np.argmin([typed.distance(area, places) for area in areas.values()], axis=0)
        return indices[nearest]

    return claim
