"""A photograph's position as it is written into XMP. Once per photograph.

    exif:GPSLatitude               "47,22.1234N", "47,22,7.4N", or decimal degrees with a sign
    drone-dji:GpsLatitude          decimal degrees; GpsLongtitude is how DJI spells it
    exif:GPSAltitude               "4555/10" m, negative where GPSAltitudeRef is 1 or 3
    drone-dji:AbsoluteAltitude     metres with a sign

RelativeAltitude counts from take-off, which is no altitude, and IPTC's LocationShown is the place
of what is seen. Attributes and elements alike; the packet is searched, never parsed: it comes from
strangers.
"""

from __future__ import annotations

import math
import re

from radiant_core.io.photos.gps import Position, on_globe

_START = rb"[\s<:]"
_VALUE = rb"\s{0,4}(?:=\s{0,4}[\"']|>)\s{0,8}([^\"'<>]{1,64})"
_LATITUDE = re.compile(_START + rb"(?:GPSLatitude|GpsLatitude|Latitude)" + _VALUE)
_LONGITUDE = re.compile(_START + rb"(?:GPSLongitude|GpsLongitude|GpsLongtitude|Longitude)" + _VALUE)
_ALTITUDE = re.compile(_START + rb"(?:AbsoluteAltitude|GPSAltitude|GpsAltitude)" + _VALUE)
_ALTITUDE_REF = re.compile(_START + rb"GPSAltitudeRef" + _VALUE)
_LOCATION_SHOWN = re.compile(rb"</?[\w-]{1,32}:LocationShown(?:\s[^<>]{0,255}[^/<>])?>")
_DEGREES = re.compile(r"([+-]?\d{1,3}(?:\.\d{1,15})?)(?:,(\d{1,3}(?:\.\d{1,15})?))?(?:,(\d{1,3}(?:\.\d{1,15})?))?\s?([NSEWnsew])?")
_METRES = re.compile(r"([+-]?\d{1,9}(?:\.\d{1,12})?)(?:/(\d{1,9}))?(?:\s?m)?")


def xmp_position(packet: bytes) -> Position | None:
    """Degrees north and east and metres (NaN without an altitude), or None; never raises."""
    packet = _of_camera(packet)
    lat, lon = _degrees(_text(_LATITUDE, packet), "NS"), _degrees(_text(_LONGITUDE, packet), "EW")
    if lat is None or lon is None:
        return None
    return on_globe(lat, lon, _metres(packet))


def xmp_counts_from_sea(packet: bytes) -> bool:
    """Whether the packet says that its altitude counts from the sea; never raises."""
    packet = _of_camera(packet)
    return not math.isnan(_metres(packet)) and _text(_ALTITUDE_REF, packet) in ("2", "3")


def _of_camera(packet: bytes) -> bytes:
    """The packet without places that the photograph shows, each between its two tags."""
    return b"".join(_LOCATION_SHOWN.split(packet)[::2])


def _text(pattern: re.Pattern[bytes], packet: bytes) -> str:
    match = pattern.search(packet)
    return match[1].decode("ascii", "replace").strip() if match is not None else ""


def _degrees(written: str, letters: str) -> float | None:
    match = _DEGREES.fullmatch(written)
    if match is None:
        return None
    degrees, minutes, seconds, letter = match.groups()
    value = abs(float(degrees)) + float(minutes or 0) / 60 + float(seconds or 0) / 3600
    letter = (letter or "").upper()
    is_negative = degrees.startswith("-")
    if letter and (letter not in letters or (is_negative and letter == letters[0])):
        return None
    return -value if is_negative or letter == letters[1] else value


def _metres(packet: bytes) -> float:
    match = _METRES.fullmatch(_text(_ALTITUDE, packet))
    if match is None or (match[2] is not None and int(match[2]) == 0):
        return math.nan
    metres = float(match[1]) / float(match[2] or 1)
    return -abs(metres) if _text(_ALTITUDE_REF, packet) in ("1", "3") else metres
