"""Waypoints from GeoJSON (RFC 7946): points and vertices of lines, longitude first. Once per file.

The third number is metres above the WGS84 ellipsoid (section 3.1.1), unless the properties
`height_m` and `height_from` say another height and what it counts from, as `radiant plan` writes
them. Files from before that standard, and those of `radiant export --crs`, name another system in
their member `crs`: places are moved from there. Third numbers become metres by the unit of that
system, and heights over the ellipsoid where it names their datum; else what they count from is not
said.

A feature's name is its property name or id, else its member id; vertices get a number behind it.
Polygons and features without a geometry are no waypoints: they are counted as ignored.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from radiant_core.choices import HeightFrom
from radiant_core.errors import BadInput
from radiant_core.georef.crs import Crs, parse_crs
from radiant_core.plan.heights import HEIGHT_KINDS
from radiant_core.waypoints.rows import WaypointRows

HEIGHT_M, HEIGHT_FROM = "height_m", "height_from"
"""Properties of points that say a height which is none above the ellipsoid."""
MAX_HEIGHT_M = 1e9
_CRS84 = re.compile(r"\bCRS:?84h?\b")
_OTHER_AUTHORITY = re.compile(r"\b(?:ESRI|IGNF|IAU\w*|NKG)[:/]")
"""Whose codes stand for one part of a system, which would be lost beside EPSG's of the other."""
_EPSG = re.compile(r"EPSG[:/](?:[\d.]*[:/])?(\d{4,6})(?:\+(?:EPSG:)?(\d{4,6}))?\b")


def geojson_rows(text: str) -> WaypointRows:
    """The waypoints of a GeoJSON text; BadInput with the reason when it is none."""
    rows = WaypointRows()
    value = _parsed(text)
    system = _system_of(value)
    counts_from: HeightFrom = "ellipsoid" if system is None or system.vertical_name else "absolute"
    in_system: list[bool] = []
    for feature in _features(value):
        height = _height_of(feature.properties, feature.place)
        for geometry in _opened(feature.place, feature.geometry):
            _add_geometry(rows, feature, geometry, height or (None, counts_from))
            in_system += [height is None] * (len(rows.names) - len(in_system))
    if system is not None:
        rows.move_from(system, np.array(in_system, bool))
    return rows


def geojson_geometries(text: str) -> tuple[Crs | None, Iterator[tuple[str, str, Any]]]:
    """The system of a GeoJSON text, None for longitude and latitude; and where each geometry
    stands, its feature's name, and itself, with collections opened. BadInput as above."""
    value = _parsed(text)
    return _system_of(value), _geometries(value)


class _Feature(NamedTuple):
    """Where a feature stands, its name, what it says, and its geometry."""

    place: str
    name: str
    properties: dict[str, Any]
    geometry: Any


def _parsed(text: str) -> dict[str, Any]:
    try:
        value = json.loads(text, parse_constant=float)
    except (ValueError, RecursionError) as error:
        raise BadInput(f"it is not valid JSON ({error}).") from None
    if not isinstance(value, dict) or not isinstance(value.get("type"), str):
        raise BadInput('it is no GeoJSON, which is an object with a "type".')
    return value


def _system_of(value: dict[str, Any]) -> Crs | None:
    """What the member `crs` names; None for WGS84."""
    crs = value.get("crs")
    named = json.dumps(crs)
    if crs is None:
        return None
    codes = [code for match in _EPSG.findall(named) for code in match if code]
    if _CRS84.search(named):
        # Alone WGS84, but the plane of heights over a vertical datum beside one.
        codes = ["4326", *codes] if codes else []
        if not codes and not _OTHER_AUTHORITY.search(named):
            return None
    if not 1 <= len(codes) <= 2 or _OTHER_AUTHORITY.search(named):
        raise BadInput(f"its coordinate system is {named[:80]}, expected WGS84 longitude and latitude, or one by its EPSG code.")
    system = parse_crs(f"EPSG:{'+'.join(codes)}")
    return None if system.is_builtin and system.unit_m is None else system


def _geometries(value: dict[str, Any]) -> Iterator[tuple[str, str, Any]]:
    """Where each geometry stands, its feature's name, and itself; collections are opened."""
    for feature in _features(value):
        for geometry in _opened(feature.place, feature.geometry):
            yield feature.place, feature.name, geometry


def _features(value: dict[str, Any]) -> Iterator[_Feature]:
    """The features, and a geometry alone as one of them."""
    if value["type"] == "FeatureCollection":
        features = value.get("features")
        if not isinstance(features, list):
            raise BadInput('it is a FeatureCollection without a list "features".')
        for number, feature in enumerate(features, start=1):
            if not isinstance(feature, dict) or feature.get("type") != "Feature":
                raise BadInput(f'feature {number} is no object of type "Feature".')
            yield _feature(f"feature {number}", feature)
    elif value["type"] == "Feature":
        yield _feature("the feature", value)
    else:
        yield _Feature(place="the geometry", name="", properties={}, geometry=value)


def _feature(place: str, feature: dict[str, Any]) -> _Feature:
    properties = feature.get("properties")
    entries = properties if isinstance(properties, dict) else {}
    return _Feature(place=place, name=_feature_name(feature), properties=entries, geometry=feature.get("geometry"))


def _height_of(properties: dict[str, Any], place: str) -> tuple[float | None, HeightFrom] | None:
    """The height that a feature's properties say; BadInput where they say half of it."""
    kind, height = properties.get(HEIGHT_FROM), properties.get(HEIGHT_M)
    if kind is None:
        return None
    if kind == "unknown":
        return None, "unknown"
    if kind not in HEIGHT_KINDS or not isinstance(height, int | float) or isinstance(height, bool) or not abs(height) < MAX_HEIGHT_M:
        raise BadInput(
            f"{place} has {HEIGHT_FROM} {str(kind)[:40]!r} and {HEIGHT_M} {str(height)[:40]!r}, expected one of {', '.join(HEIGHT_KINDS)} "
            "and metres."
        )
    return float(height), kind


def _opened(place: str, geometry: Any) -> Iterator[Any]:
    waiting = [geometry]
    while waiting:
        inner = waiting.pop()
        if isinstance(inner, dict) and inner.get("type") == "GeometryCollection":
            geometries = inner.get("geometries")
            if not isinstance(geometries, list):
                raise BadInput(f'{place} is a GeometryCollection without a list "geometries".')
            waiting += reversed(geometries)
        else:
            yield inner


def _feature_name(feature: dict[str, Any]) -> str:
    properties = feature.get("properties")
    wanted = properties if isinstance(properties, dict) else {}
    for value in (wanted.get("name"), wanted.get("Name"), wanted.get("id"), feature.get("id")):
        if isinstance(value, str | int | float) and not isinstance(value, bool):
            return str(value)
    return ""


def _add_geometry(rows: WaypointRows, feature: _Feature, geometry: Any, height: tuple[float | None, HeightFrom]) -> None:
    place, name = feature.place, feature.name
    if geometry is None:
        rows.ignored["feature without geometry"] += 1
        return
    kind = geometry.get("type") if isinstance(geometry, dict) else None
    if kind in ("Polygon", "MultiPolygon"):
        rows.ignored[kind] += 1
        return
    if kind not in ("Point", "MultiPoint", "LineString", "MultiLineString"):
        raise BadInput(f"{place} has a geometry of type {kind!r}, expected Point, MultiPoint or LineString.")
    coordinates = geometry.get("coordinates")
    if kind == "Point":
        _add_position(rows, feature, name, coordinates, height)
        return
    lines = coordinates if kind == "MultiLineString" and isinstance(coordinates, list) else [coordinates]
    if not all(isinstance(line, list) for line in lines):
        raise BadInput(f"{place} is a {kind} without a list of coordinates.")
    vertices = [position for line in lines if isinstance(line, list) for position in line]
    for number, position in enumerate(vertices, start=1):
        _add_position(rows, feature, f"{name}-{number}" if name else "", position, height)


def _add_position(rows: WaypointRows, feature: _Feature, name: str, position: Any, height: tuple[float | None, HeightFrom]) -> None:
    place = feature.place
    if not (isinstance(position, list) and len(position) >= 2 and all(type(value) in (int, float) for value in position)):
        raise BadInput(f"{place} has the position {json.dumps(position)[:60]}, expected numbers [longitude, latitude, altitude].")
    try:
        lon, lat, third = float(position[0]), float(position[1]), float(position[2]) if len(position) > 2 else None
    except OverflowError:
        raise BadInput(f"{place} has a position with a number beyond any degree or metre.") from None
    altitude, counts_from = height
    rows.add(name, (lat, lon), third if altitude is None else altitude, counts_from)
