"""Lists of ground control that cannot place the photographs, or lie where their GPS is not: refused before matching."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.georef.control_points import ControlRequest
from radiant_core.io.photos.listing import CameraKey, Photograph
from radiant_core.map_projection import geodetic_from_utm
from radiant_core.sfm.control.before_matching import check_control
from radiant_core.sfm.world_frame.placement import Placement

EAST_NORTH = np.array([465287.8, 5246371.9])
SIZE_WH = (640, 480)
NAMES = tuple(f"{index}.jpg" for index in range(6))
CORNERS = ((0, 0), (40, 0), (0, 30), (40, 30))


def photographs(**changes: Any) -> tuple[Photograph, ...]:
    key = CameraKey(make="", model="", focal_mm=None, size_wh=SIZE_WH)
    lat, lon = geodetic_from_utm(EAST_NORTH[None], 32632)[0]
    photo = Photograph(name="", path=Path("x"), size_wh=SIZE_WH, lat_lon_alt=(lat, lon, 480.0), camera=key)
    return tuple(replace(photo, name=name, **changes) for name in NAMES)


def a_list(
    system: str = "EPSG:32632", each: int = 3, tail: str = "", pixel: str = "100 200", at: Any = None, corners: Any = CORNERS
) -> str:
    lines = [system]
    for number, corner in enumerate(corners):
        place = np.array([*(EAST_NORTH + corner), 430.0]) if at is None else at(corner)
        lines += [f"{place[0]:.7f} {place[1]:.7f} {place[2]} {pixel} {name} gcp-{number} {tail}" for name in NAMES[:each]]
    return "\n".join(lines)


def checked(text: str, photos: tuple[Photograph, ...], policy: Any = "stop") -> tuple[str, ...]:
    placement = Placement(control=ControlRequest(text=text, source="gcp_list.txt"), contradictions=policy)
    return check_control(placement, photos, {photo.name: photo.size_wh for photo in photos})


def test_a_list_that_fits_says_nothing() -> None:
    assert checked(a_list(), photographs()) == ()
    assert checked(a_list(), photographs(lat_lon_alt=None)) == ()
    assert check_control(Placement(), photographs(), {}) == ()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (a_list(tail="check"), "all 4 points are kept out for checking"),
        (a_list(each=1), r"0 of 4 points can place the scene \(4 in one photograph alone\)"),
        (a_list().replace(".jpg", ".png"), "it names '0.png', and here are '0.jpg'"),
        (a_list(corners=CORNERS[:2]), "2 of 2 points can place the scene"),
        (a_list(corners=((0, 0), (20, 15), (40, 30))), "lie on a line"),
        (
            a_list(pixel="1000 200"),
            "12 of 12 marks lie outside of their photographs, the first at 1000, 200 of 0.jpg, which is 640 × 480 px",
        ),
    ],
)
def test_a_list_that_can_place_nothing_is_refused(text: str, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        checked(text, photographs())


def test_all_points_may_be_checks_where_positions_of_known_accuracy_place_the_scene() -> None:
    assert checked(a_list(tail="check"), photographs(position_sigma_m=(0.02, 0.02, 0.04))) == ()


def lat_lon(corner: tuple[float, float]) -> np.ndarray:
    return np.array([*geodetic_from_utm((EAST_NORTH + corner)[None], 32632)[0], 430.0])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (a_list("EPSG:32732"), "10,041 km .* the hemisphere of the zone is wrong"),
        (a_list("WGS84 UTM 32S"), "the hemisphere of the zone is wrong"),
        (a_list("EPSG:32631"), "45[0-9] km .* one zone of 6° too far west"),
        (a_list("EPSG:32633"), "45[0-9] km .* one zone of 6° too far east"),
        (a_list("EPSG:4326", at=lat_lon), "latitude and longitude are exchanged"),
        (a_list("EPSG:4326", at=lambda corner: lat_lon(corner)[[1, 0, 2]] * (-1, 1, 1)), "sign of the longitude is wrong"),
    ],
)
def test_a_list_in_another_place_than_the_photographs_stops_and_says_why(text: str, said: str) -> None:
    """453 km: a zone is 6° of longitude, 6 · 111.3 km · cos 47.37°."""
    with pytest.raises(BadInput, match=rf"gcp_list.txt and the photographs' GPS contradict each other: .*{said}"):
        checked(text, photographs())
    (warning,) = checked(text, photographs(), "warn")
    assert warning.endswith("the list is taken.")


@pytest.mark.parametrize("shift_m", [0.0, 20.0, 150.0])
def test_what_gps_a_datum_or_a_long_view_may_be_off_by_does_not_stop_before_matching(shift_m: float) -> None:
    lat, lon, alt = photographs()[0].lat_lon_alt or (0.0, 0.0, 0.0)
    moved = photographs(lat_lon_alt=(lat + shift_m / 111_200, lon, alt + 110.0))
    assert checked(a_list(), moved) == ()
