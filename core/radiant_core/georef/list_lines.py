"""Lines of lists of surveyed points as people bring them. Once per list.

Fields stand between tabs where a line has any, else semicolons, else commas, else blanks; decimals
have a point, or a comma where the whole list shows that it is one. Between blanks a photograph's
name may have blanks itself: it is the longest name of a photograph that is known, else what ends in
a suffix of pictures, else one word.

Pixels are OpenSfM's, whose list this is: the middle of the upper left pixel is at (0, 0) (its
documentation, geometry.rst, "Pixel Coordinates"; OpenDroneMap hands the list on as it is). Here it
is at (0.5, 0.5), as in COLMAP: half a pixel is added when a list is read.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from radiant_core.errors import BadInput

CHECK = "check"
HINT = "expected: east north up column row photograph [name [check]]"
FIRST_PIXEL = 0.5
"""Where the middle of the first pixel is here, 0 in a list."""
NUM_NUMBERS = 5
_COMMENT = re.compile(r"(?:^|\s)#.*")
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[+-]?(?:nan|inf|infinity)", re.IGNORECASE)
_WITH_COMMA = re.compile(r"[+-]?\d+(?:,\d+)+|[+-]?\d+,\d+[eE][+-]?\d+")
_THOUSANDS = re.compile(r"[+-]?\d{1,3}(?:,\d{3})+")
_BOTH_SIGNS = re.compile(r"[+-]?\d{1,3}(?:,\d{3})+\.\d*|[+-]?\d{1,3}(?:\.\d{3})+,\d*")
_PICTURE = re.compile(r"(.+?\.(?:jpe?g|png|tiff?|dng|webp|bmp|heic|jp2))(?:\s+(.*))?", re.IGNORECASE)
_EAST = {"x", "geo_x", "e", "east", "easting", "lon", "long", "longitude"}
_NORTH = {"y", "geo_y", "n", "north", "northing", "lat", "latitude"}


@dataclass(frozen=True)
class ListLine:
    """A mark: place in the list's system, pixel (column, row) with the first pixel's middle at
    (0.5, 0.5), photograph, name of the point or nothing, whether the point is kept out, and all
    words behind the photograph, which are the name where names have blanks."""

    place: tuple[float, float, float]
    pixel: tuple[float, float]
    image: str
    name: str
    check: bool
    words: str = ""


@dataclass(frozen=True)
class Fields:
    """A line: its number in the file, its text, its fields, and whether these stand between signs
    that no name holds."""

    number: int
    text: str
    values: tuple[str, ...]
    separated: bool


def uncommented(line: str) -> str:
    """A line without its comment, which begins with # at the start or behind a blank, so that GCP#1
    is a name; empty where nothing but separators is left."""
    content = _COMMENT.sub("", line).strip()
    return content if content.strip(",;\t ") else ""


def content_lines(text: str) -> list[tuple[int, str]]:
    """Number and content of the lines that have one."""
    rows = [(number, uncommented(line)) for number, line in enumerate(text.splitlines(), 1)]
    return [(number, line) for number, line in rows if line]


def header_of(line: str) -> str:
    """The system on the first line, without what a table leaves behind it."""
    return line.strip(",;\t ")


def fields_of(number: int, line: str) -> Fields:
    """The fields of a line."""
    for sign in "\t;":
        parts = [part.strip().strip('"') for part in line.split(sign)]
        # Tabs are often doubled to align columns.
        parts = [part for part in parts if part] if sign == "\t" else parts
        if len(parts) >= 4:
            return Fields(number, line, tuple(parts), True)
    words, parts = line.split(), [part.strip().strip('"') for part in line.split(",")]
    if len(parts) >= 4 and not _is_blank_separated(words):
        return Fields(number, line, tuple(parts), True)
    return Fields(number, line, tuple(words), False)


def _is_blank_separated(words: Sequence[str]) -> bool:
    """Whether commas within words are decimal signs: those of a mark, or of a point's line."""
    numbers = words[:NUM_NUMBERS] if len(words) > NUM_NUMBERS else words[1:4] if len(words) >= 4 else []
    return bool(numbers) and all(_NUMBER.fullmatch(word) or _WITH_COMMA.fullmatch(word) for word in numbers)


def with_points(lines: Iterable[Fields], source: str) -> list[Fields]:
    """The lines with decimal commas as points; BadInput where a comma may part thousands."""
    lines = list(lines)
    words = [(line, value) for line in lines for value in line.values if _WITH_COMMA.fullmatch(value) or _BOTH_SIGNS.fullmatch(value)]
    if not words:
        return lines
    line, word = next(((line, word) for line, word in words if _BOTH_SIGNS.fullmatch(word) or word.count(",") > 1), (None, ""))
    if line is None and all(_THOUSANDS.fullmatch(value) for _, value in words):
        line, word = words[0]
    if line is not None:
        raise BadInput(
            f"{source}, line {line.number}: {word!r} has a comma that may part thousands or decimals: "
            "write numbers without a sign between thousands, and decimals with a point."
        )
    return [
        Fields(line.number, line.text, tuple(v.replace(",", ".") if _WITH_COMMA.fullmatch(v) else v for v in line.values), line.separated)
        for line in lines
    ]


def is_column_names(line: Fields, source: str) -> bool:
    """Whether a line names the columns; BadInput where it names them in another order."""
    names = [value.lower().strip("*") for value in line.values[:NUM_NUMBERS]]
    if len(names) < 4 or any(_NUMBER.fullmatch(name) for name in names) or not any(name in _EAST | _NORTH for name in names):
        return False
    first = next((at for at, name in enumerate(names) if name in _EAST), NUM_NUMBERS)
    second = next((at for at, name in enumerate(names) if name in _NORTH), -1)
    if second != first + 1:
        raise BadInput(f"{source}, line {line.number}: the columns are {line.text[:80]!r}, {HINT}.")
    return True


def list_line(source: str, line: Fields, photographs: Iterable[str] = ()) -> ListLine:
    """A mark of the list, `photographs` are names; BadInput names the line that is none."""
    if len(line.values) <= NUM_NUMBERS or not all(_NUMBER.fullmatch(value) for value in line.values[:NUM_NUMBERS]):
        raise BadInput(f"{source}, line {line.number}: {line.text[:80]!r} is no mark of a point, {HINT}.")
    values = [float(value) for value in line.values[:NUM_NUMBERS]]
    if np.isnan(values[2]):
        raise BadInput(
            f"{source}, line {line.number}: the point has no height (NaN), for which OpenSfM takes the plane alone, and which is not used "
            "here: give its height, or leave its lines out."
        )
    if not all(np.isfinite(values)) or max(abs(value) for value in values) > 1e9:
        raise BadInput(f"{source}, line {line.number}: a number is not finite or beyond 1e9: {HINT}.")
    east, north, up, column, row = values
    image, name, further = _names(line, photographs)
    words = [word for part in (name, *further) for word in part.split()]
    return ListLine(
        (east, north, up),
        (column + FIRST_PIXEL, row + FIRST_PIXEL),
        image,
        name,
        CHECK in [word.lower() for word in further],
        " ".join(word for word in words if word.lower() != CHECK),
    )


def _names(line: Fields, photographs: Iterable[str]) -> tuple[str, str, Sequence[str]]:
    """Photograph, point, and what stands behind them."""
    if line.separated:
        image, *further = line.values[NUM_NUMBERS:]
        return image, further[0] if further else "", further[1:]
    text = line.text.split(maxsplit=NUM_NUMBERS)[NUM_NUMBERS]
    fitting = [name for name in photographs if text == name or (text.startswith(name) and text[len(name)].isspace())]
    picture = _PICTURE.fullmatch(text)
    image = max(fitting, key=len) if fitting else picture[1] if picture is not None else text.split()[0]
    further = text[len(image) :].split()
    return image, further[0] if further else "", further[1:]
