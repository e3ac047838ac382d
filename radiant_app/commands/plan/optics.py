"""The camera that a plan before capture counts with: as typed, else as its photographs' EXIF says,
else assumed. Footprints, overlaps and the ground sampling distance follow from it. Once per plan.
"""

from __future__ import annotations

from dataclasses import replace

from radiant_app.commands.plan.content import ContentRequest
from radiant_app.commands.plan.flight import CAMERA_OPTIONS, FlightRequest
from radiant_core.decisions import Decision
from radiant_core.plan.borders.footprints import Optics
from radiant_core.waypoints.reader import FoundWaypoints

ANGLE_OPTION, *_SIZES = CAMERA_OPTIONS
SIZE_OPTIONS = frozenset(_SIZES)


def with_camera(content: ContentRequest, flight: FlightRequest, source: FoundWaypoints) -> tuple[ContentRequest, FlightRequest, Decision]:
    """Both requests with the camera of the photographs where none was typed, and what it is."""
    typed, taken, drone = flight.typed_camera, source.taken_with, flight.drone
    angle_deg, width_px = drone.optics.field_of_view_deg, drone.image_width_px
    height_px, assumed = round(drone.optics.aspect * width_px), set(CAMERA_OPTIONS) - typed
    if taken is not None and not typed.intersection(SIZE_OPTIONS):
        (width_px, height_px), assumed = taken.size_wh, assumed - SIZE_OPTIONS
    if taken is not None and taken.field_of_view_deg is not None and ANGLE_OPTION not in typed:
        angle_deg, assumed = taken.field_of_view_deg, assumed - {ANGLE_OPTION}
    optics = Optics(field_of_view_deg=angle_deg, aspect=height_px / width_px)
    known = "as asked for" if typed else "EXIF of most photographs says so"
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


def _is_used(content: ContentRequest, flight: FlightRequest, source: FoundWaypoints) -> bool:
    """Whether there are heights, without which nothing is said of images."""
    return source.waypoints.heights_m is not None or content.ground_m is not None or flight.height_m is not None
