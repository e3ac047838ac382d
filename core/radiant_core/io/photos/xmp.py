"""What makers write into XMP: how accurate a photograph's position is, and whether it is a
panorama. Once per photograph.

    DJI                       drone-dji:RtkStdLon, RtkStdLat, RtkStdHgt
    Parrot, senseFly, others  Camera:GPSXYAccuracy, GPSZAccuracy
    panoramas                 GPano:ProjectionType; FullPanoWidthPixels beside CroppedArea…

Attributes and elements alike; the packet is searched, never parsed: it comes from strangers.
"""

from __future__ import annotations

import re
from typing import Literal

VERTICAL_SHARE = 1.5
"""Heights by satellites are worse than places by so much, where one figure stands for both."""
MAX_PACKET_BYTES = 1 << 16
MAX_SIGMA_M = 1e4
_RTK = (b"RtkStdLon", b"RtkStdLat", b"RtkStdHgt")
_PLANE, _HEIGHT = b"GPSXYAccuracy", b"GPSZAccuracy"
_PROJECTION = re.compile(rb"[\s<:]ProjectionType\s{0,4}(?:=\s{0,4}[\"']|>)\s{0,4}equirectangular", re.IGNORECASE)
_WHOLE_AND_SHOWN = (
    (b"FullPanoWidthPixels", b"CroppedAreaImageWidthPixels"),
    (b"FullPanoHeightPixels", b"CroppedAreaImageHeightPixels"),
)
Sphere = Literal["", "whole", "part"]
"""Of an equirectangular panorama: whether the picture is all of the sphere."""


def xmp_sigma_m(packet: bytes) -> tuple[float, float, float] | None:
    """Standard deviations east, north, up in metres, or None; never raises."""
    packet = packet[:MAX_PACKET_BYTES]
    east, north, up = (_number(packet, name) for name in _RTK)
    if east is not None and north is not None and up is not None:
        return east, north, up
    plane, height = _number(packet, _PLANE), _number(packet, _HEIGHT)
    if plane is None:
        return None
    return plane, plane, VERTICAL_SHARE * plane if height is None else height


def xmp_sphere(packet: bytes) -> Sphere:
    """How much of the sphere an equirectangular panorama shows; empty where it says that it is
    none, or nothing; never raises."""
    packet = packet[:MAX_PACKET_BYTES]
    if _PROJECTION.search(packet) is None:
        return ""
    sides = [tuple(_written(packet, name) for name in names) for names in _WHOLE_AND_SHOWN]
    return "part" if any(whole and visible and visible < whole for whole, visible in sides) else "whole"


def _number(packet: bytes, name: bytes) -> float | None:
    value = _written(packet, name)
    return value if 0 < value < MAX_SIGMA_M else None


def _written(packet: bytes, name: bytes) -> float:
    """A number that is not negative; 0 where there is none."""
    match = re.search(rb"[\s<:]" + name + rb"\s{0,4}(?:=\s{0,4}[\"']|>)\s{0,4}\+?([0-9]{1,6}(?:\.[0-9]{1,12})?)", packet)
    return float(match[1]) if match is not None else 0.0
