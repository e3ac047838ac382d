"""What `radiant plan` says of flying: whole lines, time in the air, lists that planners open."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from radiant_core.choices import Heights
from radiant_core.errors import BadInput
from radiant_core.io.flight.kml import kml_route
from radiant_core.io.flight.qgc import qgc_plan
from radiant_core.io.flight.route import FlownHeights, Route, route_of
from radiant_core.io.flight.wpml import wpml_kmz
from radiant_core.io.run_store import write_atomic
from radiant_core.plan.borders.footprints import Optics
from radiant_core.plan.flight.figures import Drone, FlightFigures, flight_figures
from radiant_core.plan.flight.whole_lines import LinePlan
from radiant_core.plan.heights import HEIGHT_KINDS, USUAL_LIMIT_M, HeightLimits, said_heights
from radiant_core.plan.plans import EdgePlan
from radiant_core.plan.waypoints import Waypoints

WRITERS: dict[str, Callable[[Route], bytes]] = {"kmz": wpml_kmz, "plan": qgc_plan, "kml": kml_route}
"""Formats of flight lists beside CSV, by the ending of their files."""
MAX_TRIED = 1_000
"""Waypoints of all that are written once before the work, so that what no list can have is told at
once; each list is checked again as it is written."""
NOT_COMPARED = (
    "How far absolute heights lie above the ground is not known, so that the lists are not held to {highest_m:g} m above it: give --ground."
)
NO_COLUMN = "The lists hold no heights above take-off"
CAMERA_OPTIONS = ("--field-of-view", "--image-width-px", "--image-height-px")
_DURATION = re.compile(r"(\d+(?:\.\d+)?)\s*(s|m|min|h)")
_SECONDS = {"s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0}


@dataclass(frozen=True, kw_only=True)
class FlightRequest:
    """How devices fly, and which lists are wanted."""

    whole_lines: float | None = None
    """How many times the shortest makespan the plan may take to keep lines whole; None: not."""
    formats: tuple[str, ...] = ()
    flown: FlownHeights = field(default_factory=FlownHeights)
    """What heights in these lists count from."""
    height_m: float | None = None
    """Metres above take-off for all waypoints, in place of what they have."""
    limits: HeightLimits = field(default_factory=HeightLimits)
    """Heights above take-off or ground that lists may be written for."""
    drone: Drone = field(default_factory=Drone)
    typed_camera: frozenset[str] = frozenset()
    """The options about its camera that were typed."""

    @property
    def is_plain(self) -> bool:
        """Whether nothing was asked for that only flights to come have."""
        plain = FlightRequest(drone=self.drone, typed_camera=self.typed_camera)
        return self == plain


class HeightOptions(NamedTuple):
    """The options about heights as they were typed."""

    heights: Heights | None = None
    height_m: float | None = None
    lowest_m: float | None = None
    highest_m: float | None = None
    geoid_m: float | None = None


class DroneText(NamedTuple):
    """The options about a drone as they were typed."""

    speed_m_per_s: float
    battery: str
    image_width_px: int | None = None
    field_of_view_deg: float | None = None
    image_height_px: int | None = None


def flight_request(whole_lines: float | None, formats: str | None, heights: HeightOptions, drone: DroneText) -> FlightRequest:
    """What the command line was asked for; BadInput where an option is none."""
    about_images = (drone.field_of_view_deg, drone.image_width_px, drone.image_height_px)
    return FlightRequest(
        whole_lines=whole_lines,
        formats=flight_formats(formats),
        flown=FlownHeights(heights=heights.heights, geoid_m=heights.geoid_m),
        height_m=heights.height_m,
        limits=HeightLimits(lowest_m=heights.lowest_m, highest_m=USUAL_LIMIT_M if heights.highest_m is None else heights.highest_m),
        drone=Drone(
            speed_m_per_s=drone.speed_m_per_s,
            battery_s=battery_seconds(drone.battery),
            image_width_px=_width_of(drone),
            optics=_optics_of(drone),
        ),
        typed_camera=frozenset(name for name, value in zip(CAMERA_OPTIONS, about_images, strict=True) if value is not None),
    )


def _width_of(drone: DroneText) -> int:
    if drone.image_width_px is None and drone.image_height_px is not None:
        return round(drone.image_height_px / Optics().aspect)
    return Drone().image_width_px if drone.image_width_px is None else drone.image_width_px


def _optics_of(drone: DroneText) -> Optics:
    usual = Optics()
    angle_deg = usual.field_of_view_deg if drone.field_of_view_deg is None else drone.field_of_view_deg
    aspect = usual.aspect if drone.image_height_px is None else drone.image_height_px / _width_of(drone)
    return Optics(field_of_view_deg=angle_deg, aspect=aspect)


def flight_formats(text: str | None) -> tuple[str, ...]:
    """`--flight-format` as endings; BadInput for one that is not known."""
    formats = tuple(dict.fromkeys(part.strip().lower() for part in (text or "").split(",") if part.strip()))
    unknown = [part for part in formats if part not in (*WRITERS, "csv")]
    if unknown:
        raise BadInput(f"--flight-format names {unknown[0]!r}, expected some of csv (always written), {', '.join(WRITERS)} with commas.")
    return tuple(part for part in formats if part != "csv")


def battery_seconds(text: str) -> float:
    """`--battery` in seconds, of 20m or 1200s; BadInput for anything else."""
    match = _DURATION.fullmatch(text.strip())
    if match is None:
        raise BadInput(f"--battery is {text!r}, expected the time in the air on one battery, such as 20m.")
    return float(match[1]) * _SECONDS[match[2]]


def write_routes(folder: Path, edges: Sequence[EdgePlan], waypoints: Waypoints, request: FlightRequest) -> str | None:
    """A file per device and format in the existing `folder`; what heights count from, or None
    without a format."""
    if not request.formats:
        return None
    for plan in edges:
        for device_id in plan.device_ids:
            route = route_of(device_id, waypoints, plan.cameras_of(device_id), request.flown, request.drone.speed_m_per_s)
            for ending in request.formats if len(route.names) else ():
                write_atomic(folder / f"{device_id}.{ending}", WRITERS[ending](route))
    return _whole_route(waypoints, request).heights_text


def as_listed(waypoints: Waypoints, request: FlightRequest) -> Waypoints:
    """The waypoints for lists as CSV: heights above the ground below each point are heights above
    take-off where these are asked for."""
    if request.flown.heights != "takeoff":
        return waypoints
    codes = waypoints.height_codes.copy()
    codes[waypoints.counting_from("ground")] = HEIGHT_KINDS.index("takeoff")
    return replace(waypoints, counts_from=codes)


def _whole_route(waypoints: Waypoints, request: FlightRequest) -> Route:
    return route_of("all", waypoints, np.arange(len(waypoints)), request.flown, request.drone.speed_m_per_s)


def heights_to_fly(waypoints: Waypoints, request: FlightRequest, ground_m: float | None) -> tuple[Waypoints, tuple[str, ...]]:
    """The waypoints with the heights and limits that were asked for, and what is to be known of
    them. BadInput where a list was asked for that they cannot have."""
    warnings: tuple[str, ...] = ()
    waypoints = replace(waypoints, limits=request.limits)
    if request.height_m is not None:
        if ground_m is not None:
            raise BadInput("--height counts from take-off and --ground makes heights above the ground: give one of them.")
        if waypoints.altitude_known:
            had = said_heights(waypoints.lat_lon_alt[:, 2], waypoints.height_codes)
            warnings = (f"All waypoints fly {request.height_m:g} m above take-off, as --height says, in place of what they have: {had}.",)
        waypoints = waypoints.at_height(request.height_m)
    elif ground_m is not None:
        waypoints = waypoints.with_ground(ground_m)
    if request.formats:
        # All of them in one list, before the work: what a device's cannot have, this cannot either.
        whole = _whole_route(waypoints, request)
        first = replace(whole, **{name: getattr(whole, name)[:MAX_TRIED] for name in ("names", "lat_lon", "heading_pitch_deg")})
        first = replace(first, heights_m=whole.heights_m[:MAX_TRIED], height_codes=whole.height_codes[:MAX_TRIED])
        for ending in request.formats:
            WRITERS[ending](first)
        heights_m = waypoints.heights_m
        if heights_m is None or np.isnan(heights_m).any():
            warnings = (*warnings, NOT_COMPARED.format(highest_m=request.limits.highest_m))
    elif waypoints.height_problem is not None:
        warnings = (*warnings, f"{NO_COLUMN}: {waypoints.height_problem}")
    return waypoints, warnings


def lines_text(lines: LinePlan) -> str:
    """What became of the lines, in a sentence."""
    if lines.reason is not None:
        return f"not kept whole: {lines.reason}"
    whole = lines.num_lines - lines.cut
    return f"{whole} of {lines.num_lines} whole ({lines.cut_before} were cut before), {lines.slack:.3f} × the shortest makespan"


def flight_rows(edges: Sequence[EdgePlan], waypoints: Waypoints, drone: Drone, idle: Mapping[str, str]) -> list[dict[str, Any]]:
    """A row per device: seconds of computing and of flying, what is seen, and why it has nothing to
    do, of `idle`."""
    positions, heights_m = waypoints.positions_m[:, :2], waypoints.heights_m
    rows = []
    for plan in edges:
        for device_id, computing_s in zip(plan.device_ids, plan.device_time_s.tolist(), strict=True):
            camera_rows = plan.cameras_of(device_id)
            figures = flight_figures(positions[camera_rows], None if heights_m is None else heights_m[camera_rows], drone)
            rows.append(_row(device_id, computing_s, figures) | ({"idle": idle[device_id]} if device_id in idle else {}))
    return rows


def flight_table(rows: Sequence[dict[str, Any]]) -> str:
    """The rows, aligned."""
    width = max(len("device"), *(len(row["device"]) for row in rows))
    head = f"{'device':<{width}} {'waypoints':>9} {'computing':>10} {'flight':>9} {'batteries':>9} {'way':>8} {'GSD':>8}"
    lines = [
        f"{row['device']:<{width}} {row['waypoints']:>9} {row['computing_s']:>8.0f} s {row['flight_s'] / 60:>5.1f} min"
        f" {row['batteries']:>9} {row['length_m']:>6.0f} m {_length(row['gsd_m']):>8}"
        f" {_share(row['forward_overlap']):>6} {_share(row['side_overlap']):>6}"
        if "idle" not in row
        else f"{row['device']:<{width}} {row['waypoints']:>9} {row['idle']}"
        for row in rows
    ]
    head += f" {'ahead':>6} {'aside':>6}"
    return "\n".join([head, *lines])


def _row(device_id: str, computing_s: float, figures: FlightFigures) -> dict[str, Any]:
    return {
        "device": device_id,
        "waypoints": figures.num_waypoints,
        "computing_s": computing_s,
        "flight_s": figures.flight_s,
        "batteries": figures.batteries,
        "length_m": figures.length_m,
        "gsd_m": figures.gsd_m,
        "forward_overlap": figures.forward_overlap,
        "side_overlap": figures.side_overlap,
    }


def _length(metres: float | None) -> str:
    return "unknown" if metres is None else f"{100 * metres:.2f} cm"


def _share(share: float | None) -> str:
    return "none" if share is None else f"{share:.0%}"
