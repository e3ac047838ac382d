"""A position as EXIF, for frames of films, which have none. Once per frame.

Seconds of arc in steps of 10⁻⁶ (30 µm), heights in millimetres (EXIF 2.3, GPS IFD).
"""

from __future__ import annotations

import math
import struct
from typing import NamedTuple

from radiant_core.io.photos.gps import Position

_BYTE, _ASCII, _LONG, _RATIONAL = 1, 2, 4, 5
_GPS_IFD, _ARC_STEPS = 0x8825, 1_000_000


class _Entry(NamedTuple):
    """One field of a directory: its tag, type, number of values and their bytes."""

    tag: int
    kind: int
    number: int
    data: bytes


def with_position(jpeg: bytes, position: Position) -> bytes:
    """A JPEG with its position (degrees, degrees, metres or NaN) in an EXIF segment of its own."""
    lat, lon, alt = position
    entries = [
        _Entry(0, _BYTE, 4, bytes((2, 3, 0, 0))),
        _Entry(1, _ASCII, 2, b"N\0" if lat >= 0 else b"S\0"),
        _Entry(2, _RATIONAL, 3, _arc(abs(lat))),
        _Entry(3, _ASCII, 2, b"E\0" if lon >= 0 else b"W\0"),
        _Entry(4, _RATIONAL, 3, _arc(abs(lon))),
    ]
    if not math.isnan(alt):
        entries += [_Entry(5, _BYTE, 1, bytes((alt < 0,))), _Entry(6, _RATIONAL, 1, struct.pack("<II", round(1000 * abs(alt)), 1000))]
    # The header and a first directory with one pointer, whose four last bytes end the list.
    gps_at = 8 + 2 + 12 + 4
    first = struct.pack("<2sHIHHHIII", b"II", 42, 8, 1, _GPS_IFD, _LONG, 1, gps_at, 0)
    segment = b"Exif\0\0" + first + _directory(entries, gps_at)
    assert jpeg[:2] == b"\xff\xd8"
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment + jpeg[2:]


def _arc(angle_deg: float) -> bytes:
    steps = round(angle_deg * 3600 * _ARC_STEPS)
    minutes, seconds = divmod(steps, 60 * _ARC_STEPS)
    return struct.pack("<6I", minutes // 60, 1, minutes % 60, 1, seconds, _ARC_STEPS)


def _directory(entries: list[_Entry], at: int) -> bytes:
    """A directory at an offset of the header, its longer values behind it."""
    behind_at = at + 2 + 12 * len(entries) + 4
    rows, behind = [], b""
    for entry in entries:
        if len(entry.data) <= 4:
            value = entry.data.ljust(4, b"\0")
        else:
            value = struct.pack("<I", behind_at + len(behind))
            behind += entry.data
        rows.append(struct.pack("<HHI", entry.tag, entry.kind, entry.number) + value)
    return struct.pack("<H", len(entries)) + b"".join(rows) + struct.pack("<I", 0) + behind
