"""What `radiant plan` says of flying: whole lines, time in the air, lists that planners open."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from radiant_core.choices import Heights
from radiant_core.errors import BadInput
from radiant_core.io.flight.kml import kml_route
from radiant_core.io.flight.qgc import qgc_plan
from radiant_core.io.flight.route import SAID, Route, route_of
from radiant_core.io.flight.wpml import wpml_kmz
from radiant_core.io.run_store import write_atomic
from radiant_core.plan.borders.footprints import Optics
from radiant_core.plan.flight.figures import Drone, FlightFigures, flight_figures
from radiant_core.plan.flight.whole_lines import LinePlan
from radiant_core.plan.plans import EdgePlan
from radiant_core.plan.waypoints import Waypoints

WRITERS: dict[str, Callable[[Route], bytes]] = {"kmz": wpml_kmz, "plan": qgc_plan, "kml": kml_route}
"""Formats of flight lists beside CSV, by the ending of their files."""
_DURATION = re.compile(r"(\d+(?:\.\d+)?)\s*(s|m|min|h)")
_SECONDS = {"s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0}


@dataclass(frozen=True, kw_only=True)
class FlightRequest:
    """How devices fly, and which lists are wanted."""

    whole_lines: float | None = None
    """How many times the shortest makespan the plan may take to keep lines whole; None: not."""
    formats: tuple[str, ...] = ()
    heights: Heights | None = None
    drone: Drone = field(default_factory=Drone)


class DroneText(NamedTuple):
    """The options about a drone as they were typed."""

    speed_m_per_s: float
    battery: str
    image_width_px: int
    field_of_view_deg: float


def flight_request(whole_lines: float | None, formats: str | None, heights: Heights | None, drone: DroneText) -> FlightRequest:
    """What the command line was asked for; BadInput where an option is none."""
    return FlightRequest(
        whole_lines=whole_lines,
        formats=flight_formats(formats),
        heights=heights,
        drone=Drone(
            speed_m_per_s=drone.speed_m_per_s,
            battery_s=battery_seconds(drone.battery),
            image_width_px=drone.image_width_px,
            optics=Optics(field_of_view_deg=drone.field_of_view_deg),
        ),
    )


def flight_formats(text: str | None) -> tuple[str, ...]:
    """`--flight-format` as endings; BadInput for one that is not known."""
    found = tuple(dict.fromkeys(part.strip().lower() for part in (text or "").split(",") if part.strip()))
    unknown = [part for part in found if part not in (*WRITERS, "csv")]
    if unknown:
        raise BadInput(f"--flight-format names {unknown[0]!r}, expected some of csv (always written), {', '.join(WRITERS)} with commas.")
    return tuple(part for part in found if part != "csv")


def battery_seconds(text: str) -> float:
    """`--battery` in seconds, of 20m or 1200s; BadInput for anything else."""
    found = _DURATION.fullmatch(text.strip())
    if found is None:
        raise BadInput(f"--battery is {text!r}, expected the time in the air on one battery, such as 20m.")
    return float(found[1]) * _SECONDS[found[2]]


def write_routes(folder: Path, edges: Sequence[EdgePlan], waypoints: Waypoints, request: FlightRequest) -> str | None:
    """A file per device and format in the existing `folder`; what heights count from, or None
    without a format."""
    if not request.formats:
        return None
    heights: Heights | None = None
    for plan in edges:
        for device_id in plan.device_ids:
            route = route_of(device_id, waypoints, plan.cameras_of(device_id), request.heights, request.drone.speed_m_per_s)
            heights = route.heights
            for ending in request.formats if len(route.names) else ():
                write_atomic(folder / f"{device_id}.{ending}", WRITERS[ending](route))
    return None if heights is None else SAID[heights]


def lines_text(found: LinePlan) -> str:
    """What became of the lines, in a sentence."""
    if found.reason is not None:
        return f"not kept whole: {found.reason}"
    whole = found.num_lines - found.cut
    return f"{whole} of {found.num_lines} whole ({found.cut_before} were cut before), {found.slack:.3f} × the shortest makespan"


def flight_rows(edges: Sequence[EdgePlan], waypoints: Waypoints, drone: Drone) -> list[dict[str, Any]]:
    """A row per device: seconds of computing and of flying, and what is seen."""
    positions, heights_m = waypoints.positions_m[:, :2], waypoints.heights_m
    rows = []
    for plan in edges:
        for device_id, computing_s in zip(plan.device_ids, plan.device_time_s.tolist(), strict=True):
            own = plan.cameras_of(device_id)
            figures = flight_figures(positions[own], None if heights_m is None else heights_m[own], drone)
            rows.append(_row(device_id, computing_s, figures))
    return rows


def flight_table(rows: Sequence[dict[str, Any]]) -> str:
    """The rows, aligned."""
    width = max(len("device"), *(len(row["device"]) for row in rows))
    head = f"{'device':<{width}} {'waypoints':>9} {'computing':>10} {'flight':>9} {'batteries':>9} {'way':>8} {'GSD':>8}"
    lines = [
        f"{row['device']:<{width}} {row['waypoints']:>9} {row['computing_s']:>8.0f} s {row['flight_s'] / 60:>5.1f} min"
        f" {row['batteries']:>9} {row['length_m']:>6.0f} m {_length(row['gsd_m']):>8}"
        f" {_share(row['forward_overlap']):>6} {_share(row['side_overlap']):>6}"
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
