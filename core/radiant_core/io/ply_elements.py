"""PLY files of any program as tables, one per element that is asked for. Once per file.

    ply
    format ascii | binary_little_endian | binary_big_endian 1.0
    element NAME COUNT, each with: property TYPE NAME | property list TYPE TYPE NAME
    end_header, then the elements in that order

What stands before or between the elements that are asked for is passed over, lists included; what
stands behind the last of them is not read. Sizes are held against the file before anything is
allocated: files come from strangers. Source: Turk, The PLY Polygon File Format (1994).
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import IO, Literal

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.io.run_store import open_without_waiting

MAX_HEADER_LINES = 2000
MAX_LINE_BYTES = 1000
MAX_ROW_BYTES = 1 << 20
"""Of a row of text: 64 properties take some 1,300."""
TEXT_ROWS = 4096
"""Rows of text taken apart at a time."""
CACHED_ROWS = 4096
"""Records taken apart at a time, which a core's cache holds."""

SCALAR_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
Form = Literal["ascii", "binary_little_endian", "binary_big_endian"]
_BYTE_ORDERS: dict[str, str] = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True, kw_only=True)
class Element:
    """An element as the header says it: its scalar properties by name, and the types of a count and
    an entry of those that are lists."""

    name: str
    count: int
    properties: Mapping[str, str | tuple[str, str]] = field(default_factory=dict)

    @property
    def has_lists(self) -> bool:
        """Whether its rows are of different lengths."""
        return any(isinstance(kind, tuple) for kind in self.properties.values())

    def dtype(self, order: str) -> np.dtype:
        """The record of a row without its lists, in a byte order, "<" or ">"."""
        return np.dtype([(name, order + kind) for name, kind in self.properties.items() if isinstance(kind, str)])


@dataclass(frozen=True, kw_only=True)
class PlyHeader:
    """What stands before `end_header`; comments without that word."""

    form: Form
    elements: tuple[Element, ...]
    comments: tuple[tuple[str, ...], ...]

    def element(self, name: str) -> Element | None:
        """The element of that name; None without one."""
        return next((element for element in self.elements if element.name == name), None)


@dataclass(frozen=True, eq=False)
class Table:
    """The rows of an element: records (N,), or numbers (N,P) by the names of its scalars."""

    element: Element
    rows: NDArray

    def __len__(self) -> int:
        return self.element.count

    def has(self, name: str, kinds: str) -> bool:
        """Whether it has a scalar of that name whose type is of these kinds, of "iuf"."""
        kind = self.element.properties.get(name)
        return isinstance(kind, str) and kind[0] in kinds

    def columns(self, names: Sequence[str], dtype: type = np.float32) -> NDArray:
        """The named scalars as (N,len(names)); a double beyond float32 becomes infinite."""
        columns = np.empty((len(self), len(names)), dtype)
        with np.errstate(over="ignore", invalid="ignore", under="ignore"):
            if self.rows.dtype.names is None:
                scalars = list(self.element.dtype("<").names or ())
                columns[:] = self.rows[:, [scalars.index(name) for name in names]]
                return columns
            # Rows that fit the cache: property after property would read the whole file for each.
            for start in range(0, len(self), CACHED_ROWS):
                part = slice(start, start + CACHED_ROWS)
                for column, name in zip(columns[part].T, names, strict=True):
                    column[:] = self.rows[part][name]
        return columns


@dataclass(frozen=True, kw_only=True)
class _Part:
    """An element that is being read: what its rows are called, None where it is passed over; the
    byte order; and the bytes from where it begins."""

    element: Element
    noun: str | None
    order: str
    num_bytes_left: int

    def too_short(self, size: str) -> str:
        return f"it has {self.num_bytes_left} bytes after the header, expected {self.element.count} {self._rows} of {size}"

    def ends_after(self, num_rows: int) -> str:
        return f"it ends after {num_rows} of {self.element.count} {self._rows}"

    @property
    def _rows(self) -> str:
        return self.noun or f"rows of its element {self.element.name[:40]!r}"


def read_elements(path: Path, rows_of: Mapping[str, str]) -> tuple[PlyHeader, dict[str, Table]]:
    """The header of a PLY file and the tables of those elements that are named and that it has;
    `rows_of` says what the rows of each are called in a sentence.

    Raises BadInput, which does not name the file, when it cannot be read, is no PLY, or is shorter
    or longer than its header says; OSError as `open`.
    """
    with open(path, "rb", opener=open_without_waiting) as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise BadInput("it is no regular file")
        header = _header(file)
        start, end = file.tell(), os.fstat(file.fileno()).st_size
        tables: dict[str, Table] = {}
        missing = {element.name for element in header.elements} & rows_of.keys()
        for element in header.elements:
            if not missing:
                break
            read_rows = _read_text if header.form == "ascii" else _read_records
            part = _Part(element=element, noun=rows_of.get(element.name), order=_BYTE_ORDERS[header.form], num_bytes_left=end - file.tell())
            rows = read_rows(file, part)
            if rows is not None:
                tables[element.name] = Table(element, rows)
            missing.discard(element.name)
            if not missing:
                _require_end(start, end, part, header)
        return header, tables


def _header(file: IO[bytes]) -> PlyHeader:
    """The header; the file stands behind it."""
    if _words(file) != ["ply"]:
        raise BadInput("it does not begin as a PLY file")
    form: Form | None = None
    elements: list[Element] = []
    comments: list[tuple[str, ...]] = []
    # The format's line is one more.
    for _ in range(MAX_HEADER_LINES + 1):
        match _words(file):
            case ["comment" | "obj_info" as kind, *words]:
                comments += [tuple(words)] if kind == "comment" else []
            case ["format", "ascii" | "binary_little_endian" | "binary_big_endian" as said, "1.0"] if form is None and not elements:
                form = said
            case ["element", name, digits] if form and re.fullmatch("[0-9]{1,15}", digits) and name not in {e.name for e in elements}:
                elements.append(Element(name=name, count=int(digits), properties={}))
            case ["property", *kinds, name] if elements and (kind := _kind(kinds)) and name not in elements[-1].properties:
                elements[-1] = Element(name=elements[-1].name, count=elements[-1].count, properties={**elements[-1].properties, name: kind})
            case ["end_header"] if form is not None and elements:
                return PlyHeader(form=form, elements=tuple(elements), comments=tuple(comments))
            case words:
                raise BadInput(f"its header line {' '.join(words)[:80]!r} is not one of a PLY file")
    raise BadInput(f"its header has over {MAX_HEADER_LINES} lines")


def _kind(words: list[str]) -> str | tuple[str, str] | None:
    """The type of a property; None for what is none. A list is counted in whole numbers."""
    match words:
        case [scalar] if scalar in SCALAR_TYPES:
            return SCALAR_TYPES[scalar]
        case ["list", length, entry] if length in SCALAR_TYPES and entry in SCALAR_TYPES and SCALAR_TYPES[length][0] != "f":
            return SCALAR_TYPES[length], SCALAR_TYPES[entry]
    return None


def _words(file: IO[bytes]) -> list[str]:
    line = file.readline(MAX_LINE_BYTES)
    if not line.endswith(b"\n"):
        raise BadInput(f"its header ends early or has a line of over {MAX_LINE_BYTES} bytes")
    return line.decode("latin-1").split()


def _read_records(file: IO[bytes], part: _Part) -> NDArray | None:
    """The records (N,) of an element of a binary file, None where they are only passed over."""
    element, dtype = part.element, part.element.dtype(part.order)
    if element.has_lists:
        return _walk_lists(file, part)
    if element.count * dtype.itemsize > part.num_bytes_left:
        raise BadInput(part.too_short(f"{dtype.itemsize} bytes"))
    if part.noun is None:
        file.seek(element.count * dtype.itemsize, os.SEEK_CUR)
        return None
    rows = np.fromfile(file, dtype, element.count) if dtype.itemsize else np.zeros(element.count, dtype)
    if len(rows) != element.count:
        raise BadInput(part.ends_after(len(rows)))
    return rows


def _walk_lists(file: IO[bytes], part: _Part) -> NDArray | None:
    """As `_read_records`, row by row: only the rows themselves say how long they are."""
    element, scalars = part.element, bytearray()
    kinds = [(kind, None) if isinstance(kind, str) else kind for kind in element.properties.values()]
    shortest = sum(np.dtype(first).itemsize for first, _ in kinds)
    if element.count * shortest > part.num_bytes_left:
        raise BadInput(part.too_short(f"at least {shortest} bytes"))
    for row in range(element.count):
        for first, entry in kinds:
            data = file.read(np.dtype(first).itemsize)
            if len(data) < np.dtype(first).itemsize:
                raise BadInput(part.ends_after(row))
            if entry is None:
                scalars += data if part.noun else b""
                continue
            num_bytes = int(np.frombuffer(data, part.order + first)[0]) * np.dtype(entry).itemsize
            if not 0 <= num_bytes <= part.num_bytes_left:
                raise BadInput(f"a list of its element {element.name[:40]!r} takes {num_bytes} bytes, more than the file has")
            file.seek(num_bytes, os.SEEK_CUR)
    dtype = element.dtype(part.order)
    if part.noun is None or not dtype.itemsize:
        return np.zeros(element.count, dtype) if part.noun else None
    return np.frombuffer(bytes(scalars), dtype)


def _read_text(file: IO[bytes], part: _Part) -> NDArray | None:
    """The scalars (N,P) of an element of an ASCII file, a line a row."""
    element = part.element
    width = sum(isinstance(kind, str) for kind in element.properties.values())
    # A number and what parts it from the next take two bytes; the last line may lack its end.
    if element.count * max(1, 2 * len(element.properties)) > part.num_bytes_left + 1:
        raise BadInput(part.too_short(f"{width} numbers"))
    parts, num_rows = [np.zeros((0, width))], 0
    while num_rows < element.count:
        lines = list(islice(iter(lambda: file.readline(MAX_ROW_BYTES), b""), min(TEXT_ROWS, element.count - num_rows)))
        if not lines:
            raise BadInput(part.ends_after(num_rows))
        num_rows += len(lines)
        if part.noun:
            parts.append(_numbers([_scalars(line, element) for line in lines] if element.has_lists else lines, width, element.name))
    return np.concatenate(parts) if part.noun else None


def _numbers(lines: list[bytes], width: int, name: str) -> NDArray[np.float64]:
    """The numbers (N,width) of lines of text."""
    if any(len(line.split()) != width for line in lines):
        raise BadInput(f"a row of its element {name[:40]!r} has not {width} numbers")
    try:
        return np.array([float(word) for line in lines for word in line.split()], np.float64).reshape(len(lines), width)
    except ValueError as error:
        raise BadInput(f"a row of its element {name[:40]!r} has a word that is no number") from error


def _scalars(line: bytes, element: Element) -> bytes:
    """A row of text without its lists."""
    words, scalars = iter(line.split()), []
    try:
        for kind in element.properties.values():
            word = next(words)
            if isinstance(kind, str):
                scalars.append(word)
                continue
            for _ in range(int(word)):
                next(words)
    except (StopIteration, ValueError):
        raise BadInput(f"a row of its element {element.name[:40]!r} is shorter than its list says") from None
    return b" ".join(scalars)


def _require_end(start: int, end: int, part: _Part, header: PlyHeader) -> None:
    """Raise BadInput unless the elements fill what is behind the header, where that can be told."""
    if header.form == "ascii" or any(element.has_lists for element in header.elements):
        return
    sizes = [element.count * element.dtype("<").itemsize for element in header.elements]
    if sum(sizes) != end - start:
        last = part.element
        expected = f"{last.count} {part.noun} of {last.dtype('<').itemsize} bytes" + (" and other elements" if len(sizes) > 1 else "")
        raise BadInput(f"it has {end - start} bytes after the header, expected {expected}, {sum(sizes)} bytes")
