"""Waypoints from KML (OGC 12-007r2): points or vertices of lines, "lon,lat[,alt]". Once per file.

The third number is a height only where the geometry's own altitudeMode says of what: clampToGround,
which holds where none stands, and clampToSeaFloor are to be read without it (OGC 12-007r2, 9.20).
Routes of DJI (`wpml_heights`) have their heights beside the coordinates. Document types and
entities are refused before parsing, so that nothing is fetched or expanded. Elements are dropped
once they are read. An altitudeOffset (KML 2.3; Google's extension) is added to the heights of its
geometry.
"""

from __future__ import annotations

import io
import math
import re
from functools import lru_cache
from typing import NamedTuple
from xml.etree.ElementTree import Element, ParseError, iterparse

from radiant_core.choices import HeightFrom
from radiant_core.errors import BadInput
from radiant_core.waypoints.rows import WaypointRows, number
from radiant_core.waypoints.wpml_heights import WpmlHeights

MODES: dict[str, HeightFrom] = {
    "clampToGround": "unknown",
    "relativeToGround": "ground",
    "absolute": "sea",
    "clampToSeaFloor": "unknown",
    "relativeToSeaFloor": "unknown",
}
"""What each altitudeMode lets the third number count from; the sea floor's depth is not known."""
MODE_NAMES = ("altitudeMode", "seaFloorAltitudeMode")
"""gx:altitudeMode of Google's extension has the first name too; KML 2.3 has the second."""
SEA_FLOOR = ("clampToSeaFloor", "relativeToSeaFloor")
_DECLARED_ENCODING = re.compile(r"^(\s*<\?xml[^>]*?)\sencoding\s*=\s*(\"[^\"]*\"|'[^']*')")


def kml_rows(text: str) -> WaypointRows:
    """The waypoints of a KML text; BadInput with the reason when it is none."""
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise BadInput("it declares a document type or entities, which KML does not need and which are not read.")
    # The text is decoded already; what the first line says of its former encoding no longer holds.
    data = _DECLARED_ENCODING.sub(r"\1", text[:200]) + text[200:]
    reading = _Reading()
    # What is dangerous here needs the DTD that was refused above.
    parser = iterparse(io.BytesIO(data.encode()), events=("end",))  # noqa: S314
    try:
        for _, element in parser:
            reading.take(element)
    except ParseError as error:
        raise BadInput(f"it is not valid XML ({error}).") from None
    root: Element = parser.root  # pyright: ignore[reportAttributeAccessIssue]  not in its stub
    if _local(root.tag) != "kml":
        raise BadInput(f"its outermost element is <{_local(root.tag)[:40]}>, expected <kml>.")
    return reading.finished()


@lru_cache(maxsize=256)
def _local(tag: str) -> str:
    """An element's name without its namespace."""
    return tag.rsplit("}", 1)[-1]


class _Reading:
    """Rows while a file is read."""

    def __init__(self) -> None:
        self.rows = WaypointRows()
        self.wpml = WpmlHeights(self.rows)
        self.num_clamped, self.highest_clamped, self.num_over_sea_floor = 0, 0.0, 0

    def take(self, element: Element) -> None:
        """An element that has ended."""
        name = _local(element.tag)
        if name == "Placemark":
            before = len(self.rows.names)
            self._add_placemark(element)
            self.wpml.take_placemark({_local(child.tag): (child.text or "").strip() for child in element}, before)
            element.clear()
        elif name == "Folder":
            self.wpml.end_folder()
        else:
            self.wpml.take_setting(name, element.text)

    def finished(self) -> WaypointRows:
        """The rows, and what is to be said of them."""
        self.wpml.end_folder()
        if self.num_clamped:
            self.rows.notes.append(
                f"{self.num_clamped} of {len(self.rows.names)} waypoints are clamped to the ground, which clampToGround and no altitudeMode"
                f" mean in KML: their third numbers, up to {self.highest_clamped:g}, are no heights."
            )
        if self.num_over_sea_floor:
            self.rows.notes.append(
                f"{self.num_over_sea_floor} of {len(self.rows.names)} waypoints count from the sea floor, as their altitudeMode says, and "
                "its depth is not known: their third numbers are no heights."
            )
        return self.rows

    def _add_placemark(self, placemark: Element) -> None:
        name = next((child.text or "" for child in placemark if _local(child.tag) == "name"), "").strip()
        place = f"the placemark {name[:40]!r}" if name else f"the placemark after {len(self.rows.names)} waypoints"
        for geometry in placemark.iter():
            kind = _local(geometry.tag)
            if kind in ("Polygon", "Track", "Model"):
                self.rows.ignored[kind] += 1
            if kind not in ("Point", "LineString"):
                continue
            tuples = " ".join(child.text or "" for child in geometry if _local(child.tag) == "coordinates").split()
            if not tuples or (kind == "Point" and len(tuples) > 1):
                raise BadInput(f"{place} has a {kind} with {len(tuples)} coordinates, expected longitude,latitude,altitude without blanks.")
            heights = _heights_of(geometry, place)
            for index, written in enumerate(tuples, start=1):
                self._add_tuple(place, f"{name}-{index}" if name and kind == "LineString" else name, written, heights)

    def _add_tuple(self, place: str, name: str, written: str, heights: _Heights) -> None:
        parts = written.split(",")
        if len(parts) not in (2, 3):
            raise BadInput(f"{place} has the coordinates {written[:60]!r}, expected longitude,latitude or longitude,latitude,altitude.")
        lon, lat = (number(part, f"a coordinate of {place}") for part in parts[:2])
        alt = number(parts[2], f"an altitude of {place}") if len(parts) == 3 else None
        if alt is not None and heights.over_sea_floor:
            self.num_over_sea_floor += 1
        elif alt is not None and heights.counts_from == "unknown":
            self.num_clamped, self.highest_clamped = self.num_clamped + 1, max(self.highest_clamped, alt)
        self.rows.add(name, (lat, lon), None if alt is None else alt + heights.offset_m, heights.counts_from)


class _Heights(NamedTuple):
    """How third numbers of a geometry become heights."""

    counts_from: HeightFrom
    over_sea_floor: bool
    offset_m: float


def _heights_of(geometry: Element, place: str) -> _Heights:
    """What a geometry's own altitudeMode and altitudeOffset say; BadInput for an unknown mode, for
    several that contradict, and for an offset that is no number."""
    modes = [(child.text or "").strip() for child in geometry if _local(child.tag) in MODE_NAMES]
    unknown = next((mode for mode in modes if mode and mode not in MODES), None)
    if unknown is not None:
        raise BadInput(f"{place} has the altitudeMode {unknown[:40]!r}, expected one of {', '.join(MODES)}.")
    meant: set[HeightFrom] = {MODES[mode] for mode in modes if mode}
    if len(meant) > 1:
        raise BadInput(f"{place} has the altitudeModes {' and '.join(modes)}, which contradict: leave one.")
    written = [(child.text or "").strip() for child in geometry if _local(child.tag) == "altitudeOffset"]
    offset_m = sum(number(text, f"the altitudeOffset of {place}") for text in written if text)
    if not math.isfinite(offset_m):
        raise BadInput(f"{place} has the altitudeOffset {offset_m}, expected metres.")
    return _Heights(meant.pop() if meant else "unknown", any(mode in SEA_FLOOR for mode in modes), offset_m)
