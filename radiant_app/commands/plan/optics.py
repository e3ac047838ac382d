"""The camera that a plan before capture counts with: as typed, else as its photographs' EXIF says,
else assumed. Footprints, overlaps and the ground sampling distance follow from it. Once per plan.
"""

from __future__ import annotations

from dataclasses import replace

from radiant_app.commands.plan.content import ContentRequest
from radiant_app.commands.plan.flight import CAMERA_OPTIONS, FlightRequest
from radiant_core.decisions import Decision
from radiant_core.plan.borders.footprints import Optics
from radiant_core.waypoints.reader import FoundWaypoints, PhotographedWith

ANGLE_OPTION, WIDTH_OPTION, HEIGHT_OPTION = CAMERA_OPTIONS


def with_camera(content: ContentRequest, flight: FlightRequest, source: FoundWaypoints) -> tuple[ContentRequest, FlightRequest, Decision]:
    """Both requests with the camera of the photographs where none was typed, and what it is."""
    typed, taken, drone = flight.typed_camera, source.taken_with, flight.drone
    by_exif = _said_by(taken) - typed
    assumed = set(CAMERA_OPTIONS) - typed - by_exif
    width_px, height_px = _size_of(flight, None if taken is None else taken.size_wh)
    angle_deg = drone.optics.field_of_view_deg
    if taken is not None and taken.field_of_view_deg is not None and ANGLE_OPTION in by_exif:
        angle_deg = taken.field_of_view_deg
    optics = Optics(field_of_view_deg=angle_deg, aspect=height_px / width_px)
    known = "as asked for" if typed else "EXIF of most photographs says so"
    if typed and by_exif:
        known = "as asked for, and as EXIF of most photographs says"
    in_part = "" if assumed == set(CAMERA_OPTIONS) else " in part"
    decision = Decision(
        stage="plan",
        topic="camera",
        choice=f"{angle_deg:.1f}° across images of {width_px:,} × {height_px:,} px",
        figure=angle_deg,
        unit="°",
        reason=f"assumed{in_part}, unless you give {', '.join(sorted(assumed))}" if assumed else known,
        otherwise=", ".join(CAMERA_OPTIONS),
        forced=bool(typed),
        changes_nothing=not _is_used(content, flight, source),
    )
    flight = replace(flight, drone=replace(drone, optics=optics, image_width_px=width_px))
    return replace(content, optics=optics), flight, decision


def _said_by(taken: PhotographedWith | None) -> set[str]:
    """The options that EXIF answers."""
    if taken is None:
        return set()
    return {WIDTH_OPTION, HEIGHT_OPTION} if taken.field_of_view_deg is None else set(CAMERA_OPTIONS)


def _size_of(flight: FlightRequest, taken_wh: tuple[int, int] | None) -> tuple[int, int]:
    """Width and height: as typed, else of the photographs; one that was typed alone keeps their
    shape."""
    width_px = flight.drone.image_width_px
    height_px = round(flight.drone.optics.aspect * width_px)
    typed = flight.typed_camera.intersection((WIDTH_OPTION, HEIGHT_OPTION))
    if taken_wh is None or len(typed) == 2:
        return width_px, height_px
    taken_width_px, taken_height_px = taken_wh
    if WIDTH_OPTION in typed:
        return width_px, max(1, round(width_px * taken_height_px / taken_width_px))
    return (max(1, round(height_px * taken_width_px / taken_height_px)), height_px) if typed else taken_wh


def _is_used(content: ContentRequest, flight: FlightRequest, source: FoundWaypoints) -> bool:
    """Whether there are heights, without which nothing is said of images."""
    return source.waypoints.heights_m is not None or content.ground_m is not None or flight.height_m is not None
