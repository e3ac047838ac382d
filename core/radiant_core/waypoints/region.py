"""A region from GeoJSON (RFC 7946): the land of all its polygons. Once per file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from shapely import Polygon, unary_union

from radiant_core.errors import BadInput
from radiant_core.frames import enu_from_geodetic
from radiant_core.georef.crs import Crs
from radiant_core.io.array_file import name_file_in_errors
from radiant_core.numerics import FloatArray, check_array
from radiant_core.waypoints.geojson_reader import geojson_geometries

MAX_REGION_BYTES = 16_000_000


def load_region(path: Path, origin_lat_lon_alt: FloatArray, warn: Callable[[str], None] = lambda message: None) -> FloatArray:
    """Corners (V,2) m east and north of the origin of the one simple polygon of the file's land,
    holes left out; `warn` hears of grids that its system lacks. Raises BadInput for a file that is
    too large or no GeoJSON, or without polygons or with some that do not touch."""
    if not path.is_file():
        raise BadInput(f"there is no file {path}: give a GeoJSON file with a polygon, as 'radiant plan' writes.")
    with name_file_in_errors(path):
        if path.stat().st_size > MAX_REGION_BYTES:
            raise BadInput(f"it has {path.stat().st_size:,} bytes, expected at most {MAX_REGION_BYTES:,}: give the region's outline only.")
        try:
            text = path.read_text("utf-8")
        except UnicodeDecodeError as error:
            raise BadInput(f"it is no text in UTF-8 ({error}).") from None
        system, geometries = geojson_geometries(text)
        lacking = None if system is None else system.shortfall_over(origin_lat_lon_alt[None])
        if lacking is not None:
            warn(lacking)
        land = unary_union([_polygon(ring, origin_lat_lon_alt, system) for _, _, geometry in geometries for ring in _rings(geometry)])
        if not isinstance(land, Polygon) or land.is_empty:
            raise BadInput("its polygons are none or lie apart: give one connected region.")
    return np.array(land.exterior.coords[:-1])


def _rings(geometry: Any) -> list[Any]:
    """The outer ring of each polygon."""
    kind, coordinates = (geometry.get("type"), geometry.get("coordinates")) if isinstance(geometry, dict) else (None, None)
    polygons: Any = [coordinates] if kind == "Polygon" else coordinates if kind == "MultiPolygon" else []
    if not isinstance(polygons, list) or not all(isinstance(rings, list) and rings for rings in polygons):
        raise BadInput(f"a {kind} has no list of rings.")
    return [rings[0] for rings in polygons]


def _polygon(ring: Any, origin: FloatArray, system: Crs | None) -> Polygon:
    if not isinstance(ring, list) or len(ring) < 4 or not all(isinstance(at, list) and len(at) in (2, 3) for at in ring):
        raise BadInput("a ring is no list of at least four positions of longitude and latitude.")
    corners = check_array("ring", [at[:2] for at in ring], (None, 2))
    lat_lon = np.flip(corners, axis=1) if system is None else system.to_geodetic(np.column_stack([corners, np.zeros(len(corners))]))[:, :2]
    places = enu_from_geodetic(np.column_stack([lat_lon, np.full(len(corners), origin[2])]), origin)
    polygon = Polygon(places[:, :2])
    if not polygon.is_valid:
        raise BadInput("a ring crosses itself.")
    return polygon
