"""Readers of waypoints: the three formats say the same, a stranger's file ends in waypoints or one
sentence, photographs give their GPS."""

from __future__ import annotations

import gc
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pyproj import Transformer

from radiant_core.errors import BadInput
from radiant_core.io.photos.listing import list_photographs
from radiant_core.io.waypoints import reader as waypoints
from radiant_core.io.waypoints.reader import MAX_FILE_BYTES, exif_waypoints, read_waypoints

HAMLET = Path(__file__).parents[3] / "sample_scenes" / "hamlet" / "images"
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
        f"<Placemark><name>{name}</name><Point><coordinates>\n {lon},{lat},{alt} </coordinates></Point></Placemark>"
        for name, (_, lat, lon, alt) in zip(escaped, ROWS, strict=True)
    ]
    body = "".join(placemarks)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2"><Document>{body}</Document></kml>'


GOOD: dict[str, Callable[[], str]] = {".csv": csv_text, ".geojson": geojson_text, ".json": geojson_text, ".kml": kml_text}


def written(folder: Path, name: str, content: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def assert_rows(path: Path) -> None:
    found = read_waypoints(path)
    assert found.waypoints.names == tuple(name for name, *_ in ROWS)
    np.testing.assert_array_equal(found.waypoints.lat_lon_alt, [row[1:] for row in ROWS])
    assert found.warnings == ()


@pytest.mark.parametrize("suffix", GOOD)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_every_format_and_mark_gives_the_same_waypoints(tmp_path: Path, suffix: str, encoding: str) -> None:
    assert_rows(written(tmp_path, "a" + suffix.upper(), GOOD[suffix]().encode(encoding)))


@pytest.mark.parametrize("delimiter", [";", "\t"])
@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
def test_other_delimiters_and_line_ends(tmp_path: Path, delimiter: str, line_end: str) -> None:
    assert_rows(written(tmp_path, "a.csv", csv_text(delimiter).replace("\r\n", line_end)))


@pytest.mark.parametrize(
    "header",
    [
        "lat,lon,alt,id",
        "latitude,lng,altitude(m),name",
        "LAT , Long,ALT [m],Name",
        '"latitude (deg)",longitude_deg,alt_m,name,',
        "lat,lon,alt,name,id,heading(deg)",
    ],
)
def test_columns_are_found_by_their_names(tmp_path: Path, header: str) -> None:
    more = "," * (header.count(",") - 3)
    found = read_waypoints(written(tmp_path, "a.csv", f"{header}\n47.37,8.54,430,x{more}\n\n 47.38 ,8.54,,y{more}\n"))
    assert found.waypoints.names == ("x", "y")
    np.testing.assert_array_equal(found.waypoints.lat_lon_alt, [[47.37, 8.54, 430], [47.38, 8.54, 0]])
    assert "without altitude, 'y'" in found.warnings[0]


@pytest.mark.parametrize("header", ["AltitudeAMSL", "altitude_absolute(m)", "Altitude_AMSL [m]"])
def test_altitudes_above_the_sea_are_known_by_their_column(tmp_path: Path, header: str) -> None:
    waypoints = read_waypoints(written(tmp_path, "a.csv", f"lat,lon,{header},name\n47,8,430,a\n")).waypoints
    assert waypoints.absolute and waypoints.lat_lon_alt[0, 2] == 430
    both = read_waypoints(written(tmp_path, "b.csv", f"lat,lon,{header},name,altitude\n47,8,430,a,80\n")).waypoints
    assert not both.absolute and both.lat_lon_alt[0, 2] == 80


@pytest.mark.parametrize(("mode", "absolute"), [("absolute", True), ("relativeToGround", False), (None, False)])
def test_altitudes_above_the_sea_are_known_by_kmls_altitude_mode(tmp_path: Path, mode: str | None, absolute: bool) -> None:
    said = "" if mode is None else f"<altitudeMode>{mode}</altitudeMode>"
    text = placemark(f"<Point>{said}<coordinates>8,47,430</coordinates></Point>", "a")
    assert read_waypoints(written(tmp_path, "a.kml", text)).waypoints.absolute is absolute


def test_a_file_without_names_is_no_cause_for_a_warning(tmp_path: Path) -> None:
    found = read_waypoints(written(tmp_path, "a.csv", "latitude,longitude,altitude(m)\n47,8,80\n47.001,8,80\n"))
    assert found.warnings == () and found.waypoints.names == ("wp-1", "wp-2")
    (warning,) = read_waypoints(written(tmp_path, "b.csv", "lat,lon,name\n47,8,a\n47.001,8,\n")).warnings[1:]
    assert warning == "1 of 2 names are empty or come twice, '' first: they were numbered."


CSV_POISON = [
    ("name,lat,lon\na,nan,8\n", "not finite, 'a'"),
    ("name,lat,lon\na,47,1e400\n", "not finite, 'a'"),
    ("name,lat,lon\na,47\n", "line 2 has 2 cells, the header 3"),
    ("name,lat,lon\na,47,8,9\n", "line 2 has 4 cells"),
    ("name;lat;lon\na;47,37;8,54\n", "the latitude in line 2 is '47,37', no number: write decimals with a point"),
    ("name,lat,lon\na,47N,8\n", "'47N', no number"),
    ("name,lat,lon\na,4_7,8\n", "'4_7', no number"),
    ("name,lat,lon\na,,8\n", "the latitude in line 2 is ''"),
    ("name,lat,lon\n", "no waypoint"),
    ("47.3,8.5\n47.4,8.6\n", "names no latitude and no longitude"),
    ("name,latitude,x\na,1,2\n", "names no longitude"),
    ("lat,latitude,lon\n1,1,1\n", "2 columns for the latitude"),
    ("lat,lon,altitude(ft)\n1,1,1\n", "in feet"),
    ('lat,lon,name\n1,1,"open\n', "no line of CSV"),
    ("\nlat,lon\n1,1\n", "first line is empty"),
    ("lat,lon,name\n1,1," + "x" * 200_000 + "\n", "no line of CSV"),
    ("name,lat,lon\na,8.54,91\nb,8.54,91\n", "no"),
    ("name,lat,lon\nFuji,138.73,35.36\n", "probably swapped"),
    ("name,lat,lon\na\x07b,47,8\n", "control character"),
    (b"name,lat,lon\nZ\xfcrich,47,8\n", r"byte 14 is not UTF-8 text: save the file as UTF-8"),
    (b"\xff\xfel", "not UTF-16"),
    (b"", "is empty"),
    (b" \n", "is empty"),
]


@pytest.mark.parametrize(("content", "told"), [case for case in CSV_POISON if case[1] != "no"])
def test_a_wrong_csv_is_refused_in_one_sentence(tmp_path: Path, content: str | bytes, told: str) -> None:
    path = written(tmp_path, "a.csv", content)
    with pytest.raises(BadInput, match=told) as caught:
        read_waypoints(path)
    assert str(path) in str(caught.value)
    assert len(str(caught.value)) < 400 + len(str(path))


def test_a_waypoint_of_latitude_8_and_longitude_91_is_in_burma_and_right(tmp_path: Path) -> None:
    assert len(read_waypoints(written(tmp_path, "a.csv", "name,lat,lon,alt\na,8.54,91,3\n")).waypoints) == 1


def geometry(value: object, **properties: object) -> str:
    return json.dumps({"type": "Feature", "properties": properties or None, "geometry": value})


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


GEOJSON_POISON = [
    ("{", "not valid JSON"),
    ("[" * 100_000, "not valid JSON"),
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


@pytest.mark.parametrize(("content", "told"), GEOJSON_POISON)
def test_a_wrong_geojson_is_refused_in_one_sentence(tmp_path: Path, content: str, told: str) -> None:
    with pytest.raises(BadInput, match=told) as caught:
        read_waypoints(written(tmp_path, "a.geojson", content))
    assert "a.geojson" in str(caught.value)


def kml(body: str) -> str:
    return f"<kml>{body}</kml>"


def test_lines_and_nested_geometries_of_kml_are_read(tmp_path: Path) -> None:
    body = """<Document><Folder><Placemark><name> Route  1 </name><MultiGeometry>
      <LineString><coordinates>8.54,47.37,5 8.5401,47.37,6
      8.5402,47.37</coordinates></LineString><Point><coordinates>8.55,47.37</coordinates></Point></MultiGeometry></Placemark>
      <Placemark><Polygon><outerBoundaryIs><LinearRing><coordinates>1,2 3,4 5,6 1,2</coordinates></LinearRing>
      </outerBoundaryIs></Polygon></Placemark>
      </Folder></Document>"""
    found = read_waypoints(written(tmp_path, "a.kml", kml(body)))
    assert found.waypoints.names == ("Route 1-1", "Route 1-2", "Route 1-3", "Route 1")
    np.testing.assert_array_equal(found.waypoints.lat_lon_alt[:, 1], [8.54, 8.5401, 8.5402, 8.55])
    assert len(found.warnings) == 2
    assert "1 × Polygon ignored" in found.warnings[1]


def point(coordinates: str) -> str:
    return kml(f"<Placemark><name>p</name><Point><coordinates>{coordinates}</coordinates></Point></Placemark>")


LAUGHS = '<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;">]>' + point("8,47").replace("p</name>", "&b;</name>")
KML_POISON = [
    (LAUGHS, "declares a document type"),
    (LAUGHS.encode("utf-16"), "declares a document type"),
    ('<!DOCTYPE kml SYSTEM "file:///etc/passwd">' + point("8,47"), "declares a document type"),
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


@pytest.mark.parametrize(("content", "told"), KML_POISON)
def test_a_wrong_kml_is_refused_in_one_sentence(tmp_path: Path, content: str | bytes, told: str) -> None:
    with pytest.raises(BadInput, match=told) as caught:
        read_waypoints(written(tmp_path, "a.kml", content))
    assert "a.kml" in str(caught.value)


def test_kml_says_its_encoding_in_vain_once_it_is_decoded(tmp_path: Path) -> None:
    text = kml_text().replace('encoding="UTF-8"', "encoding='ISO-8859-1'")
    assert_rows(written(tmp_path, "a.kml", text))


def test_a_very_deep_kml_ends(tmp_path: Path) -> None:
    deep = "<a>" * 100_000 + "</a>" * 100_000
    with pytest.raises(BadInput, match="no waypoint"):
        read_waypoints(written(tmp_path, "a.kml", kml(deep)))


def test_what_is_no_waypoint_file_is_refused(tmp_path: Path) -> None:
    huge = tmp_path / "huge.csv"
    with huge.open("wb") as file:
        file.truncate(10**9)  # sparse: nothing is stored, and nothing is read
    os.mkfifo(tmp_path / "pipe.csv")
    cases = [
        (tmp_path / "none.csv", "No such file"),
        (written(tmp_path, "a.kmz", b"PK"), "unzip it"),
        (written(tmp_path, "a.txt", csv_text()), "must end in .csv"),
        (tmp_path / "pipe.csv", "not a file"),
        (huge, f"1000000000 bytes, expected at most {MAX_FILE_BYTES}"),
    ]
    (tmp_path / "folder.csv").mkdir()
    for path, told in [*cases, (tmp_path / "folder.csv", "Is a directory")]:
        with pytest.raises(BadInput, match=told):
            read_waypoints(path)


@pytest.mark.parametrize("suffix", [".csv", ".geojson", ".kml"])
def test_fifteen_hundred_mutations_of_each_format_raise_bad_input_only(tmp_path: Path, suffix: str) -> None:
    good = GOOD[suffix]().encode()
    pieces = b'\x00 \xff\xfe \xef\xbb\xbf " , \n < & - 1e999 NaN [ ] {} null <a> \xed\xa0\x80'.split(b" ")
    rng = np.random.default_rng(8)
    outcomes = {"read": 0, "refused": 0}
    for _ in range(1500):
        data = bytearray(good)
        for _ in range(rng.integers(1, 4)):
            at, cut = int(rng.integers(0, len(data) + 1)), int(rng.integers(0, 6))
            data[at : at + cut] = pieces[rng.integers(len(pieces))] if rng.random() < 0.5 else rng.bytes(int(rng.integers(0, 3)))
        if rng.random() < 0.1:
            data = data[: rng.integers(len(data))]
        path = written(tmp_path, "a" + suffix, bytes(data))
        said = refusal(path)
        assert said is None or "a" + suffix in said
        outcomes["read" if said is None else "refused"] += 1
    assert min(outcomes.values()) > 20, outcomes


def refusal(path: Path) -> str | None:
    """What is said against the file, None when it is taken; any other exception goes on."""
    try:
        assert np.isfinite(read_waypoints(path).waypoints.positions_m).all()
    except BadInput as error:
        return str(error)
    return None


def test_photographs_give_the_positions_that_decoding_them_gives() -> None:
    found = exif_waypoints(HAMLET)
    decoded = list_photographs(HAMLET).photographs
    assert found.waypoints.names == tuple(photo.name for photo in decoded)
    np.testing.assert_array_equal(found.waypoints.lat_lon_alt, [photo.lat_lon_alt for photo in decoded])
    assert found.warnings == found.without_gps == ()


def without_exif(path: Path, target: Path) -> None:
    """The photograph saved anew, its name at the end: files of the same bytes are copies of one."""
    import cv2

    image = cv2.imread(str(path))
    assert image is not None
    assert cv2.imwrite(str(target), image)
    target.write_bytes(target.read_bytes() + target.name.encode())


def test_photographs_without_gps_are_named_and_only_heads_are_read(tmp_path: Path) -> None:
    photos = sorted(HAMLET.iterdir())
    shutil.copy(photos[0], tmp_path / "a.jpg")
    # At one position: both were taken.
    (tmp_path / "b.jpg").write_bytes(photos[0].read_bytes() + b"another")
    for index in range(7):
        without_exif(photos[1], tmp_path / f"c{index}.jpg")
    # Cut behind its EXIF: not noticed, no pixel is decoded.
    (tmp_path / "d.JPG").write_bytes(photos[2].read_bytes()[:40_000])
    with (tmp_path / "d.JPG").open("ab") as file:
        file.truncate(10**9)
    (tmp_path / "notes.txt").write_text("x")
    seen: list[tuple[int, int]] = []
    found = exif_waypoints(tmp_path, lambda done, total: seen.append((done, total)))
    assert found.waypoints.names == ("a.jpg", "b.jpg", "d.JPG")
    assert found.without_gps == tuple(f"c{index}.jpg" for index in range(7))
    assert "7 of 10 photographs without GPS" in found.warnings[0]
    assert found.warnings[0].endswith("c0.jpg, c1.jpg, c2.jpg, c3.jpg, c4.jpg and 2 more.")
    assert seen[-1] == (10, 10)


def test_folders_without_a_position_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="does not exist"):
        exif_waypoints(tmp_path / "none")
    with pytest.raises(BadInput, match="no photographs"):
        exif_waypoints(tmp_path)
    without_exif(sorted(HAMLET.iterdir())[0], tmp_path / "a.jpg")
    with pytest.raises(BadInput, match="none of the 1 photographs"):
        exif_waypoints(tmp_path)


@pytest.mark.parametrize("latitude", ["lat", "latitude", "Latitude (°)", "lat [deg]", "latitude_degrees"])
@pytest.mark.parametrize("longitude", ["lon", "lng", "long", "longitude", "lon deg"])
def test_positions_have_these_names(tmp_path: Path, latitude: str, longitude: str) -> None:
    found = read_waypoints(written(tmp_path, "a.csv", f"{latitude},{longitude}\n47.5,8.5\n"))
    np.testing.assert_array_equal(found.waypoints.lat_lon_alt, [[47.5, 8.5, 0]])


@pytest.mark.parametrize(
    ("header", "row", "looks"),
    [
        *((f"{name},pitch", "90,-45", (90, -45)) for name in ("heading", "yaw", "Heading(deg)")),
        *((f"yaw,{name}", "90,-45", (90, -45)) for name in ("gimbalpitchangle", "gimbal_pitch", "gimbalpitch", "gimbal pitch", "pitch")),
        ("yaw,pitch,gimbalmode", "90,-45,0", (90, np.nan)),
        ("yaw,pitch,gimbalmode", "90,-45, 2", (90, -45)),
        ("yaw,pitch", "90,", (90, np.nan)),
        ("yaw,pitch", " ,-45", (np.nan, -45)),
        ("yaw", "90", (90, np.nan)),
        ("pitch", "-45", (np.nan, -45)),
        ("yaw,pitch", ",", None),
        ("roll", "3", None),
    ],
)
def test_where_the_camera_looks_has_these_names(tmp_path: Path, header: str, row: str, looks: tuple[float, float] | None) -> None:
    found = read_waypoints(written(tmp_path, "a.csv", f"lat,lon,altitude,{header}\n47.5,8.5,3,{row}\n"))
    if looks is None:
        assert found.waypoints.heading_pitch_deg is None
    else:
        np.testing.assert_array_equal(found.waypoints.heading_pitch_deg, [looks])


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("lat,lon,alt\n1,1,x\n", "the altitude in line 2 is 'x', no number: write degrees and metres as plain numbers"),
        ("lat,lon\n1,x\n", "the longitude in line 2 is 'x', no number"),
        ("lat,lon,yaw\n1,1,1\n1,1,x\n", "the heading in line 3 is 'x', no number"),
        ("lat,lon,pitch\n1,1,x\n", "the pitch in line 2 is 'x', no number"),
        ("lat,lon,name,name\n1,1,a,a\n", "its header has 2 columns for the name: leave one"),
        ("lat,lon,yaw,heading\n1,1,1,1\n", "its header has 2 columns for the heading"),
        ("lat,lon,Altitude [feet]\n1,1,1\n", r"its column 'altitude \[feet\]' is in feet"),
        ("lat,lon,alt_ft\n1,1,1\n", "its column 'alt_ft' is in feet"),
        (",".join(f"c{i}" for i in range(20)) + "\n", r"\(it has: c0, c1, c2, c3, c4, c5, c6, c7, c8, c9, c10, c11\)"),
        ("x" * 50 + ",lat\n", rf"names no longitude \(it has: {'x' * 40}, lat\)"),
        ('lat,"lon\n1,1\n', "its header is no line of CSV"),
        ('lat,lon\n1,1\n1,"1\n', "line 3 is no line of CSV"),
    ],
)
def test_what_is_wrong_with_a_table_is_told_with_its_place(tmp_path: Path, content: str, told: str) -> None:
    with pytest.raises(BadInput, match=told):
        read_waypoints(written(tmp_path, "a.csv", content))


def test_names_win_over_ids_in_a_table_and_columns_names_are_looked_at_up_to_64_characters(tmp_path: Path) -> None:
    found = read_waypoints(written(tmp_path, "a.csv", "id,lat,lon,name\n7,47.5,8.5,n\n"))
    assert found.waypoints.names == ("n",)
    header = "lat" + " " * 200 + "(deg),lon,x" + "y" * 63 + "\n"
    assert len(read_waypoints(written(tmp_path, "a.csv", header + "47.5,8.5,1\n")).waypoints) == 1


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


def placemark(body: str, name: str = "") -> str:
    return kml(f"<Placemark>{name and f'<name>{name}</name>'}{body}</Placemark>")


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


def test_a_file_of_the_largest_size_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path, "a.csv", csv_text())
    size = path.stat().st_size
    monkeypatch.setattr(waypoints, "MAX_FILE_BYTES", size)
    assert_rows(path)
    monkeypatch.setattr(waypoints, "MAX_FILE_BYTES", size - 1)
    with pytest.raises(BadInput, match=f"has {size} bytes, expected at most {size - 1}: split it into several flights"):
        read_waypoints(path)


def test_the_collector_of_cycles_is_left_as_it_was(tmp_path: Path) -> None:
    path = written(tmp_path, "a.csv", csv_text())
    bad = written(tmp_path, "b.csv", "x\n")
    try:
        for wanted in (True, False):
            (gc.enable if wanted else gc.disable)()
            assert_rows(path)
            assert gc.isenabled() is wanted
            with pytest.raises(BadInput):
                read_waypoints(bad)
            assert gc.isenabled() is wanted
    finally:
        gc.enable()


def test_up_to_five_photographs_without_gps_are_named(tmp_path: Path) -> None:
    photos = sorted(HAMLET.iterdir())
    shutil.copy(photos[0], tmp_path / "a.jpg")
    for index in range(5):
        without_exif(photos[1], tmp_path / f"c{index}.jpg")
    found = exif_waypoints(tmp_path)
    assert found.warnings == ("5 of 6 photographs without GPS in EXIF are not planned: c0.jpg, c1.jpg, c2.jpg, c3.jpg, c4.jpg.",)
