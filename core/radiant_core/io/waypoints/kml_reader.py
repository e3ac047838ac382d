"""Waypoints from KML (OGC 12-007r2): points or vertices of lines, "lon,lat[,alt]". Once per file.

Document types and entities are refused before parsing, so that nothing is fetched or expanded.
Elements are dropped once they are read.
"""

from __future__ import annotations

import io
import re
from functools import lru_cache
from xml.etree.ElementTree import Element, ParseError, iterparse

from radiant_core.errors import BadInput
from radiant_core.io.waypoints.rows import WaypointRows, number

_DECLARED_ENCODING = re.compile(r"^(\s*<\?xml[^>]*?)\sencoding\s*=\s*(\"[^\"]*\"|'[^']*')")


def kml_rows(text: str) -> WaypointRows:
    """The waypoints of a KML text; BadInput with the reason when it is none."""
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise BadInput("it declares a document type or entities, which KML does not need and which are not read.")
    # The text is decoded already; what the first line says of its former encoding no longer holds.
    data = _DECLARED_ENCODING.sub(r"\1", text[:200]) + text[200:]
    rows = WaypointRows()
    # What is dangerous here needs the DTD that was refused above.
    parser = iterparse(io.BytesIO(data.encode()), events=("end",))  # noqa: S314
    try:
        for _, element in parser:
            if element.tag.endswith("Placemark") and _local(element.tag) == "Placemark":
                _add_placemark(rows, element)
                element.clear()
    except ParseError as error:
        raise BadInput(f"it is not valid XML ({error}).") from None
    root: Element = parser.root  # pyright: ignore[reportAttributeAccessIssue]  not in its stub
    if _local(root.tag) != "kml":
        raise BadInput(f"its outermost element is <{_local(root.tag)[:40]}>, expected <kml>.")
    return rows


@lru_cache(maxsize=256)
def _local(tag: str) -> str:
    """An element's name without its namespace."""
    return tag.rsplit("}", 1)[-1]


def _add_placemark(rows: WaypointRows, placemark: Element) -> None:
    name = next((child.text or "" for child in placemark if _local(child.tag) == "name"), "").strip()
    place = f"the placemark {name[:40]!r}" if name else f"the placemark after {len(rows.names)} waypoints"
    for geometry in placemark.iter():
        kind = _local(geometry.tag)
        if kind in ("Polygon", "Track", "Model"):
            rows.ignored[kind] += 1
        if kind not in ("Point", "LineString"):
            continue
        tuples = " ".join(child.text or "" for child in geometry if _local(child.tag) == "coordinates").split()
        if any(_local(child.tag) == "altitudeMode" and (child.text or "").strip() == "absolute" for child in geometry):
            rows.absolute = True
        if not tuples or (kind == "Point" and len(tuples) > 1):
            raise BadInput(f"{place} has a {kind} with {len(tuples)} coordinates, expected longitude,latitude,altitude without blanks.")
        for index, written in enumerate(tuples, start=1):
            _add_tuple(rows, place, f"{name}-{index}" if name and kind == "LineString" else name, written)


def _add_tuple(rows: WaypointRows, place: str, name: str, written: str) -> None:
    parts = written.split(",")
    if len(parts) not in (2, 3):
        raise BadInput(f"{place} has the coordinates {written[:60]!r}, expected longitude,latitude or longitude,latitude,altitude.")
    lon, lat = (number(part, f"a coordinate of {place}") for part in parts[:2])
    rows.add(name, lat, lon, number(parts[2], f"an altitude of {place}") if len(parts) == 3 else None)
