"""Readers of waypoints: the three formats say the same, a stranger's file ends in waypoints or one sentence, photographs give their GPS."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.io.photos import list_photographs
from radiant_core.io.waypoints import MAX_FILE_BYTES, exif_waypoints, read_waypoints

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
    ('{"type": "Point", "coordinates": [8, 47], "crs": {"type": "name", "properties": {"name": "EPSG:2056"}}}', "EPSG:2056"),
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
    import cv2

    image = cv2.imread(str(path))
    assert image is not None
    assert cv2.imwrite(str(target), image)


def test_photographs_without_gps_are_named_and_only_heads_are_read(tmp_path: Path) -> None:
    photos = sorted(HAMLET.iterdir())
    shutil.copy(photos[0], tmp_path / "a.jpg")
    shutil.copy(photos[0], tmp_path / "b.jpg")  # at one position: both were taken
    for index in range(7):
        without_exif(photos[1], tmp_path / f"c{index}.jpg")
    (tmp_path / "d.JPG").write_bytes(photos[2].read_bytes()[:40_000])  # cut behind its EXIF: not noticed, no pixel is decoded
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
