"""A list of ground control against the GPS of the photographs that it has placed: what is noise, what is said, what stops, and why."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.frames import Frame, Sim3
from radiant_core.georef.control_points import ControlRequest
from radiant_core.io.photos.listing import Photograph
from radiant_core.sfm.control.against_gps import against_gps
from radiant_core.sfm.world_frame.contradictions import Contradiction, settle
from tests.core.sfm.test_world import ORIGIN, flight, grid, photographs_at

NOISE_M = 0.5
ZONE = "EPSG:32615"
"""UTM 15N, where the photographs are."""
METRIC = Frame(kind="metric", origin_lat_lon_alt=ORIGIN)
LOCAL = Frame(kind="scaled", origin_lat_lon_alt=np.zeros(3))
NOTHING = Sim3(scale=1.0, rotation=np.eye(3), translation=np.zeros(3))


def site(pitch_deg: float = 75.0) -> tuple[Cameras, tuple[Photograph, ...]]:
    """A flight of 40 photographs at 40 m with GPS, in the frame of `METRIC`."""
    rng = np.random.default_rng(11)
    positions_m = grid(rng, 40)
    cameras = flight(positions_m, rng, pitch_deg)
    return cameras, photographs_at(cameras.names, positions_m + rng.normal(scale=NOISE_M, size=(40, 3)))


def found(
    mistake: Sim3 = NOTHING, frame: Frame = METRIC, system: str = ZONE, photos: Any = None, pitch_deg: float = 75.0
) -> tuple[Contradiction, ...]:
    """What is found where a list with a mistake has moved the true cameras."""
    cameras, own = site(pitch_deg)
    moved = replace(cameras, cam_from_world=mistake.apply_to_poses(cameras.cam_from_world))
    request = ControlRequest(text=f"# list\n{system}\n465000 5200000 430 1 1 000.jpg p", source="gcp_list.txt")
    return against_gps(moved, frame, own if photos is None else photos, request)


def moved_by(east: float, north: float, up: float) -> Sim3:
    return replace(NOTHING, translation=np.array([east, north, up]))


def turned(degrees: float, axis: str = "z") -> Sim3:
    return replace(NOTHING, rotation=Rotation.from_euler(axis, degrees, degrees=True).as_matrix())


def the_only(contradictions: tuple[Contradiction, ...]) -> Contradiction:
    (only,) = contradictions
    return only


@pytest.mark.parametrize(
    "mistake",
    [NOTHING, moved_by(20, -15, 0), moved_by(0, 0, 107), moved_by(10, 0, -107), turned(6), turned(8, "x"), replace(NOTHING, scale=1.02)],
    ids=["none", "25 m", "a geoid above", "a geoid below", "6° of north", "8° of up", "2 % of scale"],
)
def test_what_gps_may_be_off_by_is_nothing_to_say(mistake: Sim3) -> None:
    assert found(mistake) == ()


@pytest.mark.parametrize("away_m", [(45.0, False), (150.0, False), (260.0, True), (1_200.0, True)])
def test_a_shift_beyond_any_receiver_is_said_and_beyond_any_datum_stops(away_m: tuple[float, bool]) -> None:
    only = the_only(found(moved_by(0.6 * away_m[0], -0.8 * away_m[0], 0)))
    assert only.is_gross == away_m[1] and "contradict each other: by the list the photographs were taken" in only.sentence
    figure = "1.2 km" if away_m[0] > 1000 else f"{away_m[0]:.0f} m"
    assert f"taken {figure} from where GPS has them (median)" in only.sentence
    # NAD27 moves places in Minnesota by 7 to 20 m, ED50 in Europe by 150 m, Tokyo by 450 m.
    assert ("another datum" in only.sentence) == (50 < away_m[0] <= 1500)


def test_a_list_in_the_next_zone_is_said_to_be() -> None:
    """457.9 km along the geodesic of WGS 84 (PROJ 9.5.1)."""
    only = the_only(found(frame=replace(METRIC, origin_lat_lon_alt=ORIGIN + np.array([0.0, 6.0, 0.0])), system="EPSG:32616"))
    assert only.is_gross and "458 km" in only.sentence and "the zone is one zone of 6° too far east" in only.sentence
    with pytest.raises(BadInput, match=r"458 km .* Correct the list's first line .*; with --contradictions warn the list is taken"):
        settle([only], "stop")
    assert settle([only], "warn")[0].endswith("; the list is taken.")


@pytest.mark.parametrize(
    ("rise_m", "side", "cause"),
    [
        (150.0, "above", "altitudes that count from take-off"),
        (-239.0, "below", "altitudes that count from take-off"),
        (240 / 0.3048 - 240, "above", "heights are in feet, taken for metres"),
        (240 * 0.3048 - 240, "below", "altitudes that count from take-off"),
        (260 * 0.3048 - 1260, "below", "altitudes that count from take-off"),
    ],
)
def test_heights_beyond_a_geoid_are_said_and_stop_nothing(rise_m: float, side: str, cause: str) -> None:
    only = the_only(found(moved_by(0, 0, rise_m)))
    assert not only.is_gross and f"puts the photographs {abs(rise_m):,.0f} m {side} their GPS altitudes" in only.sentence
    assert cause in only.sentence


@pytest.mark.parametrize("frame", [METRIC, LOCAL])
@pytest.mark.parametrize(
    ("times", "is_gross", "cause"),
    [
        (1 / 0.3048, True, "the coordinates are in feet"),
        (3937 / 1200, True, "in feet"),
        (100.0, True, ""),
        (1.1, False, ""),
        (0.9, False, ""),
    ],
)
def test_a_scale_that_gps_does_not_have_is_said(frame: Frame, times: float, is_gross: bool, cause: str) -> None:
    """A list in feet taken for metres makes a scene 3.28 times as large: its metre is 0.305 m."""
    only = the_only(
        tuple(each for each in found(replace(NOTHING, scale=times), frame, "LOCAL" if frame == LOCAL else ZONE) if "metre" in each.sentence)
    )
    assert only.is_gross == is_gross and cause in only.sentence and ("feet" in only.sentence) == bool(cause)
    figure = float(only.sentence.split("a metre of the list is ")[1].split(" m by GPS")[0])
    assert figure == pytest.approx(1 / times, rel=0.02)


@pytest.mark.parametrize("degrees", [(12.0, False), (-14.0, False), (25.0, True), (90.0, True), (180.0, True)])
def test_north_elsewhere_is_said_where_a_list_has_one(degrees: tuple[float, bool]) -> None:
    only = the_only(tuple(each for each in found(turned(degrees[0])) if "north" in each.sentence))
    assert only.is_gross == degrees[1] and f"north of the list is {abs(degrees[0]):.0f}° away" in only.sentence
    assert found(turned(degrees[0]), LOCAL, "LOCAL") == (), "a site of its own has a north of its own"


def test_up_elsewhere_is_said_and_upside_down_stops() -> None:
    leaning = [each for each in found(turned(30.0, "x")) if "puts up" in each.sentence]
    assert "30° away" in the_only(tuple(leaning)).sentence and not leaning[0].is_gross
    for frame, system in ((METRIC, ZONE), (LOCAL, "LOCAL")):
        over = [each for each in found(turned(180.0, "x"), frame, system) if each.is_gross]
        assert "turns the scene upside down" in over[0].sentence and "heights have the wrong sign" in over[0].sentence


@pytest.mark.parametrize("pitch_deg", [0.0, 30.0, 75.0, 90.0])
def test_upside_down_shows_without_gps_for_photographs_that_look_ahead_or_down(pitch_deg: float) -> None:
    nowhere = photographs_at(site()[0].names, None)
    assert found(photos=nowhere, pitch_deg=pitch_deg) == ()
    only = the_only(found(turned(180.0, "x"), photos=nowhere, pitch_deg=pitch_deg))
    assert only.is_gross and "unless the photographs do look up" in only.remedy


def told_at(change: Any) -> tuple[Photograph, ...]:
    """Photographs with the GPS that `change` makes of true positions (40,3)."""
    cameras, _ = site()
    rng = np.random.default_rng(5)
    return photographs_at(cameras.names, change(cameras.centers.copy()) + rng.normal(scale=NOISE_M, size=(40, 3)))


def test_altitudes_that_drift_are_not_held_against_a_list() -> None:
    """As in caliterra's photographs, whose altitudes would tilt the scene by 43° and stretch it by a fifth."""
    drifting = told_at(lambda at: at + np.column_stack([np.zeros((40, 2)), 0.9 * at[:, 0]]))
    assert found(photos=drifting) == () == found(frame=LOCAL, system="LOCAL", photos=drifting)
    only = the_only(found(replace(NOTHING, scale=1 / 0.3048), LOCAL, "LOCAL", drifting))
    assert only.is_gross and "in feet" in only.sentence, "its plane still has a scale"


def test_a_few_that_are_far_off_and_positions_on_a_line_say_nothing_wrong() -> None:
    def strays(at: np.ndarray) -> np.ndarray:
        at[:8] += (4_000.0, 900.0, 0.0)
        return at

    assert found(photos=told_at(strays)) == ()
    line = told_at(lambda at: np.where(np.arange(40)[:, None] < 3, at, np.nan))
    assert found(photos=line) == (), "three fit any similarity"
    assert the_only(found(moved_by(300, 0, 0), photos=line)).is_gross


def test_positions_of_known_accuracy_are_held_to_it() -> None:
    rtk = tuple(replace(photo, position_sigma_m=(0.03, 0.03, 0.05)) for photo in site()[1])
    assert found(moved_by(3, 0, 0), photos=rtk) == ()
    only = the_only(found(moved_by(8, 0, 0), photos=rtk))
    assert not only.is_gross and "8 m from where GPS has them" in only.sentence


def test_photographs_without_altitude_are_compared_on_the_map() -> None:
    flat = tuple(replace(photo, lat_lon_alt=(*photo.lat_lon_alt[:2], np.nan)) for photo in site()[1] if photo.lat_lon_alt is not None)
    assert found(photos=flat) == () == found(moved_by(0, 0, 500), photos=flat)
    assert "45 m from where GPS has them" in the_only(found(moved_by(45, 0, 500), photos=flat)).sentence
