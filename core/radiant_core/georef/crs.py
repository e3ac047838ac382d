"""Coordinate reference systems by name, and places on the globe in them. Once per file.

    EPSG:32632          a projected system; heights stay what they are, over the WGS84 ellipsoid
    EPSG:25832+7837     with a vertical datum: heights over it, by a grid of the geoid
    EPSG:2263+6360      in feet, its heights too
    WGS84 UTM 32N       as OpenDroneMap writes it, and PROJ strings or WKT

Heights are in the unit of the vertical datum where one is named, else in that of the plane, metres
beside degrees. Zones of UTM on WGS84 and plain longitude and latitude are computed here; whatever
else is by PROJ (`proj.py`, the extra geo). Axes are always east, north, up: x before y, longitude
before latitude.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from radiant_core.errors import BadInput
from radiant_core.map_projection import geodetic_from_utm, utm_from_geodetic
from radiant_core.numerics import FloatArray, check_array

GEOGRAPHIC_EPSG = (4326, 4979)
EXPECTED = "expected EPSG:32632, EPSG:25832+7837 (with a vertical datum), WGS84 UTM 32N, a PROJ string or WKT"
_EPSG = re.compile(r"(?:EPSG\s*:{0,2}\s*)?(\d{4,6})(?:\s*\+\s*(?:EPSG\s*:{0,2}\s*)?(\d{4,6}))?", re.IGNORECASE)
_UTM_NAME = re.compile(r"WGS[\s_-]*(?:19)?84[\s/,_-]*UTM[\s_]*(?:zone[\s_]*)?(\d{1,2})\s*([NS])", re.IGNORECASE)
_WGS84_NAME = re.compile(r"WGS[\s_-]*(?:19)?84", re.IGNORECASE)
_UTM_KEYS = ("+proj=utm", "+zone=", "+south", "+north", "+datum=WGS84", "+ellps=WGS84", "+units=m", "+no_defs", "+type=crs", "+wktext")
"""Parts of a PROJ string that leave a zone on WGS84 what it is; any other is PROJ's."""
_OPENING = re.compile(r"\+proj=|\+init=|(PROJ|GEOG|GEOD|COMPD|COMPOUND|BOUND|LOCAL)\w*\s*\[", re.IGNORECASE)
MAX_NORTHERN_NORTHING_M, MIN_SOUTHERN_NORTHING_M = 9.4e6, 1.1e6
MARGIN_DEG = 5.0
"""So far beyond where it is used, a system is a mistake: neighbouring zones overlap."""
USED_HINT = ": are they of another zone, in another unit, or are east and north exchanged?"
MAX_CHARACTERS = 20_000


@dataclass(frozen=True, kw_only=True)
class Crs:
    """A system by its definition; codes are None where EPSG has none."""

    definition: str
    """What PROJ reads: EPSG:32632, EPSG:25832+7837, WKT."""
    horizontal_epsg: int | None
    vertical_epsg: int | None = None
    is_builtin: bool = False
    """Whether it is computed without PROJ."""
    name: str = ""
    unit: str = "metre"
    """Of its plane: metre, a foot by its name, degree."""
    unit_m: float | None = 1.0
    """Its metres; None for an angle."""
    height_unit: str = "metre"
    height_unit_m: float = 1.0
    vertical_name: str = ""
    """Of the datum of its heights, empty where it has none."""
    axes: tuple[str, str] = ("east", "north")
    bounds_deg: tuple[float, float, float, float] | None = None
    """West, south, east, north of where it is used, where that is known."""
    near: tuple[float, float] | None = None
    """Latitude and longitude of the site whose best operation is used for all places; None: that of
    the middle of the places given."""

    @property
    def title(self) -> str:
        """How messages and files name it."""
        if self.horizontal_epsg is not None and len(self.definition) < 40:
            return self.definition
        return self.name or (self.definition if len(self.definition) < 100 else "the given system")

    @property
    def heights(self) -> str:
        """What its heights count from, for a reader of a file."""
        datum = f"EPSG:{self.vertical_epsg}" if self.vertical_epsg is not None else self.vertical_name
        datum = datum or "as GPS or the ground control gave them, taken as over the WGS84 ellipsoid"
        return datum if self.height_unit == "metre" else f"{datum}, in units of 1 {self.height_unit}"

    @property
    def equal_units(self) -> bool:
        """Whether plane and heights have one unit, but for the feet of surveyors, 2 ppm longer."""
        return self.unit_m is not None and abs(self.height_unit_m / self.unit_m - 1) < 1e-4

    def at(self, lat_deg: float, lon_deg: float) -> Crs:
        """The system for a site: one operation for all its places."""
        return replace(self, near=(float(lat_deg), float(lon_deg)))

    def shortfall(self, lat_deg: float, lon_deg: float) -> str | None:
        """One sentence where PROJ lacks grids for the best it could do at a place: their names, the
        accuracy of what is used instead in metres, how to get them; None where nothing is lacking,
        or nothing can be computed without them, which whatever computes refuses."""
        if self.is_builtin:
            return None
        from radiant_core.georef.operation import operation_at, shortfall

        return shortfall(operation_at(self.definition, float(lat_deg), float(lon_deg)), self.title)

    def shortfall_over(self, lat_lon: FloatArray) -> str | None:
        """`shortfall` in the middle of at least one place (P,2 or 3) [deg, deg]."""
        if self.is_builtin:
            return None
        from radiant_core.georef.proj import middle_deg

        return self.shortfall(*(middle_deg(lat_lon) if self.near is None else self.near))

    def coarseness_over(self, lat_lon: FloatArray) -> str | None:
        """One sentence where even the best operation in the middle of at least one place (P,2 or 3)
        [deg, deg] is worse than GPS; None where it is not, or nobody says."""
        if self.is_builtin:
            return None
        from radiant_core.georef.operation import coarseness, operation_at
        from radiant_core.georef.proj import middle_deg

        return coarseness(operation_at(self.definition, *(middle_deg(lat_lon) if self.near is None else self.near)), self.title)

    def from_geodetic(self, lat_lon_alt: ArrayLike) -> FloatArray:
        """East, north, up (P,3) of latitudes, longitudes and ellipsoidal heights (P,3) [deg, deg,
        m], in the units of the system; BadInput where it does not reach or nothing can be computed
        without a grid."""
        places = check_array("lat_lon_alt", lat_lon_alt, (None, 3))
        if not self.is_builtin:
            from radiant_core.georef.proj import project

            self._require_used_at(places, "the scene lies")
            return project(self.definition, places, self.title, self.near)
        if self.horizontal_epsg in GEOGRAPHIC_EPSG:
            return places[:, [1, 0, 2]]
        assert self.horizontal_epsg is not None
        return np.column_stack([utm_from_geodetic(places[:, :2], self.horizontal_epsg), places[:, 2]])

    def is_used_at(self, lat_deg: float, lon_deg: float) -> bool:
        """Whether a place lies where the system is used, or within 5° of there."""
        if self.bounds_deg is None:
            return True
        west, south, east, north = self.bounds_deg
        return south - MARGIN_DEG <= lat_deg <= north + MARGIN_DEG and west - MARGIN_DEG <= lon_deg <= east + MARGIN_DEG

    def _require_used_at(self, lat_lon: FloatArray, subject: str, hint: str = ".") -> None:
        """Raise BadInput where the middle of places (P,2 or 3) is not where the system is used."""
        from radiant_core.georef.proj import middle_deg

        lat, lon = middle_deg(lat_lon) if len(lat_lon) else (0.0, 0.0)
        if len(lat_lon) and not self.is_used_at(lat, lon):
            raise BadInput(f"{subject} at latitude {lat:g}°, longitude {lon:g}°, where {self.title} ({self.name}) is not used{hint}")

    def to_geodetic(self, places: ArrayLike) -> FloatArray:
        """The inverse of `from_geodetic`; BadInput for places that are not on the globe."""
        places = check_array("places", places, (None, 3))
        if not self.is_builtin:
            from radiant_core.georef.proj import rough_geodetic, unproject

            self._require_used_at(rough_geodetic(self.definition, places, self.title), "the places lie", USED_HINT)
            geodetic = unproject(self.definition, places, self.title, self.near)
        elif self.horizontal_epsg in GEOGRAPHIC_EPSG:
            geodetic = places[:, [1, 0, 2]]
        else:
            assert self.horizontal_epsg is not None
            _require_utm_reach(places, self.horizontal_epsg, self.title)
            geodetic = np.column_stack([geodetic_from_utm(places[:, :2], self.horizontal_epsg), places[:, 2]])
        if (np.abs(geodetic[:, 0]) > 90).any() or (np.abs(geodetic[:, 1]) > 180).any():
            raise BadInput(f"a place is off the globe in {self.title}: are east and north, or longitude and latitude, exchanged?")
        return geodetic

    def wkt(self) -> str:
        """The system as WKT in one line, for a .prj file: as ESRI writes it, which all read."""
        if self.is_builtin and self.horizontal_epsg not in GEOGRAPHIC_EPSG:
            assert self.horizontal_epsg is not None
            return _utm_wkt(self.horizontal_epsg)
        from radiant_core.georef.proj import wkt_of

        return wkt_of(self.definition)


def grid_warnings(crs: Crs, lat_lon: FloatArray, *, require_grids: bool = False) -> tuple[str, ...]:
    """What PROJ lacks for places (P,2 or 3) [deg, deg] in `crs`, as `Crs.shortfall`, which
    `require_grids` makes BadInput, or that its best is coarse: nothing or one warning."""
    lacking = crs.shortfall_over(lat_lon)
    if lacking is not None and require_grids:
        raise BadInput(f"{lacking.removesuffix('.')}, or leave out --require-grids.")
    sentence = crs.coarseness_over(lat_lon) if lacking is None else lacking
    return () if sentence is None else (sentence,)


def parse_crs(text: str) -> Crs:
    """The system that `text` names; BadInput where PROJ does not know it either."""
    text = text.strip().strip("'\"").strip()
    if not 0 < len(text) <= MAX_CHARACTERS or not text.isprintable():
        raise BadInput(f"the coordinate system {text[:60]!r} is unknown: {EXPECTED}.")
    utm = _UTM_NAME.fullmatch(text) or _utm_string(text)
    if utm is not None:
        zone, letter = int(utm[1]), (utm[2] or "N").upper()
        return _own_utm((32600 if letter == "N" else 32700) + zone)
    if _WGS84_NAME.fullmatch(text):
        text = "EPSG:4326"
    epsg = _EPSG.fullmatch(text)
    if epsg is None and _OPENING.match(text) is None:
        raise BadInput(f"the coordinate system {text[:60]!r} is unknown: {EXPECTED}.")
    if epsg is not None and epsg[2] is None:
        code = int(epsg[1])
        if code // 100 in (326, 327) and 1 <= code % 100 <= 60:
            return _own_utm(code)
        if code in GEOGRAPHIC_EPSG:
            return Crs(definition=f"EPSG:{code}", horizontal_epsg=code, is_builtin=True, name="WGS 84", unit="degree", unit_m=None)
    from radiant_core.georef.proj import described

    definition = text if epsg is None else f"EPSG:{epsg[1]}" + (f"+{epsg[2]}" if epsg[2] else "")
    system = described(definition)
    if system is None:
        raise BadInput(f"the coordinate system {text[:60]!r} is unknown or has no east and north: {EXPECTED}.")
    if system.heights_count_down:
        raise BadInput(f"heights of {text[:60]!r} ({system.vertical_name or system.name}) count downwards: name a datum of heights.")
    return Crs(
        definition=definition,
        horizontal_epsg=system.horizontal_epsg,
        vertical_epsg=system.vertical_epsg,
        name=system.name,
        unit=system.unit,
        unit_m=system.unit_m,
        height_unit=system.height_unit,
        height_unit_m=system.height_unit_m,
        vertical_name=system.vertical_name,
        axes=system.axes,
        bounds_deg=system.bounds_deg,
    )


def _utm_string(text: str) -> re.Match[str] | None:
    """The zone of a PROJ string of UTM in metres on WGS84, as OpenDroneMap's lists often begin
    with."""
    parts = [part.removesuffix("=True") for part in text.split()]
    about_wgs84 = "+datum=WGS84" in parts or "+ellps=WGS84" in parts
    if "+proj=utm" not in parts or not about_wgs84 or not all(part.startswith("+zone=") or part in _UTM_KEYS for part in parts):
        return None
    zone = next((part.removeprefix("+zone=") for part in parts if part.startswith("+zone=")), "")
    return re.fullmatch(r"(\d{1,2})([NS])", f"{zone}{'S' if '+south' in parts else 'N'}")


def _own_utm(epsg: int) -> Crs:
    zone, letter = epsg % 100, "N" if epsg < 32700 else "S"
    if not 1 <= zone <= 60:
        raise BadInput(f"there is no UTM zone {zone}: zones are 1 to 60.")
    return Crs(definition=f"EPSG:{epsg}", horizontal_epsg=epsg, is_builtin=True, name=f"WGS 84 / UTM zone {zone}{letter}")


def _require_utm_reach(places: FloatArray, epsg: int, title: str) -> None:
    east, north = places[:, 0], places[:, 1]
    if ((east < 100e3) | (east > 900e3) | (north < -1e5) | (north > 10e6 + 1e5)).any():
        raise BadInput(f"a place has an easting or northing that no UTM zone has in {title}: east and north in metres, in this order.")
    # UTM ends at 84° north and 80° south: at the equator the other hemisphere's numbers lie beyond.
    is_south = epsg >= 32700
    beyond = north < MIN_SOUTHERN_NORTHING_M if is_south else north > MAX_NORTHERN_NORTHING_M
    if beyond.any():
        opposite_zone = f"{epsg % 100}{'N' if is_south else 'S'}"
        raise BadInput(
            f"the northing {float(north[beyond][0]):,.0f} m lies beyond {'80° south' if is_south else '84° north'} in {title}, "
            f"where UTM ends: is it one of zone {opposite_zone}, the other hemisphere?"
        )


def _utm_wkt(epsg: int) -> str:
    zone, south = epsg % 100, epsg >= 32700
    return (
        f'PROJCS["WGS_1984_UTM_Zone_{zone}{"S" if south else "N"}",GEOGCS["GCS_WGS_1984",DATUM["D_WGS_1984",'
        'SPHEROID["WGS_1984",6378137.0,298.257223563]],PRIMEM["Greenwich",0.0],UNIT["Degree",0.0174532925199433]],'
        f'PROJECTION["Transverse_Mercator"],PARAMETER["False_Easting",500000.0],PARAMETER["False_Northing",{1e7 if south else 0.0}],'
        f'PARAMETER["Central_Meridian",{6.0 * zone - 183.0}],PARAMETER["Scale_Factor",0.9996],PARAMETER["Latitude_Of_Origin",0.0],'
        'UNIT["Meter",1.0]]'
    )
