"""Coordinate reference systems by name, and places on the globe in them. Once per file.

    EPSG:32632          a projected system; heights stay what they are, over the WGS84 ellipsoid
    EPSG:25832+7837     with a vertical datum: heights over it, by a grid of the geoid
    WGS84 UTM 32N       as OpenDroneMap writes it, and PROJ strings or WKT

Zones of UTM on WGS84 and plain longitude and latitude are computed here; whatever else is by PROJ
(`proj.py`, the extra geo). Axes are always east, north, up: x before y, longitude before latitude.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from radiant_core.errors import BadInput
from radiant_core.map_projection import geodetic_from_utm, utm_from_geodetic
from radiant_core.numerics import FloatArray, check_array

GEOGRAPHIC_EPSG = (4326, 4979)
EXPECTED = "expected EPSG:32632, EPSG:25832+7837 (with a vertical datum), WGS84 UTM 32N, a PROJ string or WKT"
_EPSG = re.compile(r"(?:EPSG:)?(\d{4,6})(?:\+(?:EPSG:)?(\d{4,6}))?", re.IGNORECASE)
_UTM_NAME = re.compile(r"WGS\s*84\s*(?:/\s*)?UTM\s*(?:zone\s*)?(\d{1,2})\s*([NS])", re.IGNORECASE)
_OPENING = re.compile(r"\+proj=|\+init=|(PROJ|GEOG|GEOD|COMPD|COMPOUND|BOUND|LOCAL)\w*\s*\[", re.IGNORECASE)
MARGIN_DEG = 5.0
"""So far beyond where it is used, a system is a mistake: neighbouring zones overlap."""
MAX_CHARACTERS = 20_000


@dataclass(frozen=True, kw_only=True)
class Crs:
    """A system by its definition; codes are None where EPSG has none."""

    definition: str
    """What PROJ reads: EPSG:32632, EPSG:25832+7837, WKT."""
    horizontal_epsg: int | None
    vertical_epsg: int | None = None
    own: bool = False
    """Whether it is computed without PROJ."""
    name: str = ""
    unit: str = "metre"
    """Of its plane: metre, a foot by its name, or degree."""
    bounds_deg: tuple[float, float, float, float] | None = None
    """West, south, east, north of where it is used, where that is known."""

    @property
    def title(self) -> str:
        """How messages and files name it."""
        return self.definition if self.horizontal_epsg is not None and len(self.definition) < 40 else self.name or "the given system"

    @property
    def heights(self) -> str:
        """What its heights count from, for a reader of a file."""
        if self.vertical_epsg is not None:
            return f"EPSG:{self.vertical_epsg}"
        return "as GPS or the ground control gave them, taken as over the WGS84 ellipsoid"

    def from_geodetic(self, lat_lon_alt: ArrayLike) -> FloatArray:
        """East, north, up (P,3) of latitudes, longitudes and ellipsoidal heights (P,3) [deg, deg,
        m]; BadInput where the system does not reach or a grid is missing."""
        places = check_array("lat_lon_alt", lat_lon_alt, (None, 3))
        if not self.own:
            from radiant_core.georef.proj import project

            self._require_used_at(places)
            return project(self.definition, places, self.title)
        if self.horizontal_epsg in GEOGRAPHIC_EPSG:
            return places[:, [1, 0, 2]]
        assert self.horizontal_epsg is not None
        return np.column_stack([utm_from_geodetic(places[:, :2], self.horizontal_epsg), places[:, 2]])

    def _require_used_at(self, lat_lon_alt: FloatArray) -> None:
        if self.bounds_deg is None or not len(lat_lon_alt):
            return
        west, south, east, north = self.bounds_deg
        lat, lon = np.median(lat_lon_alt[:, :2], axis=0).tolist()
        if not (south - MARGIN_DEG <= lat <= north + MARGIN_DEG and west - MARGIN_DEG <= lon <= east + MARGIN_DEG):
            raise BadInput(f"the scene lies at latitude {lat:.4f}°, longitude {lon:.4f}°, where {self.title} ({self.name}) is not used.")

    def to_geodetic(self, places: ArrayLike) -> FloatArray:
        """The inverse of `from_geodetic`; BadInput for places that are not on the globe."""
        places = check_array("places", places, (None, 3))
        if not self.own:
            from radiant_core.georef.proj import unproject

            found = unproject(self.definition, places, self.title)
        elif self.horizontal_epsg in GEOGRAPHIC_EPSG:
            found = places[:, [1, 0, 2]]
        else:
            assert self.horizontal_epsg is not None
            _require_utm_reach(places, self.title)
            found = np.column_stack([geodetic_from_utm(places[:, :2], self.horizontal_epsg), places[:, 2]])
        if (np.abs(found[:, 0]) > 90).any() or (np.abs(found[:, 1]) > 180).any():
            raise BadInput(f"a place is off the globe in {self.title}: are east and north, or longitude and latitude, exchanged?")
        return found

    def wkt(self) -> str:
        """The system as WKT in one line, for a .prj file: as ESRI writes it, which all read."""
        if self.own and self.horizontal_epsg not in GEOGRAPHIC_EPSG:
            assert self.horizontal_epsg is not None
            return _utm_wkt(self.horizontal_epsg)
        from radiant_core.georef.proj import wkt_of

        return wkt_of(self.definition)


def parse_crs(text: str) -> Crs:
    """The system that `text` names; BadInput where PROJ does not know it either."""
    text = text.strip()
    if not 0 < len(text) <= MAX_CHARACTERS or not text.isprintable():
        raise BadInput(f"the coordinate system {text[:60]!r} is unknown: {EXPECTED}.")
    utm = _UTM_NAME.fullmatch(text) or _utm_string(text)
    if utm is not None:
        zone, letter = int(utm[1]), (utm[2] or "N").upper()
        return _own_utm((32600 if letter == "N" else 32700) + zone)
    epsg = _EPSG.fullmatch(text)
    if epsg is None and _OPENING.match(text) is None:
        raise BadInput(f"the coordinate system {text[:60]!r} is unknown: {EXPECTED}.")
    if epsg is not None and epsg[2] is None:
        code = int(epsg[1])
        if code // 100 in (326, 327) and 1 <= code % 100 <= 60:
            return _own_utm(code)
        if code in GEOGRAPHIC_EPSG:
            return Crs(definition=f"EPSG:{code}", horizontal_epsg=code, own=True, name="WGS 84", unit="degree")
    from radiant_core.georef.proj import described

    definition = text if epsg is None else f"EPSG:{epsg[1]}" + (f"+{epsg[2]}" if epsg[2] else "")
    system = described(definition)
    if system is None:
        raise BadInput(f"the coordinate system {text[:60]!r} is unknown or has no east and north: {EXPECTED}.")
    return Crs(
        definition=definition,
        horizontal_epsg=system.horizontal_epsg,
        vertical_epsg=system.vertical_epsg,
        name=system.name,
        unit=system.unit,
        bounds_deg=system.bounds_deg,
    )


def _utm_string(text: str) -> re.Match[str] | None:
    """The zone of a PROJ string of UTM on WGS84, as OpenDroneMap's lists often begin with."""
    parts = text.split()
    about_wgs84 = "+datum=WGS84" in parts or "+ellps=WGS84" in parts
    others = [part for part in parts if part.startswith(("+towgs84", "+geoidgrids", "+vunits", "+to_meter", "+nadgrids"))]
    if "+proj=utm" not in parts or not about_wgs84 or others or "+units=us-ft" in parts:
        return None
    zone = next((part.removeprefix("+zone=") for part in parts if part.startswith("+zone=")), "")
    return re.fullmatch(r"(\d{1,2})([NS])", f"{zone}{'S' if '+south' in parts else 'N'}")


def _own_utm(epsg: int) -> Crs:
    zone, letter = epsg % 100, "N" if epsg < 32700 else "S"
    if not 1 <= zone <= 60:
        raise BadInput(f"there is no UTM zone {zone}: zones are 1 to 60.")
    return Crs(definition=f"EPSG:{epsg}", horizontal_epsg=epsg, own=True, name=f"WGS 84 / UTM zone {zone}{letter}")


def _require_utm_reach(places: FloatArray, title: str) -> None:
    east, north = places[:, 0], places[:, 1]
    if ((east < 100e3) | (east > 900e3) | (north < -1e5) | (north > 10e6 + 1e5)).any():
        raise BadInput(f"a place has an easting or northing that no UTM zone has in {title}: east and north in metres, in this order.")


def _utm_wkt(epsg: int) -> str:
    zone, south = epsg % 100, epsg >= 32700
    return (
        f'PROJCS["WGS_1984_UTM_Zone_{zone}{"S" if south else "N"}",GEOGCS["GCS_WGS_1984",DATUM["D_WGS_1984",'
        'SPHEROID["WGS_1984",6378137.0,298.257223563]],PRIMEM["Greenwich",0.0],UNIT["Degree",0.0174532925199433]],'
        f'PROJECTION["Transverse_Mercator"],PARAMETER["False_Easting",500000.0],PARAMETER["False_Northing",{1e7 if south else 0.0}],'
        f'PARAMETER["Central_Meridian",{6.0 * zone - 183.0}],PARAMETER["Scale_Factor",0.9996],PARAMETER["Latitude_Of_Origin",0.0],'
        'UNIT["Meter",1.0]]'
    )
