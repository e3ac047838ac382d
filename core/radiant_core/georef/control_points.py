"""Ground control: surveyed points and where photographs show them. Once per scene.

    EPSG:32632
    465270.42 5246384.77 430.11  1203.5 877.2  DJI_0012.JPG  gcp-1
    465301.00 5246402.18 431.40   310.0 1500.9 DJI_0040.JPG  gcp-7  check

The list is OpenDroneMap's: the system on the first line (EPSG code, PROJ string, WKT, or WGS84 UTM
32N), then east north up in the units of that system, column and row in px of the photograph as it
is stored, its name, and the point's name; without one, lines with equal coordinates are one point.
In the list the middle of the upper left pixel is at (0, 0), here at (0.5, 0.5): `list_lines`.
`LOCAL` on the first line: metres east, north, up of a site that has no place on the globe. The word
`check` behind the name keeps a point out of the adjustment.
"""

from __future__ import annotations

import codecs
import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PureWindowsPath

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.frames import enu_from_geodetic
from radiant_core.georef.crs import Crs, grid_warnings, parse_crs
from radiant_core.georef.list_lines import HINT, ListLine, content_lines, fields_of, header_of, is_column_names, list_line, with_points
from radiant_core.io.run_store import read_bounded
from radiant_core.numerics import FloatArray

FORMS: tuple[Callable[[str], str], ...] = (
    lambda name: name.replace("\\", "/"),
    lambda name: name.replace("\\", "/").casefold(),
    lambda name: PureWindowsPath(name).name,
    lambda name: PureWindowsPath(name).name.casefold(),
)
"""What names have in common, the strictest first: a Windows path also splits at slashes."""


def match_names(listed: Iterable[str], photographs: Sequence[str]) -> dict[str, str]:
    """Listed name → the photograph that it means: itself, or the only one that is the same without
    its folder or in other letters. What is not there, or fits two, stays as it is."""
    there, wanted = set(photographs), list(dict.fromkeys(listed))
    matched = {name: name for name in wanted if name in there}
    for form in FORMS:
        counts = Counter(form(name) for name in photographs)
        by_form = {form(name): name for name in photographs if counts[form(name)] == 1}
        matched |= {name: by_form[form(name)] for name in wanted if name not in matched and form(name) in by_form}
    # Two names of a list that would become one photograph are two things.
    num_claims = Counter(matched.values())
    return {name: matched[name] if name in matched and num_claims[matched[name]] == 1 else name for name in wanted}


def matched_warning(matched: dict[str, str]) -> tuple[str, ...]:
    """What was matched by more than its name, with an example; nothing where nothing was."""
    others = [(name, photograph) for name, photograph in matched.items() if name != photograph]
    if not others:
        return ()
    name, photograph = others[0]
    return (f"{len(others)} photographs of the list have another folder or other letters here: {name!r} is taken for {photograph!r}.",)


LOCAL = "LOCAL"
DEFAULT_ACCURACY_M = 0.02
OTHER_FORMS = {"{": "JSON, such as OpenSfM's ground_control_points.json", "<": "XML, such as Metashape's markers"}
"""What lists of other programs begin with."""
MAX_LIST_BYTES = 1 << 24
MAX_LOCAL_M = 1e5
EVERY = re.compile(r"every:(\d+)")


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
    require_grids: bool = False
    """Whether a system whose best transformation lacks a grid is refused, not warned of."""

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
    """(M,2) column and row, the middle of the first pixel at (0.5, 0.5)."""
    warnings: tuple[str, ...] = ()
    """What the list is to be taken with."""


def control_request(path: Path, accuracy: str | None, check: str | None, *, require_grids: bool = False) -> ControlRequest:
    """Read `--gcp`, `--gcp-accuracy` M or H,V in metres, and `--check-points`; BadInput for a file
    that is no list, whose content is parsed here once to say so early."""
    text = read_list(path)
    horizontal_m, vertical_m = _accuracy(accuracy)
    request = ControlRequest(
        text=text, source=path.name, horizontal_m=horizontal_m, vertical_m=vertical_m, check=check or "", require_grids=require_grids
    )
    parse_control(request)
    return request


def read_list(path: Path) -> str:
    """The text of a list of points; BadInput where there is none."""
    if not path.is_file():
        raise BadInput(f"there is no file {path}: give a list of surveyed points, such as gcp_list.txt.")
    data = read_bounded(path, MAX_LIST_BYTES)
    # A table saved as "Unicode text" is UTF-16.
    encoding = "utf-16" if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "utf-8-sig"
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError:
        raise BadInput(f"{path} is no text in UTF-8: write the list of points as plain text.") from None
    program = next((name for sign, name in OTHER_FORMS.items() if text.lstrip().startswith(sign)), None)
    if program is not None:
        raise BadInput(f"{path} is {program}, which is not read: write gcp_list.txt, the system on the first line, then {HINT}.")
    return text


def system_of(header: str, source: str) -> Crs | None:
    """The system that a list's first line names, None for `LOCAL`; BadInput where it names none."""
    if header.upper() == LOCAL:
        return None
    try:
        return parse_crs(header)
    except BadInput as error:
        raise BadInput(f"{source}, first line: {error} LOCAL is a site without a place on the globe.") from None


def parse_control(request: ControlRequest, photographs: Sequence[str] = ()) -> ControlPoints:
    """The points and marks of a list, which names `photographs`, where those are known, perhaps
    with a folder or in other letters; BadInput names the line that is wrong, or the point that is
    asked for and not there."""
    rows = content_lines(request.text)
    if len(rows) < 2:
        raise BadInput(f"{request.source} has no points: the system stands on its first line, then {HINT}.")
    header = header_of(rows[0][1])
    fields = with_points((fields_of(number, line) for number, line in rows[1:]), request.source)
    fields = fields[is_column_names(fields[0], request.source) :]
    lines, matched = matched_lines([list_line(request.source, line, photographs) for line in fields], photographs)
    point_of, first = named_lines(lines, request.source)
    names = tuple(first)
    index = {name: row for row, name in enumerate(names)}
    places = np.array([first[name].place for name in names]).reshape(-1, 3)
    placed = _in_metres(header, places, request)
    marked = {name for name, line in zip(point_of, lines, strict=True) if line.check}
    return ControlPoints(
        names=names,
        places_m=placed.places_m,
        is_check=_checks(names, marked, request),
        sigmas_m=np.array([request.horizontal_m, request.horizontal_m, request.vertical_m]),
        origin_lat_lon_alt=placed.origin,
        system=placed.system,
        mark_points=np.array([index[name] for name in point_of], np.int64),
        mark_images=tuple(line.image for line in lines),
        mark_pixels=np.array([line.pixel for line in lines]).reshape(-1, 2),
        warnings=(*placed.warnings, *matched),
    )


def matched_lines(lines: list[ListLine], photographs: Sequence[str]) -> tuple[list[ListLine], tuple[str, ...]]:
    """The lines with the names of photographs as they are here, and what was matched for that."""
    if not photographs:
        return lines, ()
    matched = match_names((line.image for line in lines), photographs)
    return [replace(line, image=matched[line.image]) for line in lines], matched_warning(matched)


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
    where their place is, and names have blanks where that alone gives each point one place.
    BadInput for a point with two places, or two marks in one photograph."""
    if _two_places(lines) is not None:
        whole = [replace(line, name=line.words) for line in lines]
        lines = whole if _two_places(whole) is None else lines
    first: dict[str, ListLine] = {}
    by_place: dict[tuple[float, float, float], str] = {}
    point_of: list[str] = []
    marks: dict[tuple[str, str], tuple[float, float]] = {}
    for line in lines:
        name = line.name or by_place.setdefault(line.place, f"gcp-{len(by_place) + 1}")
        before = first.setdefault(name, line)
        if before.place != line.place:
            raise BadInput(f"{source}: point {name!r} has two places, {before.place} and {line.place}: give each point its own name.")
        if marks.setdefault((name, line.image), line.pixel) != line.pixel:
            raise BadInput(f"{source}: point {name!r} has two marks in {line.image!r}: keep one of them.")
        point_of.append(name)
    return point_of, first


def _two_places(lines: Sequence[ListLine]) -> str | None:
    """A name that stands beside two places, if there is one."""
    place_of: dict[str, tuple[float, float, float]] = {}
    return next((line.name for line in lines if line.name and place_of.setdefault(line.name, line.place) != line.place), None)


@dataclass(frozen=True)
class _Placed:
    places_m: FloatArray
    origin: FloatArray | None
    system: str
    warnings: tuple[str, ...]


def _in_metres(header: str, places: FloatArray, request: ControlRequest) -> _Placed:
    """Places (G,3) of the list's system in metres east, north, up of an origin, and what the system
    is called."""
    crs = system_of(header, request.source)
    if crs is None:
        if np.abs(places).max() > MAX_LOCAL_M:
            raise BadInput(f"{request.source}: LOCAL coordinates reach {np.abs(places).max():,.0f} m: subtract what they have in common.")
        return _Placed(places, None, LOCAL, ())
    geodetic = crs.to_geodetic(places)
    origin = geodetic.mean(axis=0)
    warnings = grid_warnings(crs, geodetic, require_grids=request.require_grids)
    return _Placed(enu_from_geodetic(geodetic, origin), origin, crs.title, tuple(f"{request.source}: {text}" for text in warnings))


def _checks(names: Sequence[str], marked: set[str], request: ControlRequest) -> NDArray[np.bool_]:
    every = EVERY.fullmatch(request.check.strip())
    if every is not None:
        step = int(every[1])
        if step < 2:
            raise BadInput(f"--check-points {request.check} keeps out all points: give every:2 or more.")
        return np.array([name in marked or row % step == step - 1 for row, name in enumerate(names)])
    check_names = {name.strip() for name in request.check.split(",") if name.strip()}
    lost = sorted(check_names - set(names))
    if lost:
        raise BadInput(f"--check-points names {lost[0]!r}, which is no point of {request.source}: its points are {', '.join(names[:8])} …")
    return np.array([name in marked or name in check_names for name in names])
