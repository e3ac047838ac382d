"""Positions that a camera writes into a film's own file (MP4, MOV). Once per film.

    moov/udta/©xyz                            +47.3700+008.5400+430.000/     (ISO 6709)
    moov/meta/keys, ilst                      com.apple.quicktime.location.ISO6709, the same text
    a track of the handler "meta", "gpmd"     GoPro's samples (GPMF): GPS5 or GPS9 by SCAL

The first two are one place, where the film began. OpenCV gives neither, PyAV the first two as
text and 30 MB, so the boxes are walked here; whatever is broken in them has no position.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from radiant_core.io.film.srt import FilmTrack
from radiant_core.io.photos.gps import Position, on_globe

MAX_HEAD_BYTES = 1 << 26
MAX_SAMPLE_BYTES, MAX_SAMPLES = 1 << 20, 1 << 20
MAX_DEPTH = 8
APPLE_KEY = b"com.apple.quicktime.location.ISO6709"
_ISO6709 = re.compile(rb"([+-]\d+(?:\.\d+)?)([+-]\d+(?:\.\d+)?)([+-]\d+(?:\.\d+)?)?")
_HOLDERS = frozenset((b"moov", b"trak", b"mdia", b"minf", b"stbl", b"udta"))
_BOX, _LONG_BOX = struct.Struct(">I4s"), struct.Struct(">Q")
NO_TRACK = FilmTrack(times_s=np.zeros(0), lat_lon_alt=np.zeros((0, 3)))


@dataclass(frozen=True, kw_only=True)
class Box:
    """A box of a film's head: what leads to it, and its content."""

    path: tuple[bytes, ...]
    data: bytes


def read_container(path: Path) -> tuple[FilmTrack, Position | None]:
    """The positions over a film's time that its file holds, and the place where it began; an empty
    track and None where it says nothing that is understood."""
    try:
        with path.open("rb") as file:
            head = _head(file)
            boxes = tuple(_boxes(head, (b"moov",)))
            begun = next((place for box in boxes if (place := _begun(box)) is not None), None)
            return _gopro_track(file, boxes), begun
    except (OSError, struct.error, ValueError, OverflowError, LookupError):
        return NO_TRACK, None


def _head(file: BinaryIO) -> bytes:
    """The content of moov, wherever it stands in the file."""
    size = file.seek(0, 2)
    at = 0
    while at + _BOX.size <= size:
        file.seek(at)
        length, kind = _BOX.unpack(file.read(_BOX.size))
        start = _BOX.size
        if length == 1:
            length, start = _LONG_BOX.unpack(file.read(_LONG_BOX.size))[0], start + _LONG_BOX.size
        length = length or size - at
        if length < start:
            return b""
        if kind == b"moov":
            return file.read(length - start) if length <= MAX_HEAD_BYTES else b""
        at += length
    return b""


def _boxes(data: bytes, path: tuple[bytes, ...]) -> Iterator[Box]:
    """All boxes below, each after those that it holds."""
    at = 0
    while at + _BOX.size <= len(data):
        length, kind = _BOX.unpack_from(data, at)
        if length < _BOX.size or at + length > len(data):
            return
        inside = data[at + _BOX.size : at + length]
        if kind in _HOLDERS and len(path) < MAX_DEPTH:
            yield from _boxes(inside, (*path, kind))
        yield Box(path=(*path, kind), data=inside)
        at += length


def _begun(box: Box) -> Position | None:
    """The place in a box, where it is one of those that name it."""
    text = b""
    if box.path == (b"moov", b"udta", b"\xa9xyz"):
        # A length of two bytes and a language of two come first.
        text = box.data[4:]
    elif box.path[-1] == b"meta" and APPLE_KEY in box.data:
        text = box.data[box.data.rfind(b"ilst") :]
    match = _ISO6709.search(text)
    if match is None:
        return None
    lat, lon = (_degrees(match[1], 2), _degrees(match[2], 3))
    return on_globe(lat, lon, float(match[3]) if match[3] else math.nan)


def _degrees(text: bytes, whole: int) -> float:
    """±DD.D, ±DDMM.M or ±DDMMSS.S of so many digits for whole degrees (ISO 6709)."""
    sign = -1.0 if text.startswith(b"-") else 1.0
    digits = text[1:].partition(b".")[0]
    value = float(text[1:])
    if len(digits) <= whole:
        return sign * value
    if len(digits) <= whole + 2:
        return sign * (value // 100 + value % 100 / 60)
    return sign * (value // 10_000 + value // 100 % 100 / 60 + value % 100 / 3600)


def _gopro_track(file: BinaryIO, boxes: tuple[Box, ...]) -> FilmTrack:
    """The positions of the first track whose samples are GoPro's."""
    tables: dict[bytes, bytes] = {}
    for box in boxes:
        if box.path[-1] == b"trak":
            if b"gpmd" in tables.get(b"stsd", b""):
                return _track(file, tables)
            tables = {}
        else:
            tables[box.path[-1]] = box.data
    return NO_TRACK


def _track(file: BinaryIO, tables: dict[bytes, bytes]) -> FilmTrack:
    wide = tables[b"mdhd"][0] == 1
    (ticks_per_s,) = struct.unpack_from(">I", tables[b"mdhd"], 20 if wide else 12)
    begins = _sample_times(tables[b"stts"])
    places = _sample_places(tables)[:MAX_SAMPLES]
    times: list[float] = []
    rows: list[Position] = []
    for (offset, size), begin, end in zip(places, begins, begins[1:], strict=False):
        file.seek(offset)
        positions = _positions(file.read(min(size, MAX_SAMPLE_BYTES)))
        for number, position in enumerate(positions):
            time_s = (begin + (end - begin) * number / len(positions)) / max(1, ticks_per_s)
            if not times or time_s > times[-1]:
                times.append(time_s)
                rows.append(position)
    return FilmTrack(times_s=np.array(times, float), lat_lon_alt=np.array(rows, float).reshape(len(rows), 3))


def _sample_times(stts: bytes) -> list[int]:
    """When each sample begins, in ticks, and the end of the last."""
    (count,) = struct.unpack_from(">I", stts, 4)
    times = [0]
    for number in range(min(count, MAX_SAMPLES)):
        repeated, ticks = struct.unpack_from(">II", stts, 8 + 8 * number)
        for _ in range(min(repeated, MAX_SAMPLES - len(times))):
            times.append(times[-1] + ticks)
    return times


def _sample_places(tables: dict[bytes, bytes]) -> list[tuple[int, int]]:
    """Offset and size of each sample in the file."""
    fixed, count = struct.unpack_from(">II", tables[b"stsz"], 4)
    count = min(count, MAX_SAMPLES)
    sizes = [fixed] * count if fixed else list(struct.unpack_from(f">{count}I", tables[b"stsz"], 12))
    wide = b"co64" in tables
    chunks_box = tables[b"co64" if wide else b"stco"]
    (num_chunks,) = struct.unpack_from(">I", chunks_box, 4)
    offsets = struct.unpack_from(f">{min(num_chunks, MAX_SAMPLES)}{'Q' if wide else 'I'}", chunks_box, 8)
    (num_runs,) = struct.unpack_from(">I", tables[b"stsc"], 4)
    runs = [struct.unpack_from(">III", tables[b"stsc"], 8 + 12 * number) for number in range(min(num_runs, MAX_SAMPLES))]
    places: list[tuple[int, int]] = []
    for number, (first, in_chunk, _) in enumerate(runs):
        last = runs[number + 1][0] - 1 if number + 1 < len(runs) else len(offsets)
        for chunk in range(max(1, first), min(last, len(offsets)) + 1):
            offset = offsets[chunk - 1]
            for size in sizes[len(places) : len(places) + in_chunk]:
                places.append((offset, size))
                offset += size
    return places


def _positions(sample: bytes) -> list[Position]:
    """The positions of one of GoPro's samples that have a fix."""
    scale: tuple[int, ...] = ()
    fix, positions = 3, list[Position]()
    for key, kind, size, values in _entries(sample, 0):
        if key == b"GPSF" and len(values) >= 4:
            (fix,) = struct.unpack_from(">I", values)
        elif key == b"SCAL" and kind in b"ls":
            code = "i" if kind == b"l" else "h"
            scale = struct.unpack_from(f">{len(values) // struct.calcsize(code)}{code}", values)
        elif key in (b"GPS5", b"GPS9") and len(scale) >= 3 and min(map(abs, scale[:3])) > 0:
            for at in range(0, len(values) - size + 1, size or 1):
                lat, lon, alt = (value / by for value, by in zip(struct.unpack_from(">3i", values, at), scale[:3], strict=True))
                has_fix = struct.unpack_from(">H", values, at + 30)[0] if key == b"GPS9" and size >= 32 else fix
                position = on_globe(lat, lon, alt) if has_fix >= 2 else None
                if position is not None:
                    positions.append(position)
    return positions


def _entries(data: bytes, depth: int) -> Iterator[tuple[bytes, bytes, int, bytes]]:
    """Key, type, size of one and values of each entry, in the order of the file, holders opened."""
    at = 0
    while at + 8 <= len(data):
        key, kind, size, count = struct.unpack_from(">4scBH", data, at)
        values = data[at + 8 : at + 8 + size * count]
        if kind == b"\0" and depth < MAX_DEPTH:
            yield from _entries(values, depth + 1)
        else:
            yield key, kind, size, values
        at += 8 + (size * count + 3) // 4 * 4
