"""The position in the GPS directory of EXIF, in every form that writers give it.

    degrees = ±(d + m/60 + s/3600)     negative south and west; one, two or three numbers
    altitude = ±a                      GPSAltitudeRef 0 and 2: above, 1 and 3: below

EXIF 2.32 has references 0 and 1, of the sea. EXIF 3.0 (CIPA DC-008-2023, GPSAltitudeRef) adds 2 and
3 for the sea and calls 0 and 1 heights of the ellipsoid; writers have not followed, so 2 and 3 say
what an altitude counts from, and 0 and 1 its sign alone. Once per photograph.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from radiant_core.io.photos.tiff import Value, number, text

LATITUDE_REF, LATITUDE, LONGITUDE_REF, LONGITUDE, ALTITUDE_REF, ALTITUDE = range(1, 7)
MAP_DATUM, GPS_ERROR = 0x12, 0x1F
_BELOW, _OF_SEA = (1, 3), (2, 3)
_WEIGHTS = np.array([1, 1 / 60, 1 / 3600])
Position = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Fix:
    """A position (degrees north and east, metres or NaN), or why what stands there is none."""

    lat_lon_alt: Position | None = None
    fault: str = ""
    datum: str = ""
    """Of the map, where it is said and another than WGS 84."""
    counts_from_sea: bool = False
    """Whether it is said that the altitude does."""


def read_fix(gps: Mapping[int, Value]) -> Fix:
    """The position in a GPS directory; without one and without a fault where none was written."""
    if LATITUDE not in gps or LONGITUDE not in gps:
        return Fix()
    lat, lon = _degrees(gps[LATITUDE], gps.get(LATITUDE_REF), "NS"), _degrees(gps[LONGITUDE], gps.get(LONGITUDE_REF), "EW")
    if isinstance(lat, str) or isinstance(lon, str):
        return Fix(fault=lat if isinstance(lat, str) else str(lon))
    position = on_globe(lat, lon, _altitude(gps))
    return Fix(
        lat_lon_alt=position,
        fault="" if position or not (lat or lon) else f"a position of {lat:g}°, {lon:g}°",
        datum=_datum(gps),
        counts_from_sea=position is not None and not math.isnan(position[2]) and _reference(gps) in _OF_SEA,
    )


def on_globe(lat: float, lon: float, alt: float) -> Position | None:
    """The position where there is such a place; None also for 0, 0, which receivers without a fix
    write."""
    if not (math.isfinite(lat) and math.isfinite(lon)) or abs(lat) > 90 or abs(lon) > 180 or (lat == 0 and lon == 0):
        return None
    return lat, lon, alt if math.isfinite(alt) else math.nan


def _altitude(gps: Mapping[int, Value]) -> float:
    alt = number(gps.get(ALTITUDE))
    if alt is None:
        return math.nan
    return -alt if _reference(gps) in _BELOW else alt


def _reference(gps: Mapping[int, Value]) -> float | None:
    """GPSAltitudeRef; the standard's type is a byte; some write a short, or the digit as text."""
    reference = gps.get(ALTITUDE_REF)
    return number(reference) if not isinstance(reference, bytes) else reference[:1][0] - 48 * (reference[:1] in b"0123")


def _datum(gps: Mapping[int, Value]) -> str:
    datum = text(gps.get(MAP_DATUM))
    plain = "".join(letter for letter in datum.upper() if letter.isalnum())
    return "" if plain in ("", "WGS84", "WGS1984", "EPSG4326", "UNKNOWN") else datum


def _degrees(value: Value, reference: Value | None, letters: str) -> float | str:
    """Degrees of up to three numbers with their letter, or what is wrong with them."""
    name = "latitude" if letters == "NS" else "longitude"
    if isinstance(value, bytes) or not 1 <= len(value) <= 3:
        return f"a {name} that is no degrees, minutes and seconds"
    # Minutes and seconds that were left out are written as 0/0.
    parts = np.array([value[0], *np.nan_to_num(value[1:], nan=0.0, posinf=np.inf)])
    degrees = float(parts @ _WEIGHTS[: len(parts)])
    if not math.isfinite(degrees):
        return f"a {name} divided by zero"
    letter = reference.replace(b"\0", b" ").decode("ascii", "replace").strip()[:1].upper() if isinstance(reference, bytes) else ""
    if letter not in letters or not letter:
        return degrees if degrees < 0 else f"a {name} without its letter {letters[0]} or {letters[1]}"
    if degrees < 0 and letter == letters[0]:
        return f"a negative {name} with the letter {letter}"
    return -abs(degrees) if letter == letters[1] else degrees
