"""Lists of ground control: OpenDroneMap's form, sites without a place, points kept out, and what is refused by its line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.frames import geodetic_from_enu
from radiant_core.georef.control_points import ControlRequest, control_request, parse_control
from radiant_core.georef.crs import parse_crs

LINES = (
    "465270.0 5246384.0 430.0 10 20 a.jpg one",
    "465270.0 5246384.0 430.0 11 21 b.jpg one",
    "465300.0 5246384.0 431.0 12 22 a.jpg two check",
    "465300.0 5246420.0 432.0 13 23 b.jpg three",
)


def parsed(*lines: str, header: str = "EPSG:32632", check: str = ""):
    return parse_control(ControlRequest(text="\n".join([header, *lines]), source="gcp_list.txt", check=check))


def test_points_come_back_in_the_lists_own_system() -> None:
    control = parsed(*LINES)
    assert control.names == ("one", "two", "three") and control.mark_points.tolist() == [0, 0, 1, 2]
    assert control.mark_images == ("a.jpg", "b.jpg", "a.jpg", "b.jpg")
    assert control.is_check.tolist() == [False, True, False]
    assert control.origin_lat_lon_alt is not None
    places = parse_crs("EPSG:32632").from_geodetic(geodetic_from_enu(control.places_m, control.origin_lat_lon_alt))
    expected = [[465270, 5246384, 430], [465300, 5246384, 431], [465300, 5246420, 432]]
    np.testing.assert_allclose(places, expected, atol=1e-6)


def test_lines_without_a_name_are_one_point_where_their_place_is() -> None:
    control = parsed(*(" ".join(line.split()[:6]) for line in LINES), "# a note", "")
    assert control.names == ("gcp-1", "gcp-2", "gcp-3") and control.mark_points.tolist() == [0, 0, 1, 2]


def test_a_local_site_keeps_its_numbers() -> None:
    control = parsed("0 0 0 1 2 a.jpg p", "10 0 0 3 4 a.jpg q", header="local")
    assert control.origin_lat_lon_alt is None and control.places_m.tolist() == [[0, 0, 0], [10, 0, 0]]


def test_points_are_kept_out_by_name_and_by_number() -> None:
    assert parsed(*LINES, check="one, three").is_check.tolist() == [True, True, True]
    assert parsed(*LINES, check="every:3").is_check.tolist() == [False, True, True]


@pytest.mark.parametrize(
    ("lines", "header", "check", "said"),
    [
        ((), "EPSG:32632", "", "has no points"),
        (LINES, "Mars", "", "first line.*LOCAL is a site"),
        ((*LINES, "1 2 3"), "EPSG:32632", "", "line 6.*is no mark"),
        (("nan 1 2 3 4 a.jpg",), "EPSG:32632", "", "not finite"),
        (("1 2 x 3 4 a.jpg",), "EPSG:32632", "", "is no mark"),
        ((LINES[0], LINES[2].replace("two", "one")), "EPSG:32632", "", "'one' has two places"),
        (("47.37 8.54 430 1 2 a.jpg p",), "EPSG:32632", "", "no UTM zone has"),
        (("1e6 0 0 1 2 a.jpg p",), "LOCAL", "", "subtract"),
        (LINES, "EPSG:32632", "four", "'four', which is no point"),
        (LINES, "EPSG:32632", "every:1", "keeps out all"),
    ],
)
def test_what_is_no_list_is_refused_by_its_line(lines: tuple[str, ...], header: str, check: str, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        parsed(*lines, header=header, check=check)


def test_a_file_is_read_with_its_accuracy(tmp_path: Path) -> None:
    path = tmp_path / "gcp_list.txt"
    path.write_text("\n".join(["EPSG:32632", *LINES]))
    request = control_request(path, "0.01,0.03", None)
    assert (request.horizontal_m, request.vertical_m) == (0.01, 0.03)
    assert control_request(path, None, None).vertical_m == 0.02
    for accuracy in ("0", "-1", "a", "1,2,3", "nan", "inf"):
        with pytest.raises(BadInput, match="--gcp-accuracy"):
            control_request(path, accuracy, None)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(BadInput, match="no text"):
        control_request(path, None, None)
    with pytest.raises(BadInput, match="there is no file"):
        control_request(tmp_path / "nothing.txt", None, None)
