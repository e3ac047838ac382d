"""Lists of ground control while points are marked: read, edited, written, and read by `--gcp`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.frames import Frame, geodetic_from_enu
from radiant_core.georef.control_guess import guess_place, shares_of
from radiant_core.georef.control_list import ListedPoint, load_control_list, parse_control_list, world_places
from radiant_core.georef.control_points import ControlRequest, parse_control
from radiant_core.georef.crs import parse_crs

TABLE = (
    "EPSG:32632\n# from the total station\none, 465270.125, 5246384.5, 430.25\ntwo;465300;5246384;431;check\nthree\t465300\t5246420\t432\n"
)


def test_points_of_a_table_are_marked_and_read_by_gcp(tmp_path: Path) -> None:
    found = parse_control_list(TABLE, "points.csv")
    assert [point.name for point in found.points] == ["one", "two", "three"]
    assert [point.is_check for point in found.points] == [False, True, False]
    marked = found.marked("one", "a.jpg", (10.25, 20.5)).marked("one", "b.jpg", (1, 2)).marked("two", "a.jpg", (3, 4))
    marked = marked.marked("one", "b.jpg", (5.125, 6)).marked("three", "a.jpg", (1, 1)).unmarked("three", "a.jpg")
    marked.save(tmp_path / "gcp_list.txt")
    control = parse_control(ControlRequest(text=(tmp_path / "gcp_list.txt").read_text(), source="gcp_list.txt"))
    # A point without a mark is a comment: the adjustment does not know it.
    assert control.names == ("one", "two") and control.is_check.tolist() == [False, True]
    assert control.mark_images == ("a.jpg", "b.jpg", "a.jpg")
    np.testing.assert_allclose(control.mark_pixels, [[10.25, 20.5], [5.125, 6], [3, 4]], atol=0.005)  # written to a hundredth of a pixel
    again = load_control_list(tmp_path / "gcp_list.txt")
    assert {point.name: point for point in again.points} == {point.name: point for point in marked.points}
    assert again.text() == marked.text() == again.with_check("one", True).with_check("one", False).text()


def test_lines_of_odm_without_names_keep_theirs() -> None:
    found = parse_control_list("EPSG:32632\n1 2 3 4 5 a.jpg\n1 2 3 6 7 b.jpg\n4 5 6 7 8 a.jpg\n", "gcp_list.txt")
    assert [point.name for point in found.points] == ["gcp-1", "gcp-2"]
    # The list counts from the middle of the first pixel, which is at (0.5, 0.5) here.
    assert found.marks_of("gcp-1") == {"a.jpg": (4.5, 5.5), "b.jpg": (6.5, 7.5)}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is empty"),
        ("EPSG:32632\n", "has 0 points"),
        ("name,east,north,up\none 1 2 3\n", "first line"),
        ("EPSG:32632\none 1 2 x\n", "line 2.*is no point"),
        ("EPSG:32632\none 1 2 nan\n", "finite"),
        ("EPSG:32632\none 1 2 1e12\n", "below 1e9"),
        ("EPSG:32632\none 1 2 3 chek\n", "chek.*stands behind"),
        ("EPSG:32632\none 1 2 3\none 4 5 6\n", "already"),
        ("EPSG:32632\none 1 2\n", "line 2.*is no mark"),
        ("EPSG:32632\n1 2 3 4 5 a.jpg p\n1 2 9 4 5 b.jpg p\n", "two places"),
    ],
)
def test_what_is_no_list_is_refused_by_its_line(text: str, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        parse_control_list(text, "points.csv")


def test_a_mark_that_the_list_cannot_hold_is_refused() -> None:
    found = parse_control_list(TABLE, "points.csv")
    for point, photograph, pixel, said in (
        ("four", "a.jpg", (1, 2), "no point 'four'"),
        ("one", "a#1.jpg", (1, 2), "cannot hold"),
        ("one", "a  b.jpg", (1, 2), "cannot hold"),
        ("one", "a.jpg", (float("nan"), 2), "finite pixels"),
    ):
        with pytest.raises(BadInput, match=said):
            found.marked(point, photograph, pixel)
    with pytest.raises(BadInput, match="no name of a point"):
        ListedPoint("a\tb", (1, 2, 3))


def test_a_file_in_another_encoding_is_refused(tmp_path: Path) -> None:
    (tmp_path / "list.txt").write_bytes(b"EPSG:32632\nH\xf6he 1 2 3\n")
    with pytest.raises(BadInput, match="no text in UTF-8"):
        load_control_list(tmp_path / "list.txt")
    with pytest.raises(BadInput, match="there is no file"):
        load_control_list(tmp_path / "none.txt")


def three_cameras() -> Cameras:
    """Looking down from 60 m, 20 m apart."""
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, :3] = np.diag([1.0, -1.0, -1.0])
    centers = np.array([[-20.0, 0, 60], [0, 0, 60], [20, 0, 60]])
    poses[:, :3, 3] = -centers @ np.diag([1.0, -1.0, -1.0])
    K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    return Cameras(names=("a", "b", "c"), Ks=np.tile(K, (3, 1, 1)), cam_from_world=poses, sizes_wh=np.tile([640, 480], (3, 1)))


def test_rays_of_two_marks_meet_in_the_point_and_show_it_in_the_third() -> None:
    cameras, place = three_cameras(), np.array([3.0, -4.0, 2.0])
    shares = shares_of(cameras, place)
    # By hand: 500 px · 23 m / 58 m right of the middle, 500 · 4 / 58 below it.
    np.testing.assert_allclose(shares[0], [(320 + 500 * 23 / 58) / 640, (240 + 500 * 4 / 58) / 480], rtol=1e-12)
    nowhere = np.full(3, np.nan)
    np.testing.assert_allclose(guess_place(cameras, np.array([0, 2]), shares[[0, 2]], nowhere), place, atol=1e-9)
    assert np.isnan(guess_place(cameras, np.array([0]), shares[:1], nowhere)).all()
    # Two marks in one place of one photograph have no angle between their rays.
    np.testing.assert_array_equal(guess_place(cameras, np.array([1, 1]), shares[[1, 1]], place), place)


def test_cameras_that_do_not_see_a_place_say_so() -> None:
    cameras = three_cameras()
    assert np.isnan(shares_of(cameras, [0, 0, 61])).all(), "above the cameras"
    assert np.isnan(shares_of(cameras, [np.nan, 0, 0])).all()
    assert np.isfinite(shares_of(cameras, [45, 0, 0])[:, 0]).tolist() == [False, False, True]


def test_surveyed_places_are_those_of_the_scene() -> None:
    origin = np.array([47.367, 8.54, 430.0])
    found = parse_control_list(TABLE, "points.csv")
    places = world_places(found, Frame(kind="metric", origin_lat_lon_alt=origin))
    back = parse_crs("EPSG:32632").from_geodetic(geodetic_from_enu(places, origin))
    np.testing.assert_allclose(back, [point.place for point in found.points], atol=1e-6)
    assert np.isnan(world_places(found, Frame(kind="scaled", origin_lat_lon_alt=np.zeros(3)))).all()
    assert np.isnan(world_places(parse_control_list("LOCAL\none 1 2 3\n", "x"), Frame(kind="metric", origin_lat_lon_alt=origin))).all()
