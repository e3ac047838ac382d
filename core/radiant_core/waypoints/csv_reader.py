"""Waypoints from CSV: a header that names the columns, then one waypoint a line. About 2 µs a cell.

Columns: lat or latitude, lon, lng or longitude, name or id, and heights in metres (`csv_heights`);
a unit may stand behind in brackets. Where the camera looks: heading or yaw (degrees from north),
gimbalpitchangle, gimbal_pitch or pitch (−90 is down); an empty cell, and a pitch beside the
gimbalmode 0, in which Litchi leaves the gimbal alone, says nothing. Other columns are ignored.
Separated by commas, semicolons or tabs, whichever the header has most; decimals with a point.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from typing import IO

from radiant_core.errors import BadInput
from radiant_core.io.csv_cells import text_of_cell
from radiant_core.waypoints.csv_heights import UNIT, CsvHeights
from radiant_core.waypoints.rows import WaypointRows, number

_COLUMNS = {
    "latitude": ("lat", "latitude"),
    "longitude": ("lon", "lng", "long", "longitude"),
    "name": ("name",),
    "id": ("id",),
    "heading": ("heading", "yaw"),
    "pitch": ("gimbalpitchangle", "gimbal_pitch", "gimbalpitch", "gimbal pitch", "pitch"),
    "gimbal mode": ("gimbalmode",),
}
MAX_NAME = 64
"""Characters of a column's name that are looked at."""
MAX_SHOWN = 12
"""Column names that an error lists."""


def csv_rows(file: IO[str]) -> WaypointRows:
    """The waypoints of an open CSV file (newline=""); BadInput with the line when it is none or a
    cell is no number."""
    header_line = file.readline()
    if not header_line.strip():
        raise BadInput("its first line is empty, expected a header such as name,latitude,longitude,altitude.")
    delimiter = max(",;\t", key=header_line.count)
    try:
        header = next(csv.reader([header_line], delimiter=delimiter, strict=True))
    except csv.Error as error:
        raise BadInput(f"its header is no line of CSV ({error}).") from None
    column = _columns(header)
    named = column.get("name", column.get("id"))
    heights = CsvHeights(_plain(header))
    rows = WaypointRows()
    for line, cells in _lines(file, delimiter):
        if not any(cell.strip() for cell in cells):
            continue
        if len(cells) != len(header):
            raise BadInput(f"line {line} has {len(cells)} cells, the header {len(header)}: give every line one cell per column.")
        lat = number(cells[column["latitude"]].strip(), f"the latitude in line {line}")
        lon = number(cells[column["longitude"]].strip(), f"the longitude in line {line}")
        alt, counts_from = heights.of_line(cells, line)
        rows.add("" if named is None else text_of_cell(cells[named]), (lat, lon), alt, counts_from, _looks_at_deg(cells, column, line))
    heights.settle(rows)
    return rows


def _looks_at_deg(cells: list[str], column: dict[str, int], line: int) -> tuple[float, float]:
    """Heading and pitch of a line, NaN where it has none."""

    def angle(quantity: str) -> float:
        text = cells[column[quantity]].strip() if quantity in column else ""
        return number(text, f"the {quantity} in line {line}") if text else math.nan

    aimed = "gimbal mode" not in column or cells[column["gimbal mode"]].strip() != "0"
    return angle("heading"), angle("pitch") if aimed else math.nan


def _lines(file: IO[str], delimiter: str) -> Iterator[tuple[int, list[str]]]:
    """Line number and cells of each record below the header."""
    reader = csv.reader(file, delimiter=delimiter, strict=True)
    try:
        for cells in reader:
            yield reader.line_num + 1, cells
    except csv.Error as error:
        raise BadInput(f"line {reader.line_num + 1} is no line of CSV ({error}).") from None


def _plain(header: list[str]) -> list[str]:
    """The columns' names in small letters."""
    # Of a name of thousands of blanks the patterns would try every split.
    return [" ".join(name.split())[:MAX_NAME].lower() for name in header]


def _columns(header: list[str]) -> dict[str, int]:
    """Which column of the header is what."""
    plain = [UNIT.sub("", name) for name in _plain(header)]
    columns: dict[str, int] = {}
    for quantity, names in _COLUMNS.items():
        places = [index for index, name in enumerate(plain) if name in names]
        if len(places) > 1:
            raise BadInput(f"its header has {len(places)} columns for the {quantity}: leave one.")
        if places:
            columns[quantity] = places[0]
    missing = [quantity for quantity in ("latitude", "longitude") if quantity not in columns]
    if missing:
        header_text = ", ".join(name.strip()[:40] for name in header[:MAX_SHOWN])
        raise BadInput(
            f"its first line names no {' and no '.join(missing)} (it has: {header_text}): name the columns latitude, longitude, altitude."
        )
    return columns
