"""What is wrong with a list of ground control, seen before hours of matching. Once per scene.

Marks are compared with the photographs that are there, and places with the GPS of the photographs
that show them: a camera stands no farther from a point than it can be seen. What takes the poses is
compared afterwards (`against_gps.py`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.frames import enu_from_geodetic, geodetic_from_enu
from radiant_core.georef.control_points import ControlPoints, ControlRequest, system_of
from radiant_core.georef.likely_cause import place_difference
from radiant_core.georef.list_lines import FIRST_PIXEL
from radiant_core.io.photos.listing import Photograph
from radiant_core.numerics import FloatArray
from radiant_core.sfm.control.priors import accurate_positions, are_enough
from radiant_core.sfm.world_frame.contradictions import Contradiction, settle
from radiant_core.sfm.world_frame.placement import Placement

MIN_CONTROL = 3
MIN_PHOTOGRAPHS = 2
"""That must show a point for its rays to meet."""
MIN_SPREAD = 0.02
"""Across the line through them, points must spread by this share of its length."""
BORDER_PX = 1.0
"""A mark on the rim of a photograph may be rounded outwards."""
SEEN_M, SEEN_EXTENTS, SEEN_HEIGHTS = 2_000.0, 3.0, 3.0
"""A photograph shows points so far away at most: all three in metres, extents of the flight, and
heights above the ground."""
MAX_HEIGHT_M = 10_000.0
LINE = "the points that are to place the scene lie on a line, which leaves the roll about it open: add one beside it."


@dataclass(frozen=True, kw_only=True, eq=False)
class _Marks:
    """Marks of a list that are in photographs of the scene (M)."""

    points: NDArray[np.int64]
    photographs: tuple[Photograph, ...]


def check_control(placement: Placement, photographs: tuple[Photograph, ...], sizes_wh: Mapping[str, tuple[int, int]]) -> tuple[str, ...]:
    """Warnings about ground control, if there is any, and the photographs that are to be placed;
    `sizes_wh`: name → size in px of the picture that marks count in. BadInput for a list that
    cannot place them, or contradicts their GPS."""
    control = placement.parsed_control()
    if control is None or placement.control is None:
        return ()
    marks = _marks_in(control, photographs, placement.control.source)
    _require_inside(control, sizes_wh, placement.control.source)
    _require_enough(control, marks, photographs, placement.control.source)
    contradiction = _contradiction(control, marks, placement.control)
    return settle([] if contradiction is None else [contradiction], placement.contradictions)


def listed_system(request: ControlRequest) -> str:
    """The first line of a list that is none of remarks."""
    lines = (line.split("#", 1)[0].strip() for line in request.text.splitlines())
    return next(line for line in lines if line)


def require_spread(places_m: FloatArray) -> None:
    """Raise BadInput for places (G,3) that lie on a line."""
    if not is_spread(places_m):
        raise BadInput(LINE)


def is_spread(places_m: FloatArray) -> bool:
    """Whether places (G,3) do not lie on a line."""
    if len(places_m) < MIN_CONTROL:
        return False
    spread = np.linalg.svd(places_m - places_m.mean(axis=0), compute_uv=False)
    return bool(spread[1] > MIN_SPREAD * spread[0])


def _marks_in(control: ControlPoints, photographs: tuple[Photograph, ...], source: str) -> _Marks:
    by_name = {photo.name: photo for photo in photographs}
    rows = [row for row, name in enumerate(control.mark_images) if name in by_name]
    if not rows:
        named, there = control.mark_images[0], photographs[0].name
        raise BadInput(
            f"{source}: none of its {len(control.mark_images)} marks is in a photograph that is here: it names {named!r}, and here are "
            f"{there!r} and others; give the list of these photographs, with their file names."
        )
    return _Marks(points=control.mark_points[rows], photographs=tuple(by_name[control.mark_images[row]] for row in rows))


def _require_inside(control: ControlPoints, sizes_wh: Mapping[str, tuple[int, int]], source: str) -> None:
    outside = []
    for name, pixel in zip(control.mark_images, control.mark_pixels, strict=True):
        if name in sizes_wh and not ((pixel >= -BORDER_PX) & (pixel <= np.array(sizes_wh[name]) + BORDER_PX)).all():
            outside.append((name, pixel))
    if outside:
        (name, pixel), total = outside[0], len(control.mark_images)
        width, height = sizes_wh[name]
        column, row = pixel - FIRST_PIXEL  # as the list has it
        raise BadInput(
            f"{source}: {len(outside)} of {total} marks lie outside of their photographs, the first at {column:g}, {row:g} of "
            f"{name}, which is {width} × {height} px: marks count in the photograph as it is stored, neither turned nor of another size."
        )


def _require_enough(control: ControlPoints, marks: _Marks, photographs: tuple[Photograph, ...], source: str) -> None:
    """Raise BadInput unless three points that are not kept out, and not on a line, are in two
    photographs each, or none is used and positions of known accuracy place the scene alone."""
    in_photographs = [
        {photo.name for photo, point in zip(marks.photographs, marks.points, strict=True) if point == row} for row in _rows(control)
    ]
    usable = np.array([len(names) >= MIN_PHOTOGRAPHS for names in in_photographs]) & ~control.is_check
    if usable.sum() >= MIN_CONTROL:
        require_spread(control.places_m[usable])
        return
    alone = are_enough(accurate_positions(photographs)[0])
    if control.is_check.all():
        if alone and control.origin_lat_lon_alt is not None:
            return
        why = f"all {len(usable)} points are kept out for checking"
    else:
        single = sum(len(names) == 1 for names in in_photographs)
        nowhere = sum(not names for names in in_photographs)
        facts = (
            (int(control.is_check.sum()), "kept out for checking"),
            (single, "in one photograph alone"),
            (nowhere, "in none that is here"),
        )
        counts_text = ", ".join(f"{count} {reason}" for count, reason in facts if count)
        why = f"{int(usable.sum())} of {len(usable)} points can place the scene{f' ({counts_text})' * bool(counts_text)}"
    raise BadInput(
        f"{source}: {why}, expected {MIN_CONTROL} or more, each marked in {MIN_PHOTOGRAPHS} photographs: mark more, or keep fewer out."
    )


def _rows(control: ControlPoints) -> range:
    return range(len(control.names))


def _contradiction(control: ControlPoints, marks: _Marks, request: ControlRequest) -> Contradiction | None:
    """The contradiction of a list to the GPS of the photographs that show its points, if any."""
    rows = [row for row, photo in enumerate(marks.photographs) if photo.lat_lon_alt is not None]
    if control.origin_lat_lon_alt is None or not rows:
        return None
    listed = geodetic_from_enu(control.places_m[marks.points[rows]], control.origin_lat_lon_alt)
    expected = np.array([marks.photographs[row].lat_lon_alt for row in rows], np.float64)
    # A height that is not known is the point's.
    expected[:, 2] = np.where(np.isfinite(expected[:, 2]), expected[:, 2], listed[:, 2])
    difference = place_difference(listed, expected, system_of(listed_system(request), request.source))
    if difference.horizontal_m <= _seen_m(expected, difference.vertical_m):
        return None
    apart = distance_text(difference.horizontal_m)
    return Contradiction(
        sentence=f"{request.source} and the photographs' GPS contradict each other: its points lie {apart} from the photographs that show "
        f"them ({place_text(listed)} against {place_text(expected)}){cause_text(difference.cause)}",
        is_gross=True,
        outcome="the list is taken",
        remedy="correct the list's first line or its coordinates",
    )


def _seen_m(gps: FloatArray, height_m: float) -> float:
    """How far photographs with these positions (M,3) may stand from what they show."""
    middle = np.median(gps, axis=0)
    positions_m = enu_from_geodetic(gps, middle)[:, :2]
    extent_m = 2 * float(np.median(np.linalg.norm(positions_m, axis=1)))
    return max(SEEN_M, SEEN_EXTENTS * extent_m, SEEN_HEIGHTS * min(abs(height_m), MAX_HEIGHT_M))


def cause_text(cause: str | None) -> str:
    """A likely cause behind a sentence, nothing without one."""
    return "" if cause is None else f"; likely cause: {cause}"


def distance_text(metres: float) -> str:
    """A large distance for a person: 153 m, 4.5 km, 5,712 km."""
    if metres < 1_000:
        return f"{metres:,.0f} m"
    return f"{metres / 1e3:,.1f} km" if metres < 100e3 else f"{metres / 1e3:,.0f} km"


def place_text(lat_lon_alt: FloatArray) -> str:
    """The middle of places (N,3) in degrees: 47.37° N 8.54° E."""
    latitude, longitude = np.median(lat_lon_alt[:, :2], axis=0).tolist()
    return f"{abs(latitude):.2f}° {'N' if latitude >= 0 else 'S'} {abs(longitude):.2f}° {'E' if longitude >= 0 else 'W'}"
