"""Tables of waypoints: which columns are found, and what is wrong with one is told with its place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.waypoints.reader import read_waypoints
from tests.core.io.waypoint_files import assert_rows, csv_text, written

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
    ("name,lat,lon\nFuji,138.73,35.36\n", "probably swapped"),
    ("name,lat,lon\na\x07b,47,8\n", "control character"),
    (b"name,lat,lon\nZ\xfcrich,47,8\n", r"byte 14 is not UTF-8 text: save the file as UTF-8"),
    (b"\xff\xfel", "not UTF-16"),
    (b"", "is empty"),
    (b" \n", "is empty"),
]


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


def test_a_file_without_names_is_no_cause_for_a_warning(tmp_path: Path) -> None:
    found = read_waypoints(written(tmp_path, "a.csv", "latitude,longitude,altitude(m)\n47,8,80\n47.001,8,80\n"))
    assert found.warnings == () and found.waypoints.names == ("wp-1", "wp-2")
    (warning,) = read_waypoints(written(tmp_path, "b.csv", "lat,lon,name\n47,8,a\n47.001,8,\n")).warnings[1:]
    assert warning == "1 of 2 names are empty or come twice, '' first: they were numbered."


@pytest.mark.parametrize(("content", "told"), CSV_POISON)
def test_a_wrong_csv_is_refused_in_one_sentence(tmp_path: Path, content: str | bytes, told: str) -> None:
    path = written(tmp_path, "a.csv", content)
    with pytest.raises(BadInput, match=told) as caught:
        read_waypoints(path)
    assert str(path) in str(caught.value)
    assert len(str(caught.value)) < 400 + len(str(path))


def test_a_waypoint_of_latitude_8_and_longitude_91_is_in_burma_and_right(tmp_path: Path) -> None:
    assert len(read_waypoints(written(tmp_path, "a.csv", "name,lat,lon,alt\na,8.54,91,3\n")).waypoints) == 1


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
