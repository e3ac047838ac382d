"""Levels of a raster as one Cloud-Optimised GeoTIFF (OGC 21-026). Once per raster.

    header, directories from the full size down, tiles from the smallest level up to the full size

so that a reader across a network has all directories with its first request and every tile with one
more. tifffile writes each level with its directory behind it, which is why levels are laid in anew
here. GDAL's own COG driver would do it too, at 30 MB of rasterio for a hundred lines.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from radiant_core.io.run_store import atomic_writer

_NEW_SUBFILE, _TILE_OFFSETS, _TILE_BYTES = 254, 324, 325
_PLACE_TAGS = (33550, 33922, 34735, 42112)
"""Of the full size alone: where it lies, and the names of its bands."""
_LONG, _LONG8 = 4, 16
_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 16: 8, 17: 8, 18: 8}
"""Bytes of a value by the number of its type."""


@dataclass(frozen=True, kw_only=True)
class _Entry:
    """A tag with its type, number of values and their bytes as the file has them."""

    code: int
    kind: int
    number: int
    data: bytes


@dataclass(frozen=True, kw_only=True)
class _Level:
    """One level: its file, its tags but those of tiles, and where its tiles lie in that file."""

    path: Path
    entries: tuple[_Entry, ...]
    offsets: tuple[int, ...]
    sizes: tuple[int, ...]


def write_cog(path: Path, levels: Sequence[Path], *, big: bool) -> None:
    """Join tiled little-endian TIFFs of one page each, the full size first and of the same form as
    `big` says, atomically. Raises CannotWrite if it fails."""
    tables = [_read_level(level, is_reduced=index > 0) for index, level in enumerate(levels)]
    header = struct.pack("<2sHHHQ", b"II", 43, 8, 0, 16) if big else struct.pack("<2sHI", b"II", 42, 8)
    data_at = len(header) + sum(len(_directory(level, [0] * len(level.offsets), 0, 0, big=big)) for level in tables)
    places: list[list[int]] = [[] for _ in tables]
    for index in reversed(range(len(tables))):
        for size in tables[index].sizes:
            places[index].append(data_at)
            data_at += size
    with atomic_writer(path) as file:
        file.write(header)
        at = len(header)
        for index, level in enumerate(tables):
            directory = _directory(level, places[index], at, 0, big=big)
            next_at = at + len(directory) if index + 1 < len(tables) else 0
            file.write(_directory(level, places[index], at, next_at, big=big))
            at += len(directory)
        for level in reversed(tables):
            _copy_tiles(level, file)


def _read_level(path: Path, *, is_reduced: bool) -> _Level:
    import tifffile

    with tifffile.TiffFile(path) as file:
        page = file.pages[0]
        assert isinstance(page, tifffile.TiffPage) and file.byteorder == "<"
        entries = []
        for tag in page.tags:
            code = int(tag.code)
            if code in (_NEW_SUBFILE, _TILE_OFFSETS, _TILE_BYTES) or (is_reduced and code in _PLACE_TAGS):
                continue
            kind, number = int(tag.dtype), int(tag.count)
            file.filehandle.seek(tag.valueoffset)
            data = file.filehandle.read(number * _SIZES[kind])
            entries.append(_Entry(code=code, kind=kind, number=number, data=data))
        entries.append(_Entry(code=_NEW_SUBFILE, kind=_LONG, number=1, data=struct.pack("<I", int(is_reduced))))
        return _Level(
            path=path,
            entries=tuple(sorted(entries, key=lambda entry: entry.code)),
            offsets=tuple(page.dataoffsets),
            sizes=tuple(page.databytecounts),
        )


def _directory(level: _Level, places: Sequence[int], at: int, next_at: int, *, big: bool) -> bytes:
    """A directory that lies at a place of the file, its longer values behind it; its length does
    not depend on the places."""
    kind, form = (_LONG8, "Q") if big else (_LONG, "I")
    tiles = [
        _Entry(code=_TILE_OFFSETS, kind=kind, number=len(places), data=struct.pack(f"<{len(places)}{form}", *places)),
        _Entry(code=_TILE_BYTES, kind=kind, number=len(places), data=struct.pack(f"<{len(places)}{form}", *level.sizes)),
    ]
    entries = sorted([*level.entries, *tiles], key=lambda entry: entry.code)
    count_form, row_form, inline = ("<Q", "<HHQ", 8) if big else ("<H", "<HHI", 4)
    behind_at = at + struct.calcsize(count_form) + len(entries) * (struct.calcsize(row_form) + inline) + inline
    rows, behind = [], b""
    for entry in entries:
        value = entry.data.ljust(inline, b"\0")
        if len(entry.data) > inline:
            value = struct.pack(f"<{form}", behind_at + len(behind))
            # Values begin at even places.
            behind += entry.data + b"\0" * (len(entry.data) % 2)
        rows.append(struct.pack(row_form, entry.code, entry.kind, entry.number) + value)
    return struct.pack(count_form, len(entries)) + b"".join(rows) + struct.pack(f"<{form}", next_at) + behind


def _copy_tiles(level: _Level, to: IO[bytes]) -> None:
    with level.path.open("rb") as file:
        for offset, size in zip(level.offsets, level.sizes, strict=True):
            file.seek(offset)
            to.write(file.read(size))
