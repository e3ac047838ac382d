"""`ControlList`: points of a survey and their marks while they are being marked. Once per edit.

Written as OpenDroneMap's list, which `control_points` reads: a line per mark. Points without a mark
stand in comments, `# point EAST NORTH UP NAME [check]`, so that the list can be gone on with. Read
from that, or from a plain table of points: the system on the first line, then `NAME EAST NORTH UP
[check]`, separated by blanks, commas, semicolons or tabs.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.frames import Frame, enu_from_geodetic
from radiant_core.georef.control_points import CHECK, LOCAL, ListLine, list_line, named_lines, read_list, system_of
from radiant_core.georef.crs import parse_crs
from radiant_core.io.run_store import write_atomic
from radiant_core.numerics import FloatArray

CONTROL_LIST = "gcp_list.txt"
"""Its name in the folder of a run."""
UNMARKED = "# point "
MAX_POINTS = 10_000
POINT_HINT = "expected: name east north up [check], or a line of gcp_list.txt"
Place = tuple[float, float, float]


@dataclass(frozen=True)
class ListedPoint:
    """A surveyed point: east, north, up in the list's system; whether it is kept out."""

    name: str
    place: Place
    is_check: bool = False

    def __post_init__(self) -> None:
        if not self.name or self.name.split() != [self.name] or "#" in self.name or not self.name.isprintable():
            raise BadInput(f"{self.name!r} is no name of a point: give printable characters without blanks and #.")
        if not all(np.isfinite(self.place)) or max(abs(value) for value in self.place) > 1e9:
            raise BadInput(f"point {self.name!r} is at {self.place}, expected finite coordinates below 1e9.")


@dataclass(frozen=True, kw_only=True)
class ControlList:
    """system: the first line; marks: (point, photograph) → column and row in px of the photograph
    as it is stored."""

    system: str
    points: tuple[ListedPoint, ...] = ()
    marks: dict[tuple[str, str], tuple[float, float]]

    def point(self, name: str) -> ListedPoint:
        """The point of a name; BadInput where there is none."""
        found = next((point for point in self.points if point.name == name), None)
        if found is None:
            raise BadInput(f"there is no point {name!r}: there are {', '.join(point.name for point in self.points[:8]) or 'none'}.")
        return found

    def marks_of(self, name: str) -> dict[str, tuple[float, float]]:
        """Photograph → column and row of a point's marks."""
        return {photograph: pixel for (point, photograph), pixel in self.marks.items() if point == name}

    def marked(self, name: str, photograph: str, pixel: tuple[float, float]) -> ControlList:
        """With a mark, in place of the point's former one in that photograph."""
        self.point(name)
        if photograph.split() != [photograph] or "#" in photograph:
            raise BadInput(f"{photograph!r} has a blank or a hash in its name, which gcp_list.txt cannot hold: rename the photograph.")
        if not all(np.isfinite(pixel)):
            raise BadInput(f"a mark at {pixel} came, expected finite pixels.")
        return replace(self, marks={**self.marks, (name, photograph): (float(pixel[0]), float(pixel[1]))})

    def unmarked(self, name: str, photograph: str) -> ControlList:
        """Without the point's mark in a photograph, if there is one."""
        return replace(self, marks={key: pixel for key, pixel in self.marks.items() if key != (name, photograph)})

    def with_point(self, point: ListedPoint) -> ControlList:
        """With one more point; BadInput where its name is taken."""
        if any(other.name == point.name for other in self.points):
            raise BadInput(f"there is a point {point.name!r} already: choose another name.")
        return replace(self, points=(*self.points, point))

    def with_check(self, name: str, is_check: bool) -> ControlList:
        """With a point kept out of the adjustment, or not."""
        self.point(name)
        return replace(self, points=tuple(replace(point, is_check=is_check) if point.name == name else point for point in self.points))

    def text(self) -> str:
        """The content of gcp_list.txt."""
        lines = [self.system]
        for point in self.points:
            place, check = " ".join(repr(float(value)) for value in point.place), f" {CHECK}" if point.is_check else ""
            own = self.marks_of(point.name)
            lines += [f"{place} {column:.2f} {row:.2f} {photograph} {point.name}{check}" for photograph, (column, row) in own.items()]
            lines += [] if own else [f"{UNMARKED}{place} {point.name}{check}"]
        return "\n".join(lines) + "\n"

    def save(self, path: Path) -> None:
        """Write gcp_list.txt, atomically; CannotWrite if that fails."""
        write_atomic(path, self.text().encode())


def load_control_list(path: Path) -> ControlList:
    """Read gcp_list.txt or a table of points; BadInput names the line that is neither."""
    return parse_control_list(read_list(path), path.name)


def parse_control_list(text: str, source: str) -> ControlList:
    """The list of a text; BadInput as `load_control_list`."""
    header, points, lines = "", [], []
    for number, line in enumerate(text.splitlines(), 1):
        own = line.removeprefix("#").strip().removeprefix("point ") if line.startswith(UNMARKED) else line.split("#", 1)[0].strip()
        if not own:
            continue
        if not header:
            header = own
        elif line.startswith(UNMARKED):
            points.append(_unmarked_point(source, number, own.split()))
        elif len(words := re.split(r"[\s,;]+", own)) in (4, 5):
            points.append(_table_point(source, number, words))
        else:
            lines.append((number, own))
    if not header:
        raise BadInput(f"{source} is empty: the system stands on its first line, such as EPSG:32632, then {POINT_HINT}.")
    system_of(header, source)
    found = _with_marks(header, points, [list_line(source, number, line) for number, line in lines], source)
    if not 0 < len(found.points) <= MAX_POINTS:
        raise BadInput(f"{source} has {len(found.points)} points, expected 1 to {MAX_POINTS:,}: {POINT_HINT}.")
    return found


def world_places(control: ControlList, frame: Frame) -> FloatArray:
    """Points (P,3) in the world of a scene: NaN where the scene, or the list, has no place on the
    globe."""
    places = np.array([point.place for point in control.points], np.float64).reshape(-1, 3)
    if frame.kind != "metric" or control.system.upper() == LOCAL:
        return np.full_like(places, np.nan)
    return enu_from_geodetic(parse_crs(control.system).to_geodetic(places), frame.origin_lat_lon_alt)


def _with_marks(header: str, points: list[ListedPoint], lines: list[ListLine], source: str) -> ControlList:
    point_of, first = named_lines(lines, source)
    found = ControlList(system=header, marks={})
    checks = {name for name, line in zip(point_of, lines, strict=True) if line.check}
    for point in (*(ListedPoint(name, line.place, name in checks) for name, line in first.items()), *points):
        found = found.with_point(point)
    for name, line in zip(point_of, lines, strict=True):
        found.marks[name, line.image] = line.pixel
    return found


def _unmarked_point(source: str, number: int, words: list[str]) -> ListedPoint:
    return _table_point(source, number, [*words[3:4], *words[:3], *words[4:]])


def _table_point(source: str, number: int, words: list[str]) -> ListedPoint:
    try:
        east, north, up = (float(word) for word in words[1:4])
    except ValueError:
        raise BadInput(f"{source}, line {number}: {' '.join(words)[:80]!r} is no point, {POINT_HINT}.") from None
    if len(words) > 4 and words[4].lower() != CHECK:
        raise BadInput(f"{source}, line {number}: {words[4][:40]!r} stands behind the point, {POINT_HINT}.")
    return ListedPoint(words[0], (east, north, up), len(words) > 4)
