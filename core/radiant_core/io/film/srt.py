"""Positions that drones write beside a film as subtitles (SRT). Once per film.

    [latitude: 41.42] [longitude: 2.23] [rel_alt: 1.3 abs_alt: 132.86]   also latitude :, longtitude
    [latitude: 41.42] [longitude: 2.23] [altitude: 117.0]
    GPS (-82.6669, 27.7716, 10)                    longitude first, then a number of satellites
    GPS(36.6146,-6.1120,0.0M) BAROMETER:0.3M       latitude first where an M follows the height

A number beyond ±90 is a longitude whatever the form. A position is written ten times a second and
repeated in between: one lies where it changes, and those of frames between two on the straight
line. Heights are those called abs_alt or altitude, which differ from each other and from the truth
by tens of metres; a height over the start is none.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from radiant_core.io.photos.gps import Position, on_globe
from radiant_core.io.run_store import read_bounded
from radiant_core.numerics import FloatArray

MAX_SRT_BYTES = 1 << 28
MAX_BEYOND_S = 2.0
"""How long before the first and after the last position a frame still has one."""
_NUMBER = r"([-+]?\d+(?:\.\d+)?)"
_TIME = re.compile(r"(\d{1,3}):(\d{1,2}):(\d{1,2})(?:[,.](\d{1,6}))?\s*-->")
_TAG = re.compile(r"<[^>]*>")
_LATITUDE = re.compile(rf"\blatitude\s*:\s*{_NUMBER}", re.IGNORECASE)
_LONGITUDE = re.compile(rf"\blongt?itude\s*:\s*{_NUMBER}", re.IGNORECASE)
_ALTITUDE = re.compile(rf"\b(?:abs_alt|altitude)\s*:\s*{_NUMBER}", re.IGNORECASE)
_GPS = re.compile(rf"\bGPS\s*\(\s*{_NUMBER}\s*,\s*{_NUMBER}(?:\s*,\s*{_NUMBER}\s*(M)?)?", re.IGNORECASE)


@dataclass(frozen=True, kw_only=True, eq=False)
class FilmTrack:
    """Positions (P,3) of a film, degrees and metres or NaN, at times_s (P,) of the film."""

    times_s: FloatArray
    lat_lon_alt: FloatArray

    def at(self, time_s: float) -> Position | None:
        """The position at a time; None where the track is too far away."""
        if not len(self.times_s) or not self.times_s[0] - MAX_BEYOND_S <= time_s <= self.times_s[-1] + MAX_BEYOND_S:
            return None
        lat, lon, alt = (float(np.interp(time_s, self.times_s, column)) for column in self.lat_lon_alt.T)
        return lat, lon, alt


def read_track(path: Path) -> FilmTrack:
    """The positions in an SRT, where they change; an empty track where it has none."""
    text = _TAG.sub(" ", read_bounded(path, MAX_SRT_BYTES).decode("utf-8", "replace"))
    marks = list(_TIME.finditer(text))
    times, places = [], list[Position]()
    for mark, following in zip(marks, [*marks[1:], None], strict=True):
        position = _position(text[mark.end() : following.start() if following else len(text)])
        if position is None or (places and _is_same_position(position, places[-1])):
            continue
        hours, minutes, seconds, fraction = mark.groups()
        time_s = 3600 * int(hours) + 60 * int(minutes) + int(seconds) + float(f"0.{fraction or 0}")
        if not times or time_s > times[-1]:
            times.append(time_s)
            places.append(position)
    return FilmTrack(times_s=np.array(times, float), lat_lon_alt=np.array(places, float).reshape(len(places), 3))


def _position(block: str) -> Position | None:
    latitude, longitude, altitude = _LATITUDE.search(block), _LONGITUDE.search(block), _ALTITUDE.search(block)
    if latitude and longitude:
        return on_globe(float(latitude[1]), float(longitude[1]), float(altitude[1]) if altitude else math.nan)
    pair = _GPS.search(block)
    if pair is None:
        return None
    first, second = float(pair[1]), float(pair[2])
    latitude_first = abs(second) > 90 or (pair[4] is not None and abs(first) <= 90)
    lat, lon = (first, second) if latitude_first else (second, first)
    return on_globe(lat, lon, math.nan)


def _is_same_position(first: Position, second: Position) -> bool:
    return all(a == b or (math.isnan(a) and math.isnan(b)) for a, b in zip(first, second, strict=True))
