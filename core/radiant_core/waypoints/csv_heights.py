"""Heights in tables of waypoints: which columns hold them and what they count from. Once per file.

A column says it by its name. `alt` and `altitude` say nothing: flight planners fly them as heights
above take-off (Litchi, to 500 m; above the ground where its column altitudemode is 1), so they are
that, and absolute where one is beyond 500 m. Where a line has several, the first of these holds:
above take-off, above the ground, plain, above the ellipsoid, above the sea, absolute.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from radiant_core.choices import HeightFrom
from radiant_core.errors import BadInput
from radiant_core.plan.waypoints import HIGHEST_FLIGHT_M
from radiant_core.waypoints.rows import WaypointRows, number

COLUMNS: tuple[tuple[str, HeightFrom, tuple[str, ...]], ...] = (
    (
        "height above take-off",
        "takeoff",
        (
            *("heightabovetakeoff", "altitudeabovetakeoff", "altabovetakeoff", "relativealtitude", "altituderelative", "relativealt"),
            *("altrelative", "relalt", "altrel", "relativeheight", "heightrelative", "heightabovehome", "altitudeabovehome", "ato"),
        ),
    ),
    (
        "height above ground",
        "ground",
        (
            *("heightaboveground", "heightabovegroundlevel", "altitudeaboveground", "altitudeabovegroundlevel", "altaboveground"),
            *("altitudeagl", "altagl", "heightagl", "agl", "aglaltitude", "aglalt", "aglheight"),
        ),
    ),
    ("altitude", "takeoff", ("alt", "altitude")),
    (
        "height above the ellipsoid",
        "ellipsoid",
        (
            *("ellipsoidalheight", "ellipsoidheight", "heightellipsoid", "heightellipsoidal", "heightaboveellipsoid", "ellipsoidalalt"),
            *("altitudeellipsoid", "altitudeellipsoidal", "altellipsoid", "altitudeaboveellipsoid", "ellipsoidalaltitude", "hae"),
            *("altitudewgs84", "heightwgs84", "altwgs84", "wgs84altitude", "wgs84height", "althae", "altitudehae", "heighthae"),
        ),
    ),
    (
        "altitude above the sea",
        "sea",
        (
            *("altitudeamsl", "altamsl", "heightamsl", "amsl", "amslaltitude", "altitudemsl", "altmsl", "heightmsl", "msl", "mslaltitude"),
            *("altitudeabovesealevel", "heightabovesealevel", "altitudeabovemeansealevel", "orthometricheight", "altitudeasl", "asl"),
        ),
    ),
    ("absolute altitude", "absolute", ("altitudeabsolute", "absolutealtitude", "absalt", "absolutealt", "altabsolute")),
)
"""What a column is, what it counts from, and its names without blanks and signs, the first of which
that a line fills holds."""
UNIT = re.compile(r"\s*[(\[_ ]\s*(deg|degrees|°|m|metres|meters)\s*[)\]]?$")
_FEET = re.compile(r"\s*[(\[_ ]?\s*(ft|feet|foot|usft|us-ft|us_ft|ftus)\s*[)\]]?$")
_SIGNS = re.compile(r"[^a-z0-9]+")
_UNIT_FIRST = re.compile(r"[(\[]\s*([\w-]+)[\s,]+(agl|amsl|msl|hae)\s*[)\]]$")
"""As in "altitude (m AGL)"."""
_LIKE_HEIGHTS = re.compile(r"(?:^|[^a-z])(?:alt|altitude|height|elevation|elev|ele|z|h)(?:[^a-z]|$)|altitude|height")
"""Names of columns that may be heights, of which nothing says what they count from or in what."""
_NO_HEIGHTS = re.compile(r"image|picture|photo|sensor|frame|error|accuracy|mode|std|sigma|gimbal")
_MAX_NAMED = 3
_MODES: dict[str, HeightFrom] = {"": "takeoff", "0": "takeoff", "1": "ground"}
"""Litchi's altitudemode: 1 where "Above Ground" is ticked."""


@dataclass(frozen=True)
class _Column:
    index: int
    quantity: str
    counts_from: HeightFrom
    header: str


class CsvHeights:
    """The columns of heights of a header, its names in small letters; BadInput for two of a kind,
    and for feet."""

    def __init__(self, header: Sequence[str]) -> None:
        header = [_UNIT_FIRST.sub(r"\2 (\1)", name) for name in header]
        stems = [_SIGNS.sub("", UNIT.sub("", name)) for name in header]
        self._mode = stems.index("altitudemode") if "altitudemode" in stems else None
        self._columns = [column for quantity, kind, names in COLUMNS for column in _columns_of(header, stems, quantity, kind, names)]
        read_indices = {column.index for column in self._columns}
        self._unread = [name for index, name in enumerate(header) if index not in read_indices and _may_be_height(name)]
        self._highest_plain_m = 0.0

    def of_line(self, cells: Sequence[str], line: int) -> tuple[float | None, HeightFrom]:
        """The height in a line and what it counts from; None where it has none."""
        for column in self._columns:
            text = cells[column.index].strip()
            if not text:
                continue
            height = number(text, f"the {column.quantity} in line {line}")
            if column.quantity != "altitude":
                return height, column.counts_from
            counts_from = self._mode_of(cells, line)
            if counts_from == "takeoff":
                self._highest_plain_m = max(self._highest_plain_m, height)
            return height, counts_from
        return None, "unknown"

    def settle(self, rows: WaypointRows) -> None:
        """What is known once all lines are read: whether plain altitudes can be heights above
        take-off, and what of the table is not used."""
        titles = {column.quantity: column.header for column in self._columns}
        if self._highest_plain_m > HIGHEST_FLIGHT_M and "height above take-off" not in titles:
            rows.notes.append(
                f"The column {titles['altitude']!r} has altitudes up to {self._highest_plain_m:g} m, more than anybody flies above take-off"
                ": taken from the sea or the ellipsoid."
            )
            rows.reckon("takeoff", "absolute")
        if len(self._columns) > 1:
            first, *others = (repr(column.header) for column in self._columns)
            rows.notes.append(f"Heights are those of the column {first}; {', '.join(others)} only where that is empty.")
        if self._unread and not self._columns:
            named = ", ".join(repr(name) for name in self._unread[:_MAX_NAMED])
            rows.notes.append(
                f"Not read as heights, since their names do not say what they count from in metres: {named}. Name the column altitude(m) "
                "where it is above take-off, altitude_agl(m) above the ground, altitude_amsl(m) above the sea, altitude_ellipsoid(m)."
            )

    def _mode_of(self, cells: Sequence[str], line: int) -> HeightFrom:
        text = "" if self._mode is None else cells[self._mode].strip()
        if text not in _MODES:
            raise BadInput(f"the altitudemode in line {line} is {text[:40]!r}, expected 0 (above take-off) or 1 (above the ground).")
        return _MODES[text]


def _may_be_height(name: str) -> bool:
    return _LIKE_HEIGHTS.search(name) is not None and _NO_HEIGHTS.search(name) is None


def _columns_of(header: Sequence[str], stems: Sequence[str], quantity: str, kind: HeightFrom, names: tuple[str, ...]) -> list[_Column]:
    in_feet = next((name for name in header if _FEET.search(name) and _SIGNS.sub("", _FEET.sub("", name)) in names), None)
    if in_feet is not None:
        raise BadInput(f"its column {in_feet!r} is in feet: convert it to metres and call it altitude.")
    places = [index for index, stem in enumerate(stems) if stem in names]
    if len(places) > 1:
        raise BadInput(f"its header has {len(places)} columns for the {quantity}: leave one.")
    return [_Column(index, quantity, kind, header[index]) for index in places]
