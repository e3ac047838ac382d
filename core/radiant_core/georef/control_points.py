"""Ground control: surveyed points and where photographs show them. Once per scene.

    EPSG:32632
    465270.42 5246384.77 430.11  1203.5 877.2  DJI_0012.JPG  gcp-1
    465301.00 5246402.18 431.40   310.0 1500.9 DJI_0040.JPG  gcp-7  check

The list is OpenDroneMap's: the system on the first line (EPSG code, PROJ string, WKT, or WGS84 UTM
32N), then east north up, column and row in px of the photograph as it is stored, its name, and the
point's name; without one, lines with equal coordinates are one point. The middle of the upper left
pixel is at (0.5, 0.5). `LOCAL` on the first line: metres east, north, up of a site that has no
place on the globe. The word `check` behind the name keeps a point out of the adjustment.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.frames import enu_from_geodetic
from radiant_core.georef.crs import Crs, parse_crs
from radiant_core.io.run_store import read_bounded
from radiant_core.numerics import FloatArray

LOCAL = "LOCAL"
CHECK = "check"
DEFAULT_ACCURACY_M = 0.02
MAX_LIST_BYTES = 1 << 24
MAX_LOCAL_M = 1e5
EVERY = re.compile(r"every:(\d+)")
HINT = "expected: east north up column row photograph [name [check]]"


@dataclass(frozen=True, kw_only=True)
class ControlRequest:
    """A list of ground control as it came, so that a stage is keyed by its content."""

    text: str
    source: str
    """Name of the file, for messages."""
    horizontal_m: float = DEFAULT_ACCURACY_M
    """Standard deviation of the surveyed coordinates per axis of the plane."""
    vertical_m: float = DEFAULT_ACCURACY_M
    check: str = ""
    """Names of points kept out, with commas, or every:K."""

    def __post_init__(self) -> None:
        for value in (self.horizontal_m, self.vertical_m):
            if not 1e-4 <= value <= 100:
                raise BadInput(f"--gcp-accuracy has {value} m, expected a standard deviation of 0.0001 to 100 m.")


@dataclass(frozen=True, kw_only=True, eq=False)
class ControlPoints:
    """G points and M marks of them in photographs."""

    names: tuple[str, ...]
    places_m: FloatArray
    """(G,3) m east, north, up of `origin_lat_lon_alt`, or of the site's own zero."""
    is_check: NDArray[np.bool_]
    """(G,) whether a point is kept out of the adjustment."""
    sigmas_m: FloatArray
    """(3,) standard deviations of the survey."""
    origin_lat_lon_alt: FloatArray | None
    """(3,) [deg, deg, m]; None for a local site."""
    system: str
    """Title of the list's system."""
    mark_points: NDArray[np.int64]
    """(M,) which point."""
    mark_images: tuple[str, ...]
    """(M) name of the photograph."""
    mark_pixels: FloatArray
    """(M,2) column and row."""


@dataclass(frozen=True)
class ListLine:
    """A line of the list: place in its system, pixel (column, row), photograph, name or nothing,
    and whether the point is kept out."""

    place: tuple[float, float, float]
    pixel: tuple[float, float]
    image: str
    name: str
    check: bool


def control_request(path: Path, accuracy: str | None, check: str | None) -> ControlRequest:
    """Read `--gcp`, `--gcp-accuracy` M or H,V in metres, and `--check-points`; BadInput for a file
    that is no list, whose content is parsed here once to say so early."""
    text = read_list(path)
    horizontal_m, vertical_m = _accuracy(accuracy)
    request = ControlRequest(text=text, source=path.name, horizontal_m=horizontal_m, vertical_m=vertical_m, check=check or "")
    parse_control(request)
    return request


def read_list(path: Path) -> str:
    """The text of a list of points; BadInput where there is none."""
    if not path.is_file():
        raise BadInput(f"there is no file {path}: give a list of surveyed points, such as gcp_list.txt.")
    try:
        return read_bounded(path, MAX_LIST_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise BadInput(f"{path} is no text in UTF-8: write the list of points as plain text.") from None


def system_of(header: str, source: str) -> Crs | None:
    """The system that a list's first line names, None for `LOCAL`; BadInput where it names none."""
    if header.upper() == LOCAL:
        return None
    try:
        return parse_crs(header)
    except BadInput as error:
        raise BadInput(f"{source}, first line: {error} LOCAL is a site without a place on the globe.") from None


def parse_control(request: ControlRequest) -> ControlPoints:
    """The points and marks of a list; BadInput names the line that is wrong, or the point that is
    asked for and not there."""
    rows = [(number, line.split("#", 1)[0].strip()) for number, line in enumerate(request.text.splitlines(), 1)]
    rows = [(number, line) for number, line in rows if line]
    if len(rows) < 2:
        raise BadInput(f"{request.source} has no points: the system stands on its first line, then {HINT}.")
    header, lines = rows[0][1], [list_line(request.source, number, line) for number, line in rows[1:]]
    point_of, first = named_lines(lines, request.source)
    names = tuple(first)
    index = {name: row for row, name in enumerate(names)}
    places = np.array([first[name].place for name in names])
    places_m, origin, system = _in_metres(header, places, request.source)
    marked = {name for name, line in zip(point_of, lines, strict=True) if line.check}
    return ControlPoints(
        names=names,
        places_m=places_m,
        is_check=_checks(names, marked, request),
        sigmas_m=np.array([request.horizontal_m, request.horizontal_m, request.vertical_m]),
        origin_lat_lon_alt=origin,
        system=system,
        mark_points=np.array([index[name] for name in point_of], np.int64),
        mark_images=tuple(line.image for line in lines),
        mark_pixels=np.array([line.pixel for line in lines]),
    )


def _accuracy(text: str | None) -> tuple[float, float]:
    if text is None:
        return DEFAULT_ACCURACY_M, DEFAULT_ACCURACY_M
    try:
        parts = [float(part) for part in text.split(",")]
    except ValueError:
        parts = []
    if len(parts) not in (1, 2):
        raise BadInput(f"--gcp-accuracy is {text!r}, expected metres such as 0.02, or two with a comma: horizontal, vertical.")
    return parts[0], parts[-1]


def named_lines(lines: Sequence[ListLine], source: str) -> tuple[list[str], dict[str, ListLine]]:
    """The point of each line, and the first line of each point; lines without a name are one point
    where their place is. BadInput for a point with two places."""
    first: dict[str, ListLine] = {}
    by_place: dict[tuple[float, float, float], str] = {}
    point_of: list[str] = []
    for line in lines:
        name = line.name or by_place.setdefault(line.place, f"gcp-{len(by_place) + 1}")
        before = first.setdefault(name, line)
        if before.place != line.place:
            raise BadInput(f"{source}: point {name!r} has two places, {before.place} and {line.place}: give each point its own name.")
        point_of.append(name)
    return point_of, first


def list_line(source: str, number: int, text: str) -> ListLine:
    """A mark of the list; BadInput names the line that is none."""
    words = text.split()
    try:
        if len(words) < 6:
            raise ValueError
        values = [float(word) for word in words[:5]]
    except ValueError:
        raise BadInput(f"{source}, line {number}: {text[:80]!r} is no mark of a point, {HINT}.") from None
    if not all(np.isfinite(values)) or max(abs(value) for value in values) > 1e9:
        raise BadInput(f"{source}, line {number}: a number is not finite or beyond 1e9: {HINT}.")
    east, north, up, column, row = values
    name = words[6] if len(words) > 6 else ""
    return ListLine((east, north, up), (column, row), words[5], name, CHECK in [word.lower() for word in words[7:]])


def _in_metres(header: str, places: FloatArray, source: str) -> tuple[FloatArray, FloatArray | None, str]:
    """Places (G,3) in metres east, north, up, the origin, and what the system is called."""
    crs = system_of(header, source)
    if crs is None:
        if np.abs(places).max() > MAX_LOCAL_M:
            raise BadInput(f"{source}: LOCAL coordinates reach {np.abs(places).max():,.0f} m: subtract what they have in common.")
        return places, None, LOCAL
    geodetic = crs.to_geodetic(places)
    origin = geodetic.mean(axis=0)
    return enu_from_geodetic(geodetic, origin), origin, crs.title


def _checks(names: Sequence[str], marked: set[str], request: ControlRequest) -> NDArray[np.bool_]:
    every = EVERY.fullmatch(request.check.strip())
    if every is not None:
        step = int(every[1])
        if step < 2:
            raise BadInput(f"--check-points {request.check} keeps out all points: give every:2 or more.")
        return np.array([name in marked or row % step == step - 1 for row, name in enumerate(names)])
    asked = {name.strip() for name in request.check.split(",") if name.strip()}
    lost = sorted(asked - set(names))
    if lost:
        raise BadInput(f"--check-points names {lost[0]!r}, which is no point of {request.source}: its points are {', '.join(names[:8])} …")
    return np.array([name in marked or name in asked for name in names])
