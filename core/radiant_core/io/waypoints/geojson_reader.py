"""Waypoints from GeoJSON (RFC 7946): points and vertices of lines, longitude first. Once per file.

Files from before that standard, and those of `radiant export --crs`, name another system in their
member `crs`: places are moved from there. Heights become metres by the unit of that system, and
heights over the ellipsoid where it names their datum; else they stay what they are.

A feature's name is its property name or id, else its member id; vertices get a number behind it.
Polygons and features without a geometry are no waypoints: they are counted as ignored.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any

from radiant_core.errors import BadInput
from radiant_core.georef.crs import Crs, parse_crs
from radiant_core.io.waypoints.rows import WaypointRows

_CRS84 = re.compile(r"\bCRS:?84h?\b")
_EPSG = re.compile(r"EPSG[:/](?:[\d.]*[:/])?(\d{4,6})(?:\+(?:EPSG:)?(\d{4,6}))?\b")


def geojson_rows(text: str) -> WaypointRows:
    """The waypoints of a GeoJSON text; BadInput with the reason when it is none."""
    rows = WaypointRows()
    system, geometries = geojson_geometries(text)
    for place, name, geometry in geometries:
        _add_geometry(rows, place, name, geometry)
    if system is not None:
        rows.move_from(system)
    return rows


def geojson_geometries(text: str) -> tuple[Crs | None, Iterator[tuple[str, str, Any]]]:
    """The system of a GeoJSON text, None for longitude and latitude; and where each geometry
    stands, its feature's name, and itself, with collections opened. BadInput as above."""
    try:
        value = json.loads(text, parse_constant=float)
    except (ValueError, RecursionError) as error:
        raise BadInput(f"it is not valid JSON ({error}).") from None
    if not isinstance(value, dict) or not isinstance(value.get("type"), str):
        raise BadInput('it is no GeoJSON, which is an object with a "type".')
    return _system_of(value), _geometries(value)


def _system_of(value: dict[str, Any]) -> Crs | None:
    """What the member `crs` names; None for WGS84."""
    crs = value.get("crs")
    named = json.dumps(crs)
    if crs is None or _CRS84.search(named):
        return None
    codes = [code for found in _EPSG.findall(named) for code in found if code]
    if not 1 <= len(codes) <= 2:
        raise BadInput(f"its coordinate system is {named[:80]}, expected WGS84 longitude and latitude, or one by its EPSG code.")
    system = parse_crs(f"EPSG:{'+'.join(codes)}")
    return None if system.own and system.unit_m is None else system


def _geometries(value: dict[str, Any]) -> Iterator[tuple[str, str, Any]]:
    """Where each geometry stands, its feature's name, and itself; collections are opened."""
    if value["type"] == "FeatureCollection":
        features = value.get("features")
        if not isinstance(features, list):
            raise BadInput('it is a FeatureCollection without a list "features".')
        for number, feature in enumerate(features, start=1):
            if not isinstance(feature, dict) or feature.get("type") != "Feature":
                raise BadInput(f'feature {number} is no object of type "Feature".')
            yield from _open_collections(f"feature {number}", _feature_name(feature), feature.get("geometry"))
    elif value["type"] == "Feature":
        yield from _open_collections("the feature", _feature_name(value), value.get("geometry"))
    else:
        yield from _open_collections("the geometry", "", value)


def _open_collections(place: str, name: str, geometry: Any) -> Iterator[tuple[str, str, Any]]:
    waiting = [geometry]
    while waiting:
        inner = waiting.pop()
        if isinstance(inner, dict) and inner.get("type") == "GeometryCollection":
            geometries = inner.get("geometries")
            if not isinstance(geometries, list):
                raise BadInput(f'{place} is a GeometryCollection without a list "geometries".')
            waiting += reversed(geometries)
        else:
            yield place, name, inner


def _feature_name(feature: dict[str, Any]) -> str:
    properties = feature.get("properties")
    wanted = properties if isinstance(properties, dict) else {}
    for value in (wanted.get("name"), wanted.get("Name"), wanted.get("id"), feature.get("id")):
        if isinstance(value, str | int | float) and not isinstance(value, bool):
            return str(value)
    return ""


def _add_geometry(rows: WaypointRows, place: str, name: str, geometry: Any) -> None:
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
        _add_position(rows, place, name, coordinates)
        return
    lines = coordinates if kind == "MultiLineString" and isinstance(coordinates, list) else [coordinates]
    if not all(isinstance(line, list) for line in lines):
        raise BadInput(f"{place} is a {kind} without a list of coordinates.")
    vertices = [position for line in lines if isinstance(line, list) for position in line]
    for number, position in enumerate(vertices, start=1):
        _add_position(rows, place, f"{name}-{number}" if name else "", position)


def _add_position(rows: WaypointRows, place: str, name: str, position: Any) -> None:
    if not (isinstance(position, list) and len(position) >= 2 and all(type(value) in (int, float) for value in position)):
        raise BadInput(f"{place} has the position {json.dumps(position)[:60]}, expected numbers [longitude, latitude, altitude].")
    try:
        lon, lat, alt = float(position[0]), float(position[1]), float(position[2]) if len(position) > 2 else None
    except OverflowError:
        raise BadInput(f"{place} has a position with a number beyond any degree or metre.") from None
    rows.add(name, lat, lon, alt)
