"""GeoJSON features in another system than longitude and latitude. Once per file.

The member `crs` of GeoJSON 2008 names a system by a URN of the OGC (07-092r3): one code, or that of
the plane and that of the heights, which GDAL and PROJ read.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.georef.crs import Crs

MILLIMETRE = 1e-3
DEGREE_DIGITS = 9


def in_crs(features: Iterable[dict[str, Any]], crs: Crs) -> Iterator[dict[str, Any]]:
    """Features with longitude and latitude (and height) as coordinates, in `crs`; BadInput where
    that does not reach."""
    for feature in features:
        geometry = feature["geometry"]
        yield {**feature, "geometry": {**geometry, "coordinates": _moved(geometry["coordinates"], crs)}}


def crs_member(crs: Crs) -> dict[str, Any]:
    """The member `crs` of a FeatureCollection (GeoJSON 2008, section 3); BadInput for a system
    whose plane or heights have no code of EPSG, by which it is named, or whose heights have another
    unit than the codes say."""
    if crs.horizontal_epsg is None or (crs.vertical_name and crs.vertical_epsg is None):
        raise BadInput(f"GeoJSON names a system by its EPSG code, and {crs.title} has none: give EPSG:NNNN, or EPSG:NNNN+MMMM.")
    if crs.vertical_epsg is None and crs.height_unit_m != (crs.unit_m or 1.0):
        raise BadInput(
            f"GeoJSON names {crs.title} by the EPSG code {crs.horizontal_epsg}, which says nothing of heights in units of 1 "
            f"{crs.height_unit}: name a vertical datum with EPSG:NNNN+MMMM, or leave the unit out."
        )
    if crs.vertical_epsg is None:
        return _named(f"urn:ogc:def:crs:EPSG::{crs.horizontal_epsg}")
    return _named(f"urn:ogc:def:crs,crs:EPSG::{crs.horizontal_epsg},crs:EPSG::{crs.vertical_epsg}")


def _named(name: str) -> dict[str, Any]:
    return {"type": "name", "properties": {"name": name}}


def _moved(coordinates: Any, crs: Crs) -> Any:
    """Nested coordinates, ring by ring."""
    if isinstance(coordinates[0], int | float):
        return _places([coordinates], crs)[0]
    if isinstance(coordinates[0][0], int | float):
        return _places(list(coordinates), crs)
    return [_moved(part, crs) for part in coordinates]


def _places(rows: list[Any], crs: Crs) -> list[list[float]]:
    lat_lon_alt = np.array([[row[1], row[0], row[2] if len(row) > 2 else 0.0] for row in rows], np.float64)
    digits, height_digits = DEGREE_DIGITS if crs.unit_m is None else _digits(crs.unit_m), _digits(crs.height_unit_m)
    moved = crs.from_geodetic(lat_lon_alt)
    return [
        [*np.round(place[:2], digits).tolist(), *([round(float(place[2]), height_digits)] if len(row) > 2 else [])]
        for row, place in zip(rows, moved, strict=True)
    ]


def _digits(unit_m: float) -> int:
    """Decimals of a unit that hold a millimetre."""
    return max(0, math.ceil(math.log10(unit_m / MILLIMETRE) - 1e-9))
