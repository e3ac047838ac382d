"""A plan of positions says by which camera it counts, and takes that of photographs."""

from __future__ import annotations

from pathlib import Path

import pytest

from radiant_app.commands.plan.content import ContentRequest, content_request
from radiant_app.commands.plan.flight import CAMERA_OPTIONS, DroneText, FlightRequest, HeightOptions, flight_request
from radiant_app.commands.plan.optics import with_camera
from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_core.io.photos.jpeg import ExifFacts
from radiant_core.waypoints.reader import FoundWaypoints, PhotographedWith, _taken_with, exif_waypoints, read_waypoints

NOTHING = HeightOptions()
FLAT = ContentRequest(ground_m=430.0)


def flight(**camera: float) -> FlightRequest:
    return flight_request(None, None, NOTHING, DroneText(8.0, "20m", **camera))  # pyright: ignore[reportArgumentType]


@pytest.fixture
def listed(tmp_path: Path) -> FoundWaypoints:
    path = tmp_path / "flight.csv"
    path.write_text("name,latitude,longitude,altitude\na,47.37,8.54,480\nb,47.3702,8.54,480\n")
    return read_waypoints(path)


def test_photographs_say_their_camera() -> None:
    found = exif_waypoints(sample_scenes_folder() / "hamlet" / "images")
    content, plane, decision = with_camera(FLAT, flight(), found)
    # 24 mm of the diagonal of 36 x 24 mm, 43.27 mm; images of 320 x 240 px have one of 400 px.
    assert content.optics.field_of_view_deg == pytest.approx(71.6, abs=0.1) and content.optics == plane.drone.optics
    assert (plane.drone.image_width_px, content.optics.aspect) == (320, 0.75)
    assert decision.choice == "71.6° across images of 320 × 240 px" and "EXIF" in decision.reason and not decision.changes_nothing
    # What is typed wins.
    content, plane, decision = with_camera(FLAT, flight(field_of_view_deg=60.0, image_width_px=400, image_height_px=200), found)
    assert (content.optics.field_of_view_deg, plane.drone.image_width_px, plane.drone.optics.aspect) == (60.0, 400, 0.5)
    assert decision.forced and decision.reason == "as asked for"


def heads(*facts: tuple[tuple[int, int] | None, float | None, float]) -> list[ExifFacts]:
    return [ExifFacts(taken_wh=size_wh, focal_35mm=focal, digital_zoom=zoom) for size_wh, focal, zoom in facts]


def test_most_photographs_say_each_part_of_their_camera_by_itself() -> None:
    whole, no_focal, zoomed = ((320, 240), 24.0, 1.0), ((320, 240), None, 1.0), ((320, 240), 24.0, 2.0)
    assert _taken_with(heads(whole, no_focal)) == PhotographedWith(size_wh=(320, 240), field_of_view_deg=None)
    assert _taken_with(heads(whole, zoomed)) == PhotographedWith(size_wh=(320, 240), field_of_view_deg=None)
    most = _taken_with(heads(whole, whole, no_focal))
    assert most is not None and most.field_of_view_deg == pytest.approx(71.6, abs=0.1)
    # No camera has such a lens, or takes such a strip.
    assert _taken_with(heads(((320, 240), 65535.0, 1.0))) == PhotographedWith(size_wh=(320, 240), field_of_view_deg=None)
    assert _taken_with(heads(((9000, 600), 24.0, 1.0))) is None
    assert _taken_with(heads(whole, ((640, 480), 24.0, 1.0))) is None


@pytest.mark.parametrize(
    ("camera", "size_wh"),
    [({"image_width_px": 1152}, (1152, 864)), ({"image_height_px": 240}, (320, 240)), ({"field_of_view_deg": 60.0}, (320, 240))],
)
def test_one_size_that_is_typed_keeps_the_shape_of_photographs(camera: dict[str, float], size_wh: tuple[int, int]) -> None:
    found = exif_waypoints(sample_scenes_folder() / "hamlet" / "images")
    content, plane, decision = with_camera(FLAT, flight(**camera), found)
    assert (plane.drone.image_width_px, round(content.optics.aspect * plane.drone.image_width_px)) == size_wh
    assert decision.forced and decision.reason == "as asked for, and as EXIF of most photographs says"


def test_one_size_that_is_typed_alone_is_of_an_image_of_4_to_3(listed: FoundWaypoints) -> None:
    _, plane, decision = with_camera(FLAT, flight(image_height_px=240), listed)
    assert (plane.drone.image_width_px, plane.drone.optics.aspect) == (320, 0.75) and "assumed in part" in decision.reason


def test_an_assumed_camera_is_told_with_the_options_that_give_another(listed: FoundWaypoints) -> None:
    content, plane, decision = with_camera(FLAT, flight(), listed)
    assert decision.choice == "73.7° across images of 4,000 × 3,000 px" and not decision.changes_nothing
    assert decision.reason.startswith("assumed") and all(option in decision.reason for option in CAMERA_OPTIONS)
    # Without heights nothing is said of images.
    assert listed.waypoints.heights_m is not None or with_camera(ContentRequest(), flight(), listed)[2].changes_nothing
    _, _, part = with_camera(content_request(430.0, 80.0, None, None), flight(field_of_view_deg=80.0), listed)
    assert "80.0°" in part.choice and "--image-width-px" in part.reason and "--field-of-view" not in part.reason
    assert (content.optics.aspect, plane.drone.image_width_px) == (0.75, 4000)
