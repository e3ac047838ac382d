"""How accurate a photograph's position is, as makers write it into XMP. Once per photograph.

    DJI                       drone-dji:RtkStdLon, RtkStdLat, RtkStdHgt
    Parrot, senseFly, others  Camera:GPSXYAccuracy, GPSZAccuracy

Attributes and elements alike; the packet is searched, never parsed: it comes from strangers.
"""

from __future__ import annotations

import re

VERTICAL_SHARE = 1.5
"""Heights by satellites are worse than places by so much, where one figure stands for both."""
MAX_PACKET_BYTES = 1 << 16
MAX_SIGMA_M = 1e4
_RTK = (b"RtkStdLon", b"RtkStdLat", b"RtkStdHgt")
_PLANE, _HEIGHT = b"GPSXYAccuracy", b"GPSZAccuracy"


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


def _number(packet: bytes, name: bytes) -> float | None:
    found = re.search(rb"[\s<:]" + name + rb"\s{0,4}(?:=\s{0,4}[\"']|>)\s{0,4}\+?([0-9]{1,6}(?:\.[0-9]{1,12})?)", packet)
    value = float(found[1]) if found is not None else 0.0
    return value if 0 < value < MAX_SIGMA_M else None
