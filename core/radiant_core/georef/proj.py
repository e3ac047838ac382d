"""Coordinate systems that PROJ computes, by pyproj; imported where one is asked for. Once per file.

Heights are in the system's own unit where it has heights, by a vertical datum or a third axis.
PROJ passes those of a plane without them through in metres (PROJ 9.5.1, EPSG:2263: 100 m east are
328.08 ft, 100 m up stay 100): here they are in the unit of the plane, so that a foot is a foot.
Nothing is fetched; which operation is used is said in `operation`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.extras import require_extra
from radiant_core.georef.operation import NO_SHIFT, Operation, how_to_get, operation_at, require_usable
from radiant_core.numerics import FloatArray

_GRID = re.compile(r"Grid (\S+) is not available")
PLACE_DIGITS = 2
"""Of the degrees at which an operation is chosen for places that no scene is named for: 1 km."""


@dataclass(frozen=True, kw_only=True)
class ProjSystem:
    """What PROJ says of a system; codes are None where EPSG has none."""

    name: str
    horizontal_epsg: int | None
    vertical_epsg: int | None
    vertical_name: str
    """Of the datum of its heights, empty where it has none."""
    unit: str
    """Of its plane."""
    unit_m: float | None
    """Its metres; None for an angle."""
    height_unit: str
    height_unit_m: float
    proj_scales_heights: bool
    """Whether PROJ itself gives heights in that unit."""
    axes: tuple[str, str]
    """Where the two numbers of a place count to."""
    heights_count_down: bool
    bounds_deg: tuple[float, float, float, float] | None
    """West, south, east, north of where it is used; None where nobody says, or it crosses 180°."""


@lru_cache(maxsize=16)
def described(definition: str) -> ProjSystem | None:
    """The system that PROJ reads in `definition`; None where it reads none, or one without east and
    north."""
    system = _system(definition)
    if system is None:
        return None
    parts = system.sub_crs_list if system.is_compound else [system]
    flat = parts[0].source_crs if parts[0].is_bound else parts[0]
    if flat is None or not (flat.is_projected or flat.is_geographic) or len(flat.axis_info) < 2:
        return None
    vertical = None if len(parts) < 2 else parts[1].source_crs if parts[1].is_bound else parts[1]
    axis, height = flat.axis_info[0], _height_axis(flat, vertical)
    unit_m = float(axis.unit_conversion_factor) if flat.is_projected else None
    area = system.area_of_use or flat.area_of_use
    return ProjSystem(
        name="" if system.name == "unknown" else system.name,
        horizontal_epsg=None if _shifts_nothing(parts[0]) else flat.to_epsg(),
        vertical_epsg=None if vertical is None else vertical.to_epsg(),
        vertical_name="" if vertical is None else vertical.name,
        unit=axis.unit_name,
        unit_m=unit_m,
        height_unit=(axis.unit_name if unit_m is not None else "metre") if height is None else height.unit_name,
        height_unit_m=(unit_m or 1.0) if height is None else float(height.unit_conversion_factor),
        proj_scales_heights=height is not None,
        axes=_axes(flat),
        heights_count_down=height is not None and height.direction == "down",
        bounds_deg=None if area is None or area.west > area.east else area.bounds,
    )


def _shifts_nothing(plane: Any) -> bool:
    """Whether a plane is bound to WGS84 by the grid null, so that its datum is not that of the
    system that it looks like: +ellps=airy with +nadgrids=@null lies 110 m from EPSG:27700."""
    return bool(plane.is_bound) and any(NO_SHIFT in grid.short_name.split("@") for grid in plane.coordinate_operation.grids)


def _height_axis(flat: Any, vertical: Any) -> Any:
    """The axis of heights: of the vertical part, or the plane's third one; None without both."""
    if vertical is not None:
        return vertical.axis_info[0] if vertical.axis_info else None
    return flat.axis_info[2] if len(flat.axis_info) > 2 else None


def _axes(flat: Any) -> tuple[str, str]:
    """PROJ puts east before north, but leaves axes that count west or south as they are; at the
    poles both count along meridians, and their names say more."""
    first, second = (axis.direction for axis in flat.axis_info[:2])
    if {first, second} & {"west"} and {first, second} <= {"west", "south", "north"}:
        return first, second
    return "east", "north"


def project(definition: str, lat_lon_alt: FloatArray, title: str, near: tuple[float, float] | None = None) -> FloatArray:
    """East, north, up (P,3) of geodetic places (P,3) [deg, deg, m], by the operation that is best
    near a latitude and longitude, else in their middle; BadInput, with the system's `title`, where
    it does not reach or a grid is missing."""
    if not len(lat_lon_alt):
        return np.zeros((0, 3))
    operation = _usable(definition, title, middle_deg(lat_lon_alt) if near is None else near)
    lat, lon, alt = lat_lon_alt.T
    converted = _transform(operation.pipeline, np.column_stack([lon, lat, alt]), title, inverse=False)
    return converted * [1.0, 1.0, 1.0 / _left_m(definition)]


def unproject(definition: str, places: FloatArray, title: str, near: tuple[float, float] | None = None) -> FloatArray:
    """The inverse of `project`."""
    if not len(places):
        return np.zeros((0, 3))
    operation = _usable(definition, title, middle_deg(rough_geodetic(definition, places, title)) if near is None else near)
    lon, lat, alt = _transform(operation.pipeline, places * [1.0, 1.0, _left_m(definition)], title, inverse=True).T
    return np.column_stack([lat, lon, alt])


def rough_geodetic(definition: str, places: FloatArray, title: str) -> FloatArray:
    """Latitude and longitude (P,2) of places (P,3) to a kilometre, whatever grids are missing:
    enough to choose an operation. BadInput for places that the system does not have."""
    from pyproj import Transformer
    from pyproj.exceptions import ProjError

    if not len(places):
        return np.zeros((0, 2))
    system = _system(definition)
    flat = system.sub_crs_list[0] if system.is_compound else system
    flat = flat.source_crs if flat.is_bound else flat
    try:
        lon, lat = Transformer.from_crs(flat.to_2d(), "EPSG:4326", always_xy=True).transform(*places[:, :2].T, errcheck=True)
    except ProjError as error:
        raise _failure(title, str(error)) from None
    rough = np.column_stack([lat, lon])
    if not np.isfinite(rough).all() or np.abs(rough[:, 0]).max() > 90:
        raise _out_of_reach(title)
    return rough


def middle_deg(lat_lon: FloatArray) -> tuple[float, float]:
    """A latitude and longitude in the middle of places (P,2 or 3), to a kilometre; the 180th
    meridian cuts nothing."""
    longitudes = (lat_lon[:, 1] - lat_lon[0, 1] + 180) % 360 - 180
    lon = (lat_lon[0, 1] + np.median(longitudes) + 180) % 360 - 180
    return round(float(np.median(lat_lon[:, 0])), PLACE_DIGITS), round(float(lon), PLACE_DIGITS)


def wkt_of(definition: str) -> str:
    """WKT of the system: ESRI's where it can say all of it, else that of ISO 19162."""
    from pyproj.enums import WktVersion
    from pyproj.exceptions import CRSError

    system = _system(definition)
    assert system is not None
    try:
        return system.to_wkt(WktVersion.WKT1_ESRI)
    except CRSError:
        return system.to_wkt(WktVersion.WKT2_2019)


@lru_cache(maxsize=16)
def _system(definition: str) -> Any:
    require_extra("geo", "this coordinate system cannot be computed", "use the scene's UTM zone on WGS84")
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        return CRS.from_user_input(definition)
    except CRSError:
        return None


def _usable(definition: str, title: str, near: tuple[float, float]) -> Operation:
    operation, system = operation_at(definition, *near), described(definition)
    require_usable(operation, title, has_vertical=system is not None and system.vertical_name != "")
    return operation


def _left_m(definition: str) -> float:
    """Metres of a unit of height, 1 where PROJ has seen to it."""
    system = described(definition)
    return 1.0 if system is None or system.proj_scales_heights else system.height_unit_m


@lru_cache(maxsize=16)
def _transformer(pipeline: str) -> Any:
    # By its text: what TransformerGroup itself returns must not be shared between threads.
    from pyproj import Transformer

    return Transformer.from_pipeline(pipeline)


def _transform(pipeline: str, places: FloatArray, title: str, *, inverse: bool) -> FloatArray:
    from pyproj.enums import TransformDirection
    from pyproj.exceptions import ProjError

    direction = TransformDirection.INVERSE if inverse else TransformDirection.FORWARD
    try:
        converted = np.column_stack(_transformer(pipeline).transform(*places.T, direction=direction, errcheck=True))
    except ProjError as error:
        raise _failure(title, str(error)) from None
    if not np.isfinite(converted).all():
        raise _out_of_reach(title)
    return converted.reshape(-1, 3)


def _out_of_reach(title: str) -> BadInput:
    return BadInput(f"a place lies where {title} does not reach: is it the system of this scene?")


def _failure(title: str, text: str) -> BadInput:
    grid = _GRID.search(text)
    if grid is not None:
        name = grid[1].rstrip(".")
        return BadInput(f"{title} needs the grid {name}, which is not installed: {how_to_get([name])}.")
    return BadInput(f"{title} cannot be computed here ({text.split(': ', 1)[-1].strip().rstrip('.)')}): is it the system of this scene?")
