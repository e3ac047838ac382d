"""Coordinate systems that PROJ computes, by pyproj; imported where one is asked for. Once per file.

Only the best operation that PROJ knows is used, never one that skips a shift of datum: where its
grid is not installed the error names the grid and how to get it. Nothing is fetched.
"""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.extras import require_extra
from radiant_core.numerics import FloatArray

GEODETIC_3D = "EPSG:4979"
_GRID = re.compile(r"Grid (\S+) is not available")


@dataclass(frozen=True, kw_only=True)
class ProjSystem:
    """What PROJ says of a system; codes are None where EPSG has none."""

    name: str
    horizontal_epsg: int | None
    vertical_epsg: int | None
    unit: str
    """Of its plane."""
    bounds_deg: tuple[float, float, float, float] | None
    """West, south, east, north of where it is used; None where nobody says, or it crosses 180°."""


def described(definition: str) -> ProjSystem | None:
    """The system that PROJ reads in `definition`; None where it reads none, or one without east and
    north."""
    system = _system(definition)
    if system is None:
        return None
    parts = system.sub_crs_list if system.is_compound else [system]
    flat = parts[0].source_crs if parts[0].is_bound else parts[0]
    if flat is None or not (flat.is_projected or flat.is_geographic):
        return None
    vertical_epsg = parts[1].to_epsg() if len(parts) > 1 else None
    unit = flat.axis_info[0].unit_name if flat.axis_info else "unknown"
    area = system.area_of_use or flat.area_of_use
    bounds_deg = None if area is None or area.west > area.east else area.bounds
    return ProjSystem(name=system.name, horizontal_epsg=flat.to_epsg(), vertical_epsg=vertical_epsg, unit=unit, bounds_deg=bounds_deg)


def project(definition: str, lat_lon_alt: FloatArray, title: str) -> FloatArray:
    """East, north, up (P,3) of geodetic places (P,3) [deg, deg, m]; BadInput, with the system's
    `title`, where it does not reach or a grid is missing."""
    lat, lon, alt = lat_lon_alt.T
    return _transform(definition, np.column_stack([lon, lat, alt]), title, inverse=False)


def unproject(definition: str, places: FloatArray, title: str) -> FloatArray:
    """The inverse of `project`."""
    lon, lat, alt = _transform(definition, places, title, inverse=True).T
    return np.column_stack([lat, lon, alt])


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


@lru_cache(maxsize=16)
def _transformer(definition: str) -> Any:
    from pyproj import Transformer

    with warnings.catch_warnings():
        # What it warns of is an error below.
        warnings.simplefilter("ignore", UserWarning)
        return Transformer.from_crs(GEODETIC_3D, _system(definition), always_xy=True, only_best=True, allow_ballpark=False)


def _transform(definition: str, places: FloatArray, title: str, *, inverse: bool) -> FloatArray:
    from pyproj.enums import TransformDirection
    from pyproj.exceptions import ProjError

    direction = TransformDirection.INVERSE if inverse else TransformDirection.FORWARD
    try:
        found = np.column_stack(_transformer(definition).transform(*places.T, direction=direction, errcheck=True))
    except ProjError as error:
        raise _failure(title, str(error)) from None
    if not np.isfinite(found).all():
        raise BadInput(f"a place lies where {title} does not reach: is it the system of this scene?")
    return found.reshape(-1, 3)


def _failure(title: str, text: str) -> BadInput:
    grid = _GRID.search(text)
    if grid is not None:
        name = grid[1].rstrip(".")
        return BadInput(
            f"{title} needs the grid {name}, which is not installed: get it with `pyproj sync --file {name.removesuffix('.tif')}`, "
            "or name the system without its vertical datum."
        )
    return BadInput(f"{title} cannot be computed here ({text.split(': ', 1)[-1].strip().rstrip('.)')}): is it the system of this scene?")
