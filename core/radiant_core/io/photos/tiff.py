"""Directories of a TIFF block, which EXIF is too: classic and BigTIFF, in both byte orders.

A directory is a list of (tag, type, count, value or where it stands). Once per photograph; never
raises, whatever the bytes are. Layout: TIFF 6.0 section 2, and the BigTIFF design of libtiff.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

import numpy as np

from radiant_core.numerics import FloatArray

MAX_VALUE_BYTES = 1024
"""Of one tag: none that is read here needs more, and a directory may name thousands of 64 KiB, all
of the same bytes."""
MAX_PACKET_BYTES = 1 << 16
"""Of the one tag that holds an XMP packet."""
XMP_PACKET = 0x02BC
Value = bytes | FloatArray
"""A tag's value: bytes of text or undefined types, else its numbers as float64."""

_BYTES, _RATIONALS = (1, 2, 7, 129), (5, 10)
"""129 is text in UTF-8, which EXIF 3.0 has for names of makers, cameras and lenses."""
_NUMBERS = {3: "u2", 4: "u4", 5: "u4", 9: "i4", 10: "i4", 11: "f4", 12: "f8", 13: "u4", 16: "u8", 17: "i8", 18: "u8"}
_TYPE_BYTES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 7: 1, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4, 16: 8, 17: 8, 18: 8, 129: 1}


@dataclass(frozen=True, kw_only=True)
class _Layout:
    """How a file writes its directories: byte order, and the widths that BigTIFF doubles."""

    order: str
    count: str
    entry: str
    offset: str
    first_at: int

    @property
    def entry_bytes(self) -> int:
        return struct.calcsize(self.order + self.entry) + self.inline_bytes

    @property
    def inline_bytes(self) -> int:
        return struct.calcsize(self.order + self.offset)


_CLASSIC = {order: _Layout(order=order, count="H", entry="HHI", offset="I", first_at=4) for order in "<>"}
_BIG = {order: _Layout(order=order, count="Q", entry="HHQ", offset="Q", first_at=8) for order in "<>"}
_LAYOUTS = {
    b"II*\0": _CLASSIC["<"],
    b"MM\0*": _CLASSIC[">"],
    # The sizes of offsets and a zero follow, which no other has.
    b"II+\0": _BIG["<"],
    b"MM\0+": _BIG[">"],
}
TIFF_SIGNATURES = tuple(_LAYOUTS)


def first_directory(tiff: bytes) -> dict[int, Value]:
    """Tag → value of the first directory; empty where there is none."""
    layout = _LAYOUTS.get(tiff[:4])
    if layout is None or len(tiff) < layout.first_at + layout.inline_bytes:
        return {}
    return _directory(tiff, layout, struct.unpack_from(layout.order + layout.offset, tiff, layout.first_at)[0])


def inner_directory(tiff: bytes, pointer: Value | None) -> dict[int, Value]:
    """Tag → value of the directory that a tag's value leads to; empty where there is none."""
    layout, offset = _LAYOUTS.get(tiff[:4]), number(pointer)
    return {} if layout is None or offset is None else _directory(tiff, layout, offset)


def _directory(tiff: bytes, layout: _Layout, offset: float) -> dict[int, Value]:
    """The entries of the directory at `offset` without those that point outside; empty when it does
    not fit."""
    head = struct.calcsize(layout.order + layout.count)
    if not 8 <= offset <= len(tiff) - head:
        return {}
    offset = int(offset)
    count = struct.unpack_from(layout.order + layout.count, tiff, offset)[0]
    first = offset + head
    if first + layout.entry_bytes * count > len(tiff):
        return {}
    values = {}
    for entry in range(first, first + layout.entry_bytes * count, layout.entry_bytes):
        tag, kind, length = struct.unpack_from(layout.order + layout.entry, tiff, entry)
        num_bytes = _TYPE_BYTES.get(kind, 0) * length
        start = entry + layout.entry_bytes - layout.inline_bytes
        if num_bytes > layout.inline_bytes:
            start = struct.unpack_from(layout.order + layout.offset, tiff, start)[0]
        most = MAX_PACKET_BYTES if tag == XMP_PACKET else MAX_VALUE_BYTES
        if 0 < num_bytes <= most and start + num_bytes <= len(tiff):
            values[tag] = _value(tiff[start : start + num_bytes], layout.order, kind)
    return values


def _value(raw: bytes, order: str, kind: int) -> Value:
    if kind in _BYTES:
        return raw
    numbers = np.frombuffer(raw, dtype=order + _NUMBERS[kind]).astype(np.float64)
    if kind not in _RATIONALS:
        return numbers
    nominators, denominators = numbers[0::2], numbers[1::2]
    ratios = np.divide(nominators, denominators, out=np.full(len(nominators), np.nan), where=denominators != 0)
    # A nominator without a denominator is no number; 0/0 is how writers leave a part out.
    return np.where((denominators == 0) & (nominators != 0), np.inf, ratios)


def number(value: Value | None) -> float | None:
    """The first number of a tag's value; None where it has none that is finite."""
    if value is None or isinstance(value, bytes) or not math.isfinite(value[0]):
        return None
    return float(value[0])


def text(value: Value | None) -> str:
    """The text of a tag's value, up to its first NUL."""
    return value.split(b"\0")[0].decode("ascii", "replace").strip() if isinstance(value, bytes) else ""
