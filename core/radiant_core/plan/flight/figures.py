"""What a list of waypoints costs in the air and shows of the ground. Once per device.

    flight time = Σ leg / speed + turns · turn time + way out and home
    batteries = ⌈flight time / usable time⌉
    GSD = 2 h tan(fov / 2) / image width px,   overlap = 1 − spacing / footprint

h: median height above take-off or ground. Spacing ahead is the median distance of neighbours on a
line, aside the median distance of a line to the nearest other one. Flight time is not computing
time, which the plan's curves give: both are shown, each by its name.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.plan.borders.footprints import Optics
from radiant_core.plan.flight.lines import flight_lines

TURN_S = 3.0
"""Braking and turning where the way bends by more than `TURN_DEG`."""
TURN_DEG = 30.0
CLIMB_M_PER_S = 4.0


@dataclass(frozen=True, kw_only=True)
class Drone:
    """How a device flies and what its camera sees; BadInput for numbers that no drone has."""

    speed_m_per_s: float = 8.0
    battery_s: float = 1200.0
    """Time in the air on one battery, reserve taken off."""
    image_width_px: int = 4000
    optics: Optics = field(default_factory=Optics)

    def __post_init__(self) -> None:
        if not 0.1 <= self.speed_m_per_s <= 100:
            raise BadInput(f"the speed is {self.speed_m_per_s} m/s, expected 0.1 to 100.")
        if not 30 <= self.battery_s <= 1e6:
            raise BadInput(f"a battery lasts {self.battery_s} s, expected 30 or more.")
        if not 16 <= self.image_width_px <= 1 << 17:
            raise BadInput(f"images are {self.image_width_px} px wide, expected 16 to {1 << 17}.")


@dataclass(frozen=True, kw_only=True)
class FlightFigures:
    """Of one device; None where heights or lines are not known."""

    num_waypoints: int
    length_m: float
    flight_s: float
    batteries: int
    gsd_m: float | None
    forward_overlap: float | None
    side_overlap: float | None


def flight_figures(positions: FloatArray, heights_m: FloatArray | None, drone: Drone) -> FlightFigures:
    """Figures of waypoints (P,2) m in the order of the flight, with heights (P,) m, NaN where one
    is not known."""
    steps = np.diff(positions, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    length_m = float(lengths.sum())
    # Out from the first and home from the last waypoint, which is where take-off is taken to be.
    home_m = float(np.linalg.norm(positions[-1] - positions[0])) if len(positions) else 0.0
    known_m = np.zeros(0) if heights_m is None else heights_m[np.isfinite(heights_m)]
    height_m = float(np.median(known_m)) if len(known_m) else None
    climb_s = 0.0 if height_m is None else 2 * max(height_m, 0.0) / CLIMB_M_PER_S
    flight_s = (length_m + home_m) / drone.speed_m_per_s + TURN_S * _num_turns(steps) + climb_s if len(positions) else 0.0
    width_m = None if height_m is None or height_m <= 0 else 2 * height_m * math.tan(math.radians(drone.optics.field_of_view_deg / 2))
    ahead_m, aside_m = _spacings(positions)
    return FlightFigures(
        num_waypoints=len(positions),
        length_m=length_m,
        flight_s=flight_s,
        batteries=math.ceil(flight_s / drone.battery_s) if flight_s > 0 else 0,
        gsd_m=None if width_m is None else width_m / drone.image_width_px,
        forward_overlap=_overlap(ahead_m, None if width_m is None else width_m * drone.optics.aspect),
        side_overlap=_overlap(aside_m, width_m),
    )


def _num_turns(steps: FloatArray) -> int:
    if len(steps) < 2:
        return 0
    before, after = steps[:-1], steps[1:]
    product = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    return int((np.einsum("ki,ki->k", before, after) < np.cos(np.radians(TURN_DEG)) * product).sum())


def _spacings(positions: FloatArray) -> tuple[float | None, float | None]:
    """Median distances of neighbours on lines, and of lines; None without two of them."""
    if len(positions) < 2:
        return None, None
    lines = flight_lines(np.column_stack([positions, np.zeros(len(positions))]))
    if not lines:
        return None, None
    ahead = np.concatenate([np.linalg.norm(np.diff(positions[line], axis=0), axis=1) for line in lines])
    if len(lines) < 2:
        return float(np.median(ahead)), None
    way = positions[lines[0][-1]] - positions[lines[0][0]]
    axis = np.array([-way[1], way[0]]) / np.linalg.norm(way)
    places = np.sort([float((positions[line] @ axis).mean()) for line in lines])
    return float(np.median(ahead)), float(np.median(np.diff(places)))


def _overlap(spacing_m: float | None, footprint_m: float | None) -> float | None:
    return None if spacing_m is None or footprint_m is None else max(0.0, 1 - spacing_m / footprint_m)
