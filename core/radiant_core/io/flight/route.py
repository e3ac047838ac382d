"""`Route`: one device's waypoints in the order that they are flown, ready to be written."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiant_core.choices import Heights
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.plan.waypoints import Waypoints

SAID = {"takeoff": "heights are above take-off", "absolute": "heights are absolute, as the positions had them"}


@dataclass(frozen=True, kw_only=True, eq=False)
class Route:
    """lat_lon (P,2) deg; heights_m (P,); heading_pitch_deg (P,2), NaN where a plan does not say."""

    name: str
    names: tuple[str, ...]
    lat_lon: FloatArray
    heights_m: FloatArray
    heights: Heights
    heading_pitch_deg: FloatArray
    speed_m_per_s: float


def route_of(name: str, waypoints: Waypoints, indices: NDArray[np.int64], heights: Heights | None, speed_m_per_s: float) -> Route:
    """The route of some waypoints; `heights` None: above take-off where that is known. BadInput
    where the positions have no heights of that kind."""
    above = waypoints.heights_m
    chosen: Heights = heights or ("takeoff" if above is not None else "absolute")
    if chosen == "takeoff" and above is None:
        raise BadInput("heights above take-off are asked for, and nothing says how far the positions lie above the ground: give --ground.")
    if chosen == "absolute" and (not waypoints.altitude_known or (above is not None and not waypoints.absolute)):
        raise BadInput("absolute heights are asked for, and the positions have none: they count from take-off, or from nothing.")
    values = waypoints.lat_lon_alt[:, 2] if chosen == "absolute" or above is None else above
    angles = waypoints.heading_pitch_deg
    return Route(
        name=name,
        names=tuple(waypoints.names[index] for index in indices.tolist()),
        lat_lon=waypoints.lat_lon_alt[indices, :2],
        heights_m=values[indices],
        heights=chosen,
        heading_pitch_deg=np.full((len(indices), 2), np.nan) if angles is None else angles[indices],
        speed_m_per_s=speed_m_per_s,
    )
