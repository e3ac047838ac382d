"""GeoJSON features in another system than longitude and latitude. Once per file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.georef.crs import Crs

MILLIMETRES = 3
DEGREE_DIGITS = 9


def in_crs(features: Iterable[dict[str, Any]], crs: Crs) -> Iterator[dict[str, Any]]:
    """Features with longitude and latitude (and height) as coordinates, in `crs`; BadInput where
    that does not reach."""
    for feature in features:
        geometry = feature["geometry"]
        yield {**feature, "geometry": {**geometry, "coordinates": _moved(geometry["coordinates"], crs)}}


def crs_member(crs: Crs) -> dict[str, Any]:
    """The member `crs` of a FeatureCollection (GeoJSON 2008, section 3); BadInput for a system
    without EPSG's code, which it cannot name."""
    if crs.horizontal_epsg is None:
        raise BadInput(f"GeoJSON names a system by its EPSG code, and {crs.title} has none: give EPSG:NNNN.")
    # Heights stay in the third coordinate; readers know no compound name here.
    return {"type": "name", "properties": {"name": f"urn:ogc:def:crs:EPSG::{crs.horizontal_epsg}"}}


def _moved(coordinates: Any, crs: Crs) -> Any:
    """Nested coordinates, ring by ring."""
    if isinstance(coordinates[0], int | float):
        return _places([coordinates], crs)[0]
    if isinstance(coordinates[0][0], int | float):
        return _places(list(coordinates), crs)
    return [_moved(part, crs) for part in coordinates]


def _places(rows: list[Any], crs: Crs) -> list[list[float]]:
    lat_lon_alt = np.array([[row[1], row[0], row[2] if len(row) > 2 else 0.0] for row in rows], np.float64)
    digits = DEGREE_DIGITS if crs.unit == "degree" else MILLIMETRES
    moved = crs.from_geodetic(lat_lon_alt)
    return [
        [*np.round(place[:2], digits).tolist(), *([round(float(place[2]), MILLIMETRES)] if len(row) > 2 else [])]
        for row, place in zip(rows, moved, strict=True)
    ]
