"""The same waypoints as CSV, GeoJSON and KML."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from radiant_core.waypoints.reader import read_waypoints

ROWS = [("A 1", 47.37, 8.54, 430.0), ("Zürich ✈", 47.3701, 8.5402, 431.5), ('b,"c"', 47.3702, 8.5399, -2.25)]


def csv_text(delimiter: str = ",") -> str:
    quoted = [name.replace('"', '""') for name, *_ in ROWS]
    lines = [f'"{name}"{delimiter}{lat}{delimiter}{lon}{delimiter}{alt}' for name, (_, lat, lon, alt) in zip(quoted, ROWS, strict=True)]
    return "\r\n".join([delimiter.join(["Name", "Latitude", "Longitude", "Altitude"]), *lines]) + "\r\n"


def geojson_text() -> str:
    features = [
        {"type": "Feature", "properties": {"name": name}, "geometry": {"type": "Point", "coordinates": [lon, lat, alt]}}
        for name, lat, lon, alt in ROWS
    ]
    return json.dumps({"type": "FeatureCollection", "features": features}, ensure_ascii=False)


def kml_text() -> str:
    escaped = [name.replace('"', "&quot;") for name, *_ in ROWS]
    placemarks = [
        f"<Placemark><name>{name}</name><Point><altitudeMode>absolute</altitudeMode><coordinates>\n {lon},{lat},{alt} </coordinates>"
        "</Point></Placemark>"
        for name, (_, lat, lon, alt) in zip(escaped, ROWS, strict=True)
    ]
    body = "".join(placemarks)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2"><Document>{body}</Document></kml>'


GOOD: dict[str, Callable[[], str]] = {".csv": csv_text, ".geojson": geojson_text, ".json": geojson_text, ".kml": kml_text}


def kml(body: str) -> str:
    return f"<kml>{body}</kml>"


def placemark(body: str, name: str = "") -> str:
    return kml(f"<Placemark>{name and f'<name>{name}</name>'}{body}</Placemark>")


def written(folder: Path, name: str, content: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def assert_rows(path: Path) -> None:
    found = read_waypoints(path)
    assert found.waypoints.names == tuple(name for name, *_ in ROWS)
    np.testing.assert_array_equal(found.waypoints.lat_lon_alt, [row[1:] for row in ROWS])
    assert found.warnings == ()
