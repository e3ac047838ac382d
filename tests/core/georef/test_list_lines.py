"""Lists of marks as people bring them: separators, names with blanks, decimal commas, pixels; and what may mean two things."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.georef.control_list import MAX_POINTS, ControlList, ListedPoint, load_control_list, parse_control_list
from radiant_core.georef.control_points import ControlPoints, ControlRequest, control_request, match_names, parse_control
from radiant_core.georef.crs import parse_crs

SYSTEM = "EPSG:32632"
PLAIN = (
    "465287.8261 5246371.9555 427.6328 186.32 63.83 drone_0003.jpg gcp-1",
    "465287.8261 5246371.9555 427.6328 186.02 103.58 drone_0004.jpg gcp-1",
    "465254.1582 5246392.1301 430.6156 38.48 150.79 drone_0003.jpg gcp-2 check",
)


def parsed(*lines: str, header: str = SYSTEM, photographs: tuple[str, ...] = ()) -> ControlPoints:
    return parse_control(ControlRequest(text="\n".join([header, *lines]), source="gcp_list.txt"), photographs)


def same(control: ControlPoints, other: ControlPoints) -> bool:
    arrays = ("places_m", "mark_points", "mark_pixels", "is_check")
    alike = all(np.array_equal(getattr(control, name), getattr(other, name)) for name in arrays)
    return alike and (control.names, control.mark_images) == (other.names, other.mark_images)


def separated(sign: str, line: str) -> str:
    return sign.join(line.split())


@pytest.mark.parametrize(
    "lines",
    [
        [separated("\t", line) for line in PLAIN],
        [separated("\t\t", line) for line in PLAIN],
        [separated(";", line) for line in PLAIN],
        [separated(",", line) for line in PLAIN],
        [separated(", ", line) for line in PLAIN],
        [separated(",", line) + ",," for line in PLAIN],
        [f'"{line.split()[0]}",' + separated(",", line).partition(",")[2] for line in PLAIN],
        [line.replace(".", ",", 5).replace("drone_0003,", "drone_0003.") for line in PLAIN],
        [separated(";", line).replace(".", ",", 5) for line in PLAIN],
        [separated("\t", line).replace(".", ",", 5) for line in PLAIN],
        [*PLAIN[:1], "", "# a note", f"{PLAIN[1]} # seen well", PLAIN[2]],
        ["geo_x geo_y geo_z im_x im_y image_name gcp_name", *PLAIN],
        ["Easting,Northing,Height,Column,Row,Image,Name", *(separated(",", line) for line in PLAIN)],
        [f"  {line}  " for line in PLAIN],
        [f"{line} 0.02 0.03" if "check" not in line else line for line in PLAIN],
        [f"{line}\r" for line in PLAIN],
    ],
)
def test_the_shapes_of_a_list_are_one_list(lines: list[str]) -> None:
    assert same(parsed(*lines), parsed(*PLAIN))


@pytest.mark.parametrize(
    "header",
    [
        "epsg:32632", "EPSG: 32632", "EPSG:32632,,,,,", "EPSG:32632;", "WGS84 UTM 32N", "wgs84 utm 32n", "WGS 84 / UTM zone 32N",
        "WGS84  UTM  32 N", "+proj=utm +zone=32 +datum=WGS84 +units=m +no_defs", "'+proj=utm +zone=32 +north +ellps=WGS84 +no_defs=True'",
    ],
)  # fmt: skip
def test_the_systems_of_lists_are_one_system(header: str) -> None:
    control = parsed(*PLAIN, header=header)
    assert control.system == SYSTEM and same(control, parsed(*PLAIN))


def test_a_list_of_opensfm_is_in_longitude_and_latitude() -> None:
    # Its documentation, doc/source/gcp.rst (commit 379962a4): WGS84 on the first line, geo_x is the longitude.
    control = parsed("13.400740745 52.519134104 12.0792090446 2335.0 1416.7 01.jpg", header="WGS84")
    assert control.origin_lat_lon_alt is not None
    np.testing.assert_allclose(control.origin_lat_lon_alt, [52.519134104, 13.400740745, 12.0792090446])


@pytest.mark.parametrize(
    ("listed", "here"),
    [
        # OpenSfM's documentation, doc/source/geometry.rst (commit 054a1d81), "Pixel Coordinates": the origin is the middle of the
        # upper left pixel and that of the lower right is (w − 1, h − 1); COLMAP's, as here, are (0.5, 0.5), (w − 0.5, h − 0.5).
        ((0.0, 0.0), (0.5, 0.5)),
        ((319.0, 239.0), (319.5, 239.5)),
        ((-0.5, -0.5), (0.0, 0.0)),
        ((186.32, 63.83), (186.82, 64.33)),
    ],
)
def test_pixels_of_a_list_count_from_the_middle_of_the_first_one(
    listed: tuple[float, float], here: tuple[float, float], tmp_path: Path
) -> None:
    line = f"465287.8 5246371.9 427.6 {listed[0]:.2f} {listed[1]:.2f} a.jpg one"
    np.testing.assert_allclose(parsed(line).mark_pixels, [here], atol=1e-9)
    marked = parse_control_list(f"{SYSTEM}\none 465287.8 5246371.9 427.6", "points.txt").marked("one", "a.jpg", here)
    marked.save(tmp_path / "gcp_list.txt")
    assert (tmp_path / "gcp_list.txt").read_text().splitlines()[1].split()[3:5] == [f"{listed[0]:.2f}", f"{listed[1]:.2f}"]
    assert load_control_list(tmp_path / "gcp_list.txt").marks_of("one")["a.jpg"] == pytest.approx(here)


@pytest.mark.parametrize("sign", ["\t", ";", ",", " "])
@pytest.mark.parametrize("photograph", ["2026-09-26 15 drone_0003.jpg", "a b.TIF", "Flug 1/DJI 7.JPEG", "x.jpg copy.png", "IMG#1.jpg"])
def test_photographs_with_blanks_in_their_names(sign: str, photograph: str) -> None:
    line = sign.join(["465287.8261", "5246371.9555", "427.6328", "1", "2", photograph, "gcp-1", "check"])
    control = parsed(line, photographs=(photograph, "x.jpg"))
    assert control.mark_images == (photograph,) and control.names == ("gcp-1",) and control.is_check.all()
    if photograph != "x.jpg copy.png":
        assert parsed(line).mark_images == (photograph,), "by its suffix, where no photographs are known"


def test_a_name_without_a_suffix_is_the_longest_that_is_known() -> None:
    line = "465287.8261 5246371.9555 427.6328 1 2 roof north side gcp-1"
    assert parsed(line, photographs=("roof", "roof north", "roof north side")).mark_images == ("roof north side",)
    assert parsed(line, photographs=("roof north side gcp-1",)).mark_images == ("roof north side gcp-1",)


@pytest.mark.parametrize("sign", ["\t", " "])
def test_names_of_points_with_blanks(sign: str) -> None:
    lines = [line.replace("gcp-", "GCP ").replace(" check", "") for line in PLAIN]
    if sign == "\t":
        lines = ["\t".join([*line.split()[:6], " ".join(line.split()[6:])]) for line in lines]
    assert parsed(*lines).names == ("GCP 1", "GCP 2")


def test_a_hash_within_a_name_is_no_comment() -> None:
    assert parsed(PLAIN[0].replace("gcp-1", "GCP#1")).names == ("GCP#1",)


@pytest.mark.parametrize(
    ("listed", "photograph"),
    [
        ("images/a.JPG", "a.JPG"),
        ("C:\\flight\\a.JPG", "a.JPG"),
        ("A.jpg", "a.JPG"),
        ("images/A.jpg", "a.JPG"),
        ("100MEDIA\\a.JPG", "100MEDIA/a.JPG"),
    ],
)
def test_photographs_are_found_without_folder_and_letters_where_one_fits(listed: str, photograph: str) -> None:
    control = parsed(f"465287.8 5246371.9 427.6 1 2 {listed} one", photographs=(photograph, "b.JPG"))
    assert control.mark_images == (photograph,)
    (warning,) = control.warnings
    assert repr(listed) in warning and repr(photograph) in warning


def test_names_that_fit_two_photographs_stay() -> None:
    assert match_names(["a.jpg"], ["north/a.jpg", "south/a.jpg"]) == {"a.jpg": "a.jpg"}
    assert match_names(["A.JPG"], ["a.jpg", "a.JPG"]) == {"A.JPG": "A.JPG"}
    assert match_names(["north/a.jpg", "south/a.jpg"], ["a.jpg"]) == {"north/a.jpg": "north/a.jpg", "south/a.jpg": "south/a.jpg"}


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (["465287 5246371 430,111 1 2 a.jpg p"], "line 2: '430,111' has a comma that may part thousands or decimals"),
        (["465,287.82 5246371 430 1 2 a.jpg p"], "'465,287.82' has a comma"),
        (["465.287,82;5.246.371,95;430,1;1;2;a.jpg"], "has a comma"),
        (["lat lon alt x y image", *PLAIN], "line 2: the columns are 'lat lon alt x y image', expected: east north"),
        (["465_287 5246371 430 1 2 a.jpg p"], "is no mark"),
        ([PLAIN[0], PLAIN[0].replace("186.32", "190.00")], "'gcp-1' has two marks in 'drone_0003.jpg'"),
        (["465287.8 5246371.9 inf 1 2 a.jpg p"], "not finite"),
        # OpenSfM (docs/source/gcp.rst) and OpenDroneMap take NaN for a height that is not known.
        (["465287.8 5246371.9 NaN 1 2 a.jpg p"], "line 2: the point has no height (NaN)"),
        (["465287.8 9980123.0 430 1 2 a.jpg p"], "one of zone 32S, the other hemisphere"),
    ],
)
def test_what_may_mean_two_things_is_refused(lines: list[str], said: str) -> None:
    with pytest.raises(BadInput) as error:
        parsed(*lines)
    assert said in str(error.value)


@pytest.mark.parametrize("header", ["+proj=utm +zone=18 +datum=WGS84 +units=us-ft", "+proj=utm +zone=18 +datum=WGS84 +units=km +no_defs"])
def test_a_zone_in_another_unit_is_not_our_own(header: str) -> None:
    assert not parse_crs(header).is_builtin


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le"])
def test_a_list_is_read_in_the_encodings_of_tables(encoding: str, tmp_path: Path) -> None:
    text = "\r\n".join([SYSTEM, *PLAIN])
    mark = b"\xff\xfe" if encoding == "utf-16-le" else b""
    (tmp_path / "gcp_list.txt").write_bytes(mark + text.encode(encoding))
    assert same(parse_control(control_request(tmp_path / "gcp_list.txt", None, None)), parsed(*PLAIN))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{\n  "points": []\n}\n', "is JSON, such as OpenSfM's ground_control_points.json, which is not read: write gcp_list.txt"),
        ('<?xml version="1.0"?><document/>', "is XML, such as Metashape's markers"),
    ],
)
def test_lists_of_other_programs_are_named(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "points").write_text(text)
    for read in (lambda path: control_request(path, None, None), load_control_list):
        with pytest.raises(BadInput, match=said):
            read(tmp_path / "points")


def test_marks_in_photographs_with_blanks_are_kept(tmp_path: Path) -> None:
    listed = parse_control_list(f"{SYSTEM}\nGCP 1\t465287.5\t5246371.25\t427.75\ntwo 465290.0 5246371.0 428.0", "points.txt")
    marked = listed.marked("GCP 1", "my photo.jpg", (10.5, 20.5)).marked("two", "b.jpg", (1.5, 2.5))
    marked.save(tmp_path / "gcp_list.txt")
    assert load_control_list(tmp_path / "gcp_list.txt") == marked
    control = parse_control(ControlRequest(text=(tmp_path / "gcp_list.txt").read_text(), source="gcp_list.txt"))
    assert control.mark_images == ("my photo.jpg", "b.jpg") and control.names == ("GCP 1", "two")


def test_many_points_are_read_in_time_that_grows_with_them() -> None:
    lines = [f"p{row} {465000 + row * 0.1:.1f} 5246384 430" for row in range(60_000)]
    started = time.process_time()
    with pytest.raises(BadInput, match="60000 points, expected 1 to 10,000"):
        parse_control_list("\n".join([SYSTEM, *lines]), "points.txt")
    # 10 s: quadratic, 40 s and more of computing time; now 1 s.
    assert time.process_time() - started < 10
    full = parse_control_list("\n".join([SYSTEM, *lines[:MAX_POINTS]]), "points.txt")
    with pytest.raises(BadInput, match="the most that it may have"):
        full.with_point(ListedPoint("more", (465000.0, 5246384.0, 430.0)))


def test_a_list_of_many_marks_is_written_in_time_that_grows_with_them() -> None:
    points = tuple(ListedPoint(f"p{row}", (465000.0 + row, 5246384.0, 430.0)) for row in range(5_000))
    marks = {(point.name, f"{photo}.jpg"): (1.5, 2.5) for point in points for photo in range(4)}
    started = time.process_time()
    text = ControlList(system=SYSTEM, points=points, marks=marks).text()
    assert time.process_time() - started < 5 and text.count("\n") == 20_001  # 5 s: each point looked at all marks, 10 s
