"""Places of a map as GeoJSON (RFC 7946): longitude and latitude where the map has a place on the
globe, else the model's own coordinates, which the file says. Once per export.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from radiant_core.numerics import FloatArray
from radiant_core.survey.map_grid import MapFrame

DEGREE_DIGITS, UNIT_DIGITS = 9, 4
"""1e-9° is 0.1 mm."""


def to_geojson(map_frame: MapFrame, features: Sequence[Mapping[str, Any]], about: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """A collection of features, and what stands beside them."""
    note = {} if map_frame.system is not None else {"coordinates": "the model's own, not longitude and latitude"}
    return {"type": "FeatureCollection", "features": list(features), **note, **(about or {})}


def coordinates_of(map_frame: MapFrame, places: FloatArray) -> list[list[float]]:
    """East, north and perhaps height (P,2 or 3) as GeoJSON has them."""
    places = np.asarray(places, np.float64)
    if map_frame.system is None or not len(places):
        return np.round(places, UNIT_DIGITS).tolist()
    # Where a shift of datum depends on the height, that of the place counts.
    lifted = np.column_stack([places[:, :2], places[:, 2] if places.shape[1] > 2 else np.zeros(len(places))])
    lon_lat = np.round(map_frame.system.to_geodetic(lifted)[:, 1::-1], DEGREE_DIGITS)
    return [[*flat, *high] for flat, high in zip(lon_lat.tolist(), np.round(places[:, 2:], UNIT_DIGITS).tolist(), strict=True)]


def point_feature(map_frame: MapFrame, place: FloatArray, properties: Mapping[str, Any]) -> dict[str, Any]:
    """A point (2 or 3)."""
    return _feature("Point", coordinates_of(map_frame, np.asarray(place)[None])[0], properties)


def line_feature(map_frame: MapFrame, line: FloatArray, properties: Mapping[str, Any]) -> dict[str, Any]:
    """A line (K,2 or 3)."""
    return _feature("LineString", coordinates_of(map_frame, line), properties)


def polygon_feature(map_frame: MapFrame, outline: FloatArray, properties: Mapping[str, Any]) -> dict[str, Any]:
    """A polygon by its corners (K,2 or 3), not closed, counter-clockwise as the standard asks."""
    corners = np.asarray(outline, np.float64)
    x, y = corners[:, 0] - corners[:, 0].mean(), corners[:, 1] - corners[:, 1].mean()
    if np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) < 0:
        corners = corners[::-1]
    return _feature("Polygon", [coordinates_of(map_frame, np.concatenate([corners, corners[:1]]))], properties)


def _feature(kind: str, coordinates: Any, properties: Mapping[str, Any]) -> dict[str, Any]:
    return {"type": "Feature", "geometry": {"type": kind, "coordinates": coordinates}, "properties": dict(properties)}
