"""`ControlList`: points of a survey and their marks while they are being marked. Once per edit.

Written as OpenDroneMap's list, which `control_points` reads: a line per mark. Points without a mark
stand in comments, `# point EAST NORTH UP NAME [check]`, so that the list can be gone on with. Read
from that, or from a plain table of points: the system on the first line, then `NAME EAST NORTH UP
[check]`, separated by blanks, commas, semicolons or tabs. Lines whose names have blanks are written
with tabs. Pixels are half a pixel less in the file than here, as `list_lines` says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.frames import Frame, enu_from_geodetic
from radiant_core.georef.control_points import LOCAL, matched_lines, named_lines, read_list, system_of
from radiant_core.georef.crs import parse_crs
from radiant_core.georef.list_lines import (
    CHECK,
    FIRST_PIXEL,
    Fields,
    ListLine,
    fields_of,
    header_of,
    is_column_names,
    list_line,
    uncommented,
    with_points,
)
from radiant_core.io.run_store import write_atomic
from radiant_core.numerics import FloatArray

CONTROL_LIST = "gcp_list.txt"
"""Its name in the folder of a run."""
UNMARKED = "# point "
MAX_POINTS = 10_000
MAX_LINES = 1_000_000
POINT_HINT = "expected: name east north up [check], or a line of gcp_list.txt"
Place = tuple[float, float, float]


@dataclass(frozen=True)
class ListedPoint:
    """A surveyed point: east, north, up in the list's system; whether it is kept out."""

    name: str
    place: Place
    is_check: bool = False

    def __post_init__(self) -> None:
        if not is_name(self.name):
            raise BadInput(f"{self.name!r} is no name of a point: give printable characters, none of them #, without blanks around.")
        if not all(np.isfinite(self.place)) or max(abs(value) for value in self.place) > 1e9:
            raise BadInput(f"point {self.name!r} is at {self.place}, expected finite coordinates below 1e9.")


def is_name(text: str) -> bool:
    """Whether a list can hold a name: `LOCAL`'s own signs, tabs and comments aside."""
    return bool(text) and text == " ".join(text.split()) and "#" not in text and ";" not in text and text.isprintable()


@dataclass(frozen=True, kw_only=True)
class ControlList:
    """system: the first line; marks: (point, photograph) → column and row in px of the photograph
    as it is stored, the middle of the first pixel at (0.5, 0.5)."""

    system: str
    points: tuple[ListedPoint, ...] = ()
    marks: dict[tuple[str, str], tuple[float, float]]

    def point(self, name: str) -> ListedPoint:
        """The point of a name; BadInput where there is none."""
        match = next((point for point in self.points if point.name == name), None)
        if match is None:
            raise BadInput(f"there is no point {name!r}: there are {', '.join(point.name for point in self.points[:8]) or 'none'}.")
        return match

    def marks_of(self, name: str) -> dict[str, tuple[float, float]]:
        """Photograph → column and row of a point's marks."""
        return {photograph: pixel for (point, photograph), pixel in self.marks.items() if point == name}

    def marked(self, name: str, photograph: str, pixel: tuple[float, float]) -> ControlList:
        """With a mark, in place of the point's former one in that photograph."""
        self.point(name)
        if not is_name(photograph):
            raise BadInput(
                f"{photograph!r} has a hash, a semicolon or doubled blanks in its name, which gcp_list.txt cannot hold: rename it."
            )
        if not all(np.isfinite(pixel)):
            raise BadInput(f"a mark at {pixel} came, expected finite pixels.")
        return replace(self, marks={**self.marks, (name, photograph): (float(pixel[0]), float(pixel[1]))})

    def unmarked(self, name: str, photograph: str) -> ControlList:
        """Without the point's mark in a photograph, if there is one."""
        return replace(self, marks={key: pixel for key, pixel in self.marks.items() if key != (name, photograph)})

    def with_point(self, point: ListedPoint) -> ControlList:
        """With one more point; BadInput where its name is taken, or the list is full."""
        if any(listed.name == point.name for listed in self.points):
            raise BadInput(f"there is a point {point.name!r} already: choose another name.")
        if len(self.points) >= MAX_POINTS:
            raise BadInput(f"the list has {len(self.points):,} points, the most that it may have: leave {point.name!r} out.")
        return replace(self, points=(*self.points, point))

    def with_check(self, name: str, is_check: bool) -> ControlList:
        """With a point kept out of the adjustment, or not."""
        self.point(name)
        return replace(self, points=tuple(replace(point, is_check=is_check) if point.name == name else point for point in self.points))

    def text(self) -> str:
        """The content of gcp_list.txt."""
        lines = [self.system]
        marks_of: dict[str, list[tuple[str, tuple[float, float]]]] = {}
        for (name, photograph), pixel in self.marks.items():
            marks_of.setdefault(name, []).append((photograph, pixel))
        for point in self.points:
            place, check = [repr(float(value)) for value in point.place], [CHECK] if point.is_check else []
            marks = marks_of.get(point.name, [])
            for photograph, (column, row) in marks:
                lines.append(_joined([*place, f"{column - FIRST_PIXEL:.2f}", f"{row - FIRST_PIXEL:.2f}", photograph, point.name, *check]))
            lines += [] if marks else [UNMARKED + _joined([*place, point.name, *check])]
        return "\n".join(lines) + "\n"

    def save(self, path: Path) -> None:
        """Write gcp_list.txt, atomically; CannotWrite if that fails."""
        write_atomic(path, self.text().encode())


def load_control_list(path: Path, photographs: Sequence[str] = ()) -> ControlList:
    """Read gcp_list.txt or a table of points, which name `photographs` as `parse_control` has it;
    BadInput names the line that is neither."""
    return parse_control_list(read_list(path), path.name, photographs)


def parse_control_list(text: str, source: str, photographs: Sequence[str] = ()) -> ControlList:
    """The list of a text; BadInput as `load_control_list`."""
    header, unmarked, rows = "", [], []
    for number, line in enumerate(text.splitlines(), 1):
        is_unmarked = line.startswith(UNMARKED)
        content = line.removeprefix(UNMARKED).strip() if is_unmarked else uncommented(line)
        if not content:
            continue
        if not header:
            header = header_of(content)
            continue
        (unmarked if is_unmarked else rows).append(fields_of(number, content))
        if len(unmarked) + len(rows) > MAX_LINES:
            raise BadInput(f"{source} has more than {MAX_LINES:,} lines: a list of so many points and marks is none.")
    if not header:
        raise BadInput(f"{source} is empty: the system stands on its first line, such as EPSG:32632, then {POINT_HINT}.")
    system_of(header, source)
    rows = with_points(rows, source)
    rows = rows[bool(rows) and is_column_names(rows[0], source) :]
    points = [_unmarked_point(source, line) for line in with_points(unmarked, source)]
    points += [_table_point(source, line.number, line.values) for line in rows if len(line.values) < 6]
    lines = [list_line(source, line, photographs) for line in rows if len(line.values) >= 6]
    parsed = _with_marks(header, points, matched_lines(lines, photographs)[0], source)
    if not 0 < len(parsed.points) <= MAX_POINTS:
        raise BadInput(f"{source} has {len(parsed.points)} points, expected 1 to {MAX_POINTS:,}: {POINT_HINT}.")
    return parsed


def world_places(control: ControlList, frame: Frame) -> FloatArray:
    """Points (P,3) in the world of a scene: NaN where the scene, or the list, has no place on the
    globe."""
    places = np.array([point.place for point in control.points], np.float64).reshape(-1, 3)
    if frame.kind != "metric" or control.system.upper() == LOCAL:
        return np.full_like(places, np.nan)
    system = parse_crs(control.system).at(*frame.origin_lat_lon_alt[:2].tolist())
    return enu_from_geodetic(system.to_geodetic(places), frame.origin_lat_lon_alt)


def list_shortfall(control: ControlList, frame: Frame) -> str | None:
    """Which grids the list's system lacks at a scene, and what that costs; None where none."""
    if frame.kind != "metric" or control.system.upper() == LOCAL:
        return None
    return parse_crs(control.system).shortfall_over(frame.origin_lat_lon_alt[None])


def _with_marks(header: str, points: list[ListedPoint], lines: list[ListLine], source: str) -> ControlList:
    point_of, first = named_lines(lines, source)
    checks = {name for name, line in zip(point_of, lines, strict=True) if line.check}
    listed = [*(ListedPoint(name, line.place, name in checks) for name, line in first.items()), *points]
    # Once for all: point by point, each would be compared with all before it.
    names = set()
    for point in listed:
        if point.name in names:
            raise BadInput(f"there is a point {point.name!r} already: choose another name.")
        names.add(point.name)
    marks = {(name, line.image): line.pixel for name, line in zip(point_of, lines, strict=True)}
    return ControlList(system=header, points=tuple(listed), marks=marks)


def _joined(words: list[str]) -> str:
    """A line: between blanks, which OpenDroneMap reads, or between tabs where names have blanks."""
    return ("\t" if any(" " in word for word in words) else " ").join(words)


def _unmarked_point(source: str, line: Fields) -> ListedPoint:
    words = line.values
    return _table_point(source, line.number, (*words[3:4], *words[:3], *words[4:]))


def _table_point(source: str, number: int, words: Sequence[str]) -> ListedPoint:
    if len(words) < 4:
        raise BadInput(f"{source}, line {number}: {' '.join(words)[:80]!r} is no mark of a point, {POINT_HINT}.")
    try:
        east, north, up = (float(word) for word in words[1:4])
    except ValueError:
        raise BadInput(f"{source}, line {number}: {' '.join(words)[:80]!r} is no point, {POINT_HINT}.") from None
    if len(words) > 4 and words[4].lower() not in (CHECK, ""):
        raise BadInput(f"{source}, line {number}: {words[4][:40]!r} stands behind the point, {POINT_HINT}.")
    return ListedPoint(words[0], (east, north, up), len(words) > 4 and words[4].lower() == CHECK)
