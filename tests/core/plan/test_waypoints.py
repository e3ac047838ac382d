"""Waypoints: what a surveyor's list may get wrong is named or mended, and positions in metres are
right everywhere on the globe."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from radiant_core.errors import BadInput
from radiant_core.frames import enu_from_geodetic
from radiant_core.plan.heights import height_codes
from radiant_core.plan.waypoints import Waypoints, clean_waypoints

HOME = (47.37, 8.54, 430.0)


def grid(count: int, middle: tuple[float, float, float] = HOME) -> np.ndarray:
    """About 10 m apart, row by row."""
    row, column = np.divmod(np.arange(count), 40)
    return np.array(middle) + np.stack([1e-4 * row, 1e-4 * column, 0.0 * row], axis=1)


def names(count: int) -> tuple[str, ...]:
    return tuple(f"wp {index}" for index in range(count))


def made(positions: Any) -> Waypoints:
    return Waypoints(names=names(len(positions)), lat_lon_alt=positions)


def test_the_origin_is_the_mean_and_metres_are_about_it() -> None:
    waypoints = made(grid(120))
    np.testing.assert_allclose(waypoints.origin, grid(120).mean(axis=0), atol=1e-9)
    np.testing.assert_array_equal(waypoints.positions_m, enu_from_geodetic(grid(120), waypoints.origin))
    # The ground bends by (200 m)² / 2R over the site.
    assert np.abs(waypoints.positions_m.mean(axis=0)).max() < 1e-3
    assert len(waypoints) == 120


@pytest.mark.parametrize("lon", [179.9995, -179.9995, 180.0])
def test_a_site_across_the_180th_meridian_is_one_site(lon: float) -> None:
    positions = grid(80, (-17.0, lon, 5.0))
    positions[:, 1] = (positions[:, 1] + 180) % 360 - 180
    here, elsewhere = made(positions), made(grid(80, (-17.0, 100.0, 5.0)))
    # Same latitudes and steps of longitude: the same metres; degrees of 180 round at 1.4e-14 · 1e5
    # m.
    np.testing.assert_allclose(here.positions_m, elsewhere.positions_m, atol=1e-6)
    assert abs(here.origin[1]) > 179.9


def test_selecting_keeps_names_and_positions_together() -> None:
    waypoints = made(grid(10))
    assert waypoints.select([7, 2]).names == ("wp 7", "wp 2")
    np.testing.assert_array_equal(waypoints.select(np.arange(10) >= 8).lat_lon_alt, grid(10)[8:])
    with pytest.raises(BadInput, match="no waypoint"):
        waypoints.select(np.zeros(10, bool))


@pytest.mark.parametrize(
    ("row", "told"),
    [
        ((np.nan, 8.54, 0), r"1 of 50 waypoints with a position that is not finite, 'wp 3' \(number 4\) first"),
        ((47.37, 8.54, np.inf), "not finite, 'wp 3'"),
        ((138.7, 35.4, 0), "'wp 3' .*latitude 138.7° .*probably swapped"),
        ((91, 181, 0), "off the globe, 'wp 3' .*map projection"),
        ((5_247_000, 465_000, 0), "off the globe, 'wp 3' .*map projection"),
        ((47.37, 181, 0), "off the globe, 'wp 3'"),
        ((8.54, 47.37, 430), "'wp 3' .*5,.* km: with its latitude and longitude exchanged it lies among the others"),
        ((-47.37, 8.54, 430), "'wp 3' .*9,.* km: check"),
        ((0, 0, 0), "300 km .*'wp 3'"),
        ((47.37, 8.54, 2e5), "altitude nobody flies at, 'wp 3' .*metres"),
        ((47.37, 8.54, -2e4), "altitude nobody flies at"),
    ],
)
def test_a_wrong_position_is_named_with_what_to_do(row: tuple[float, ...], told: str) -> None:
    positions = grid(50)
    positions[3] = row
    with pytest.raises(BadInput, match=told) as caught:
        made(positions)
    assert len(str(caught.value)) < 300


def test_several_wrong_positions_are_counted() -> None:
    positions = grid(50)
    positions[[9, 4, 30], 0] = np.nan
    with pytest.raises(BadInput, match=r"3 of 50 waypoints .*'wp 4' \(number 5\)"):
        made(positions)
    positions = grid(50)
    positions[20:] = positions[20:, [1, 0, 2]]
    with pytest.raises(BadInput, match=r"20 of 50 waypoints .*exchanged"):
        made(positions)  # the larger half is taken for right: which half is swapped nobody can tell


@pytest.mark.parametrize("positions", [np.zeros((2, 2)), np.zeros(3), [["a", 0, 0], [1, 1, 1]], [[0, 0, 0]], np.zeros((2, 3), complex)])
def test_what_is_no_list_of_positions_is_refused(positions: Any) -> None:
    with pytest.raises(BadInput):
        Waypoints(names=("a", "b"), lat_lon_alt=positions)


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        (("a", "a"), "'a' comes twice"),
        (("a", ""), "number 2 has no name"),
        (("a", "b\nc"), "control character"),
        (("a", "b\x00"), "control character"),
        (("a", "x" * 256), "256 characters"),
        (("a", "\ud800"), "half a character"),
        ((), "no waypoint"),
    ],
)
def test_names_that_no_file_could_hold_are_refused(wrong: tuple[str, ...], told: str) -> None:
    with pytest.raises(BadInput, match=told):
        Waypoints(names=wrong, lat_lon_alt=grid(len(wrong)))


def test_a_position_that_comes_twice_is_planned_once_and_said() -> None:
    positions = grid(6)
    positions[4] = positions[1] + [4e-9, 0, 4e-4]  # half a millimetre
    positions[5] = positions[1] + [0, 0, 0.002]
    waypoints, warnings = clean_waypoints(names(6), positions)
    assert waypoints.names == ("wp 0", "wp 1", "wp 2", "wp 3", "wp 5")
    assert warnings == ("1 of 6 waypoints at a position that came before, 'wp 4' (number 5) first: planned once.",)


def test_missing_altitudes_become_zero_and_are_said() -> None:
    waypoints, warnings = clean_waypoints(names(4), grid(4), height_codes(("takeoff", "unknown", "unknown", "takeoff")))
    assert waypoints.lat_lon_alt[:, 2].tolist() == [430, 0, 0, 430]
    np.testing.assert_array_equal(waypoints.heights_m, [430, np.nan, np.nan, 430])
    assert warnings == ("2 of 4 waypoints without altitude, 'wp 1' (number 2) first: the lists hold no height for them.",)


def test_altitude_hardly_moves_a_plan() -> None:
    high, low = grid(120, (47.37, 8.54, 6000.0)), grid(120, (47.37, 8.54, 0.0))
    extent_m = np.ptp(made(low).positions_m[:, :2], axis=0).max()
    assert np.abs(made(high).positions_m[:, :2] - made(low).positions_m[:, :2]).max() < 1e-3 * extent_m


def test_names_that_come_twice_or_are_missing_are_numbered() -> None:
    waypoints, warnings = clean_waypoints(("a", "a", "", "a-2", "", "a"), grid(6))
    assert waypoints.names == ("a", "a-3", "wp-1", "a-2", "wp-2", "a-4")
    assert len(warnings) == 1
    assert "4 of 6" in warnings[0]


@given(st.lists(st.sampled_from(["", "a", "a-2", "a-3", "wp-1", "b"]), min_size=1, max_size=30))
def test_numbered_names_are_always_unique_and_first_ones_stay(given_names: list[str]) -> None:
    waypoints, _ = clean_waypoints(given_names, grid(len(given_names)))
    assert len(set(waypoints.names)) == len(given_names)
    for index, name in enumerate(given_names):
        if name and name not in given_names[:index]:
            assert waypoints.names[index] == name


def test_a_hundred_thousand_equal_names_take_linear_time() -> None:
    start_s = time.process_time()
    waypoints, _ = clean_waypoints(["x"] * 100_000, grid(100_000))
    assert len(set(waypoints.names)) == 100_000
    # 0.4 s where it was measured; quadratic would be hours.
    assert time.process_time() - start_s < 10


@pytest.mark.parametrize(
    ("angles", "told"),
    [
        ([[720.0, 90.0], [-720.0, -90.0]], None),
        ([[np.nan, -45.0], [90.0, np.nan]], None),
        ([[0.0, -90.0], [721.0, 0.0]], "1 of 2 waypoints? .*'b'.* heading 721° and pitch 0°"),
        ([[0.0, -91.0], [0.0, 91.0]], "2 of 2 waypoints? .*'a'.* heading 0° and pitch -91°"),
        ([[np.inf, 0.0], [0.0, 0.0]], "'a' .* first with heading inf°"),
        ([[0.0, -np.inf], [0.0, 0.0]], "pitch -inf°"),
        ([[0.0, 0.0]], r"heading_pitch_deg has shape \(1, 2\), expected \(2, 2\)"),
    ],
)
def test_angles_are_headings_and_pitches_or_refused(angles: list[list[float]], told: str | None) -> None:
    def build() -> Waypoints:
        return Waypoints(names=("a", "b"), lat_lon_alt=[[47.0, 8.0, 400.0], [47.001, 8.0, 400.0]], heading_pitch_deg=angles)

    if told is None:
        np.testing.assert_array_equal(build().heading_pitch_deg, angles)
    else:
        with pytest.raises(BadInput, match=told):
            build()


@pytest.mark.parametrize(
    ("row", "told"),
    [
        ((90.0, 8.0, 0.0), None),
        ((-90.0, 8.0, 0.0), None),
        (
            (90.1, 8.0, 0.0),
            r"1 of 1 waypoints off the globe, 'a' \(number 1\) first with latitude 90\.1° and longitude 8°: latitude and longitude",
        ),
        ((47.0, 180.0, 0.0), None),
        ((47.0, -180.0, 0.0), None),
        ((47.0, 180.5, 0.0), r"longitude 180\.5°: give degrees in WGS84, not metres of a map projection"),
        ((181.0, 8.0, 0.0), "give degrees in WGS84"),
        ((180.0, 90.0, 0.0), "probably swapped"),
        ((180.0, 90.5, 0.0), "give degrees in WGS84"),
        ((47.0, 8.0, -12_000.0), None),
        (
            (47.0, 8.0, -12_001.0),
            "1 of 1 waypoints at an altitude nobody flies at, 'a' .number 1. first with -12001 m: give altitudes in metres",
        ),
        ((47.0, 8.0, 100_000.0), None),
        ((47.0, 8.0, 100_001.0), "first with 100001 m"),
    ],
)
def test_the_globe_and_the_sky_end_where_they_end(row: tuple[float, float, float], told: str | None) -> None:
    if told is None:
        assert len(Waypoints(names=("a",), lat_lon_alt=[row])) == 1
    else:
        with pytest.raises(BadInput, match=told):
            Waypoints(names=("a",), lat_lon_alt=[row])


def test_a_waypoint_300_km_from_the_middle_of_all_is_of_another_site() -> None:
    """A degree of latitude on the equator is 110.574 km: 2.71° are 299.7 km, 2.72° 300.8."""
    for lat, told in ((2.71, None), (2.72, "more than 300 km from the middle of all, 'c' .number 3. first with 301 km: check whether")):
        rows = [[0.0, 10.0, 0.0], [0.0, 10.0, 9.0], [lat, 10.0, 5000.0]]
        if told is None:
            assert len(Waypoints(names=("a", "b", "c"), lat_lon_alt=rows)) == 3
        else:
            with pytest.raises(BadInput, match=told):
                Waypoints(names=("a", "b", "c"), lat_lon_alt=rows)
    for row, told in (
        ([10.0, 0.0, 0.0], "with its latitude and longitude exchanged it lies among the others, so exchange them there"),
        ([10.0, 2.6, 0.0], "with its latitude and longitude exchanged it lies among the others"),
        ([10.0, 2.8, 0.0], "check whether its latitude and longitude are right and not swapped, or plan each site on its own"),
        ([10.0, 100.0, 0.0], "check whether its latitude"),
    ):
        with pytest.raises(
            BadInput, match=rf"1 of 3 waypoints more than 300 km from the middle of all, 'c' \(number 3\) first with [0-9,]+ km: {told}"
        ):
            Waypoints(names=("a", "b", "c"), lat_lon_alt=[[0.0, 10.0, 0.0], [0.0, 10.0, 9.0], row])
    polar = [[89.9, 10.0, 0.0], [89.9, 10.0, 0.0], [10.0, 90.0, 0.0]]
    with pytest.raises(BadInput, match=r"1 of 3 waypoints more than 300 km .* exchanged it lies among the others"):
        Waypoints(names=("a", "b", "c"), lat_lon_alt=polar)


def test_names_are_numbered_from_two_and_empty_ones_from_one() -> None:
    rows_named = ["a", "", "a", "a-2", "", "a", "wp-3", ""]
    spread = grid(8)
    waypoints, warnings = clean_waypoints(rows_named, spread)
    assert waypoints.names == ("a", "wp-1", "a-3", "a-2", "wp-2", "a-4", "wp-3", "wp-4")
    assert warnings == ("5 of 8 names are empty or come twice, '' first: they were numbered.",)
    assert clean_waypoints(["b", "b"], spread[:2])[1] == ("1 of 2 names are empty or come twice, 'b' first: they were numbered.",)
    assert clean_waypoints(["b", "c"], spread[:2])[1] == ()


@pytest.mark.parametrize(
    ("step", "same"),
    [
        ((0.4e-8, 0, 0), True),
        ((0.6e-8, 0, 0), False),
        ((0, 0.4e-8, 0), True),
        ((0, 0.6e-8, 0), False),
        ((0, 0, 4e-4), True),
        ((0, 0, 6e-4), False),
    ],
)
def test_two_positions_are_one_within_a_millimetre(step: tuple[float, float, float], same: bool) -> None:
    rows = np.array([[47.0, 8.0, 430.0], [47.0, 8.0, 430.0]]) + np.outer([0, 1], step)
    waypoints, warnings = clean_waypoints(["a", "b"], rows)
    assert len(waypoints) == (1 if same else 2) and bool(warnings) is same
    if same:
        assert warnings == ("1 of 2 waypoints at a position that came before, 'b' (number 2) first: planned once.",)


def test_no_altitude_is_0_and_said_and_the_first_of_each_spot_stays() -> None:
    rows = [[47.0, 8.0, 5.0], [47.001, 8.0, 7.0], [47.0, 8.0, 5.0], [47.001, 8.0, 7.0], [47.002, 8.0, 9.0]]
    waypoints, warnings = clean_waypoints(list("abcde"), rows, height_codes((*["takeoff"] * 4, "unknown")), np.arange(10.0).reshape(5, 2))
    assert waypoints.names == ("a", "b", "e") and waypoints.lat_lon_alt[2, 2] == 0
    np.testing.assert_array_equal(waypoints.heading_pitch_deg, [[0, 1], [2, 3], [8, 9]])
    assert warnings == (
        "1 of 5 waypoints without altitude, 'e' (number 5) first: the lists hold no height for them.",
        "2 of 5 waypoints at a position that came before, 'c' (number 3) first: planned once.",
    )


@pytest.mark.parametrize(
    ("rows_named", "told"),
    [
        (("a", ""), "waypoint number 2 has no name: give every waypoint one"),
        (("a", "b", "a"), "the waypoint name 'a' comes twice: give every waypoint its own"),
        (("n" * 255,), None),
        (("n" * 256,), f"the waypoint name '{'n' * 40}'… has 256 characters, expected at most 255"),
        (("a\x1f",), r"the waypoint name 'a\\x1f' holds a control character: rename it"),
        (("a\x7f",), "holds a control character"),
        (("a ", "é~"), None),
        ((), "there is no waypoint: give at least one"),
    ],
)
def test_limits_of_names(rows_named: tuple[str, ...], told: str | None) -> None:
    rows = grid(3)[: len(rows_named)]
    if told is None:
        assert Waypoints(names=rows_named, lat_lon_alt=rows).names == rows_named
    else:
        with pytest.raises(BadInput, match=told):
            Waypoints(names=rows_named, lat_lon_alt=rows)


@pytest.mark.parametrize(
    ("angles", "told"),
    [
        ((720.0, 90.0), None),
        ((-720.0, -90.0), None),
        ((np.nan, np.nan), None),
        (
            (720.5, 0.0),
            r"1 of 1 waypoints looking nowhere, 'a' \(number 1\) first with heading 720\.5° and pitch 0°: give headings from north",
        ),
        ((0.0, 90.5), r"heading 0° and pitch 90\.5°"),
        ((np.inf, 0.0), "heading inf°"),
    ],
)
def test_limits_of_angles(angles: tuple[float, float], told: str | None) -> None:
    if told is None:
        found = Waypoints(names=("a",), lat_lon_alt=grid(1), heading_pitch_deg=np.array([angles]))
        np.testing.assert_array_equal(found.heading_pitch_deg, [angles])
        assert found.heading_pitch_deg is not None and not found.heading_pitch_deg.flags.writeable
    else:
        with pytest.raises(BadInput, match=told):
            Waypoints(names=("a",), lat_lon_alt=grid(1), heading_pitch_deg=np.array([angles]))


def test_the_first_position_that_is_no_number_is_named() -> None:
    rows = grid(3)
    rows[1:, 2] = np.nan
    with pytest.raises(BadInput, match=r"2 of 3 waypoints with a position that is not finite, 'wp1' \(number 2\) first: give latitude"):
        Waypoints(names=("wp0", "wp1", "wp2"), lat_lon_alt=rows)


@pytest.mark.parametrize(
    ("lons", "mean"),
    [((179.5, -179.5), 180.0), ((-179.5, 179.5), -180.0), ((-179.9, 179.7), 179.9), ((10.0, 10.5), 10.25), ((180.0, 180.0), 180.0)],
)
def test_the_mean_longitude_is_counted_the_short_way_round(lons: tuple[float, float], mean: float) -> None:
    waypoints = Waypoints(names=("a", "b"), lat_lon_alt=[[1.0, lons[0], 2.0], [1.5, lons[1], 4.0]])
    lat, lon, alt = waypoints.origin
    assert (lat, alt) == (1.25, 3.0) and abs(lon) == pytest.approx(abs(mean)) and -180 <= lon <= 180
    assert abs(waypoints.positions_m[:, 0].sum()) < 20
