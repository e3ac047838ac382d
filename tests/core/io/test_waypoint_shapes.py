"""Waypoints as the points and lines of GeoJSON and KML: which are read, how they are named, and what is wrong with one."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pyproj import Transformer

from radiant_core.errors import BadInput
from radiant_core.waypoints.reader import read_waypoints
from tests.core.io.waypoint_files import assert_rows, kml, kml_text, placemark, written


def geometry(value: object, **properties: object) -> str:
    return json.dumps({"type": "Feature", "properties": properties or None, "geometry": value})


def point(coordinates: str) -> str:
    return kml(f"<Placemark><name>p</name><Point><coordinates>{coordinates}</coordinates></Point></Placemark>")


GEOJSON_POISON = [
    ("{", "not valid JSON"),
    ("[" * 2000, "not valid JSON"),
    ("[]", "no GeoJSON"),
    ("{}", "no GeoJSON"),
    ('{"type": "FeatureCollection"}', 'without a list "features"'),
    ('{"type": "FeatureCollection", "features": [3]}', "feature 1 is no object"),
    ('{"type": "FeatureCollection", "features": []}', "no waypoint"),
    ('{"type": "Circle"}', "type 'Circle'"),
    (geometry({"type": "Point"}), "position null"),
    (geometry({"type": "Point", "coordinates": [1]}), "expected numbers"),
    (geometry({"type": "Point", "coordinates": [True, 1]}), "expected numbers"),
    (geometry({"type": "Point", "coordinates": ["8", "47"]}), "expected numbers"),
    (geometry({"type": "Point", "coordinates": [10**400, 1]}), "beyond any degree"),
    ('{"type": "Point", "coordinates": [NaN, 1]}', "not finite"),
    ('{"type": "Point", "coordinates": [1e999, 1]}', "not finite"),
    (geometry({"type": "LineString", "coordinates": 3}), "without a list"),
    (geometry({"type": "MultiLineString", "coordinates": [3]}), "without a list"),
    (geometry({"type": "GeometryCollection"}), "without a list"),
    (geometry({"type": "Polygon", "coordinates": []}), "no waypoint but 1 × Polygon"),
    (geometry({"type": "Point", "coordinates": [35.36, 138.73]}, name="Fuji"), "probably swapped.*longitude first"),
    ('{"type": "Point", "coordinates": [8, 47], "crs": {"type": "name", "properties": {"name": "EPSG:32632"}}}', "EPSG:32632"),
    ('{"type": "Point", "coordinates": [8, 47], "crs": {"type": "name", "properties": {"name": "EPSG:999999"}}}', "999999"),
    ('{"type": "Point", "coordinates": [NaN, 5e6], "crs": {"type": "name", "properties": {"name": "EPSG:32632"}}}', "finite"),
    ('{"type": "Point", "coordinates": [8, 47], "crs": {"type": "link", "properties": {"href": "http://a/b"}}}', "by its EPSG code"),
    (geometry({"type": "Point", "coordinates": [8, 47]}, name="\ud800"), "half a character"),
]

LAUGHS = '<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;">]>' + point("8,47").replace("p</name>", "&b;</name>")

KML_POISON = [
    (LAUGHS, "declares a document type"),
    (LAUGHS.encode("utf-16"), "declares a document type"),
    ('<!DOCTYPE kml SYSTEM "a.dtd">' + point("8,47"), "declares a document type"),
    ("<kml>", "not valid XML"),
    ("kml", "not valid XML"),
    (point("8,47") + "<kml/>", "not valid XML"),
    (kml("&undefined;"), "not valid XML"),
    ("<gpx/>", "outermost element is <gpx>"),
    (kml(""), "no waypoint"),
    (point(""), "0 coordinates"),
    (point("8, 47"), "2 coordinates"),
    (point("8"), "has the coordinates '8'"),
    (point("8,47,1,2"), "expected longitude,latitude"),
    (point("8,x"), "'x', no number"),
    (point("nan,47"), "not finite"),
    (point("35.36,138.73"), "probably swapped"),
]


def test_all_geometries_with_waypoints_are_read_in_order(tmp_path: Path) -> None:
    points = [[8.54 + 1e-4 * index, 47.37, 5] for index in range(8)]
    collection = {
        "type": "GeometryCollection",
        "geometries": [{"type": "Point", "coordinates": points[0]}, {"type": "LineString", "coordinates": points[1:3]}],
    }
    features = [
        {"type": "Feature", "id": 7, "properties": None, "geometry": collection},
        {"type": "Feature", "properties": {"name": "m"}, "geometry": {"type": "MultiPoint", "coordinates": points[3:5]}},
        {"type": "Feature", "properties": {}, "geometry": {"type": "MultiLineString", "coordinates": [points[5:7], points[7:]]}},
        {"type": "Feature", "properties": {}, "geometry": None},
        {"type": "Feature", "properties": {}, "geometry": {"type": "Polygon", "coordinates": [[*points[:3], points[0]]]}},
    ]
    found = read_waypoints(written(tmp_path, "a.json", json.dumps({"type": "FeatureCollection", "features": features})))
    assert found.waypoints.names == ("7", "7-1", "7-2", "m-1", "m-2", "wp-1", "wp-2", "wp-3")
    np.testing.assert_array_equal(found.waypoints.lat_lon_alt, np.array(points)[:, [1, 0, 2]])
    assert found.warnings[-1].startswith("1 × feature without geometry, 1 × Polygon ignored")


@pytest.mark.parametrize(("content", "told"), GEOJSON_POISON)
def test_a_wrong_geojson_is_refused_in_one_sentence(tmp_path: Path, content: str, told: str) -> None:
    with pytest.raises(BadInput, match=told) as caught:
        read_waypoints(written(tmp_path, "a.geojson", content))
    assert "a.geojson" in str(caught.value)


@pytest.mark.parametrize(
    ("feature", "name"),
    [
        ({"properties": {"name": "n", "Name": "N", "id": 3}, "id": 4}, "n"),
        ({"properties": {"Name": "N", "id": 3}, "id": 4}, "N"),
        ({"properties": {"id": 3}, "id": 4}, "3"),
        ({"properties": {}, "id": 4}, "4"),
        ({"properties": {"name": True}, "id": "i"}, "i"),
        ({"properties": {"name": 2.5}}, "2.5"),
        ({"properties": [1], "id": "i"}, "i"),
        ({"properties": None}, "wp-1"),
    ],
)
def test_a_feature_is_named_by_the_first_of_these(tmp_path: Path, feature: dict, name: str) -> None:
    text = json.dumps({"type": "Feature", "geometry": {"type": "Point", "coordinates": [8.5, 47.5, 1]}, **feature})
    assert read_waypoints(written(tmp_path, "a.geojson", text)).waypoints.names == (name,)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('{"type": "FeatureCollection", "features": [{"type": "Other"}]}', 'feature 1 is no object of type "Feature"'),
        ('{"type": "Feature", "geometry": {"type": "Point", "coordinates": [1]}}', r"the feature has the position \[1\], expected numbers"),
        ('{"type": "Point", "coordinates": [1]}', r"the geometry has the position \[1\]"),
        ('{"type": "LineString", "coordinates": 3}', "the geometry is a LineString without a list of coordinates"),
        ('{"type": "GeometryCollection", "geometries": 3}', 'the geometry is a GeometryCollection without a list "geometries"'),
        ('{"type": "Feature", "geometry": 3}', "the feature has a geometry of type None"),
        ('{"type": 3}', 'it is no GeoJSON, which is an object with a "type"'),
    ],
)
def test_where_a_geojson_is_wrong_is_told(tmp_path: Path, text: str, told: str) -> None:
    with pytest.raises(BadInput, match=told):
        read_waypoints(written(tmp_path, "a.geojson", text))


@pytest.mark.parametrize("crs", [None, {"name": "urn:ogc:def:crs:OGC:1.3:CRS84"}, "EPSG:4326", {"properties": {"name": "EPSG:4979"}}])
def test_all_names_of_wgs84_are_known(tmp_path: Path, crs: object) -> None:
    text = json.dumps({"type": "Point", "coordinates": [8.5, 47.5, 1], "crs": crs})
    assert len(read_waypoints(written(tmp_path, "a.geojson", text)).waypoints) == 1


@pytest.mark.parametrize(
    ("code", "name"),
    [(2056, "urn:ogc:def:crs:EPSG::2056"), (32632, "urn:ogc:def:crs:EPSG:9.9.1:32632"), (32632, "EPSG:32632"), (25832, "EPSG:25832")],
)
def test_a_geojson_in_another_system_is_where_proj_has_it(tmp_path: Path, code: int, name: str) -> None:
    lat_lon = np.array([[47.3769, 8.5417], [47.3802, 8.5466]])
    moved = np.column_stack(Transformer.from_crs("EPSG:4326", f"EPSG:{code}", always_xy=True).transform(lat_lon[:, 1], lat_lon[:, 0]))
    line = {"type": "LineString", "coordinates": [[*moved[0], 60.0], [*moved[1], 75.0]]}
    text = json.dumps({**line, "crs": {"type": "name", "properties": {"name": name}}})
    found = read_waypoints(written(tmp_path, "a.geojson", text)).waypoints
    np.testing.assert_allclose(found.lat_lon_alt[:, :2], lat_lon, atol=2e-9)  # 0.2 mm
    assert found.lat_lon_alt[:, 2].tolist() == [60.0, 75.0], "altitudes are the flight's"


@pytest.mark.parametrize(("mode", "absolute"), [("absolute", True), ("relativeToGround", False), (None, False)])
def test_altitudes_above_the_sea_are_known_by_kmls_altitude_mode(tmp_path: Path, mode: str | None, absolute: bool) -> None:
    said = "" if mode is None else f"<altitudeMode>{mode}</altitudeMode>"
    text = placemark(f"<Point>{said}<coordinates>8,47,430</coordinates></Point>", "a")
    assert read_waypoints(written(tmp_path, "a.kml", text)).waypoints.absolute is absolute


def test_lines_and_nested_geometries_of_kml_are_read(tmp_path: Path) -> None:
    body = """<Document><Folder><Placemark><name> Route  1 </name><MultiGeometry>
      <LineString><altitudeMode>relativeToGround</altitudeMode><coordinates>8.54,47.37,5 8.5401,47.37,6
      8.5402,47.37</coordinates></LineString><Point><coordinates>8.55,47.37</coordinates></Point></MultiGeometry></Placemark>
      <Placemark><Polygon><outerBoundaryIs><LinearRing><coordinates>1,2 3,4 5,6 1,2</coordinates></LinearRing>
      </outerBoundaryIs></Polygon></Placemark>
      </Folder></Document>"""
    found = read_waypoints(written(tmp_path, "a.kml", kml(body)))
    assert found.waypoints.names == ("Route 1-1", "Route 1-2", "Route 1-3", "Route 1")
    np.testing.assert_array_equal(found.waypoints.lat_lon_alt[:, 1], [8.54, 8.5401, 8.5402, 8.55])
    assert len(found.warnings) == 2
    assert "1 × Polygon ignored" in found.warnings[1]


@pytest.mark.parametrize(("content", "told"), KML_POISON)
def test_a_wrong_kml_is_refused_in_one_sentence(tmp_path: Path, content: str | bytes, told: str) -> None:
    with pytest.raises(BadInput, match=told) as caught:
        read_waypoints(written(tmp_path, "a.kml", content))
    assert "a.kml" in str(caught.value)


def test_kml_says_its_encoding_in_vain_once_it_is_decoded(tmp_path: Path) -> None:
    text = kml_text().replace('encoding="UTF-8"', "encoding='ISO-8859-1'")
    assert_rows(written(tmp_path, "a.kml", text))


def test_a_very_deep_kml_ends(tmp_path: Path) -> None:
    deep = "<a>" * 2000 + "</a>" * 2000
    with pytest.raises(BadInput, match="no waypoint"):
        read_waypoints(written(tmp_path, "a.kml", kml(deep)))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (placemark("<Point/>"), "the placemark after 0 waypoints has a Point with 0 coordinates"),
        (placemark("<Point/>", "n" * 50), f"the placemark '{'n' * 40}' has a Point with 0 coordinates"),
        (placemark("<LineString/>", "n"), "the placemark 'n' has a LineString with 0 coordinates"),
        (
            placemark("<Point><coordinates>1</coordinates></Point>", "n"),
            "the placemark 'n' has the coordinates '1', expected longitude,latitude",
        ),
        (placemark("<Point><coordinates>x,1</coordinates></Point>", "n"), "a coordinate of the placemark 'n' is 'x', no number"),
        (placemark("<Point><coordinates>1,1,x</coordinates></Point>", "n"), "an altitude of the placemark 'n' is 'x', no number"),
        (placemark("<Polygon/><Track/><Model/>"), "no waypoint but 1 × Polygon, 1 × Track, 1 × Model"),
        (kml("<MyPlacemark><Point><coordinates>8,47</coordinates></Point></MyPlacemark>"), "it holds no waypoint: give at least one point"),
        ("<!ENTITY a>" + kml(""), "declares a document type or entities"),
    ],
)
def test_where_a_kml_is_wrong_is_told(tmp_path: Path, text: str, told: str) -> None:
    with pytest.raises(BadInput, match=told):
        read_waypoints(written(tmp_path, "a.kml", text))


def test_a_line_without_a_name_numbers_nothing_and_blanks_in_names_are_one(tmp_path: Path) -> None:
    line = "<LineString><coordinates>8.5,47.5,1 8.6,47.5,2</coordinates></LineString>"
    assert read_waypoints(written(tmp_path, "a.kml", placemark(line))).waypoints.names == ("wp-1", "wp-2")
    found = read_waypoints(written(tmp_path, "a.kml", placemark("<Point><coordinates>8.5,47.5</coordinates></Point>", " a \n b ")))
    assert found.waypoints.names == ("a b",)
    declared = "<?xml version='1.0' encoding='latin-1' standalone='yes'?>" + placemark(
        "<Point><coordinates>8.5,47.5</coordinates></Point>", "ü"
    )
    assert read_waypoints(written(tmp_path, "a.kml", declared)).waypoints.names == ("ü",)
