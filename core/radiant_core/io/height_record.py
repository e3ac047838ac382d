"""What the heights of a plan's waypoints count from and how high they may be flown, in plan.json.

    "heights_from": "takeoff"            # or a list, one a waypoint, where they differ
    "height_limits_m": [null, 150.0]     # left out: the usual ones

Plans of earlier versions say `absolute` and `altitude_known` instead, of all waypoints together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from radiant_core.choices import HeightFrom
from radiant_core.errors import BadInput
from radiant_core.plan.heights import HEIGHT_KINDS, USUAL_LIMIT_M, HeightLimits, height_codes
from radiant_core.plan.waypoints import HIGHEST_FLIGHT_M, Waypoints

HEIGHTS_FROM, LIMITS = "heights_from", "height_limits_m"


def heights_record(waypoints: Waypoints) -> dict[str, Any]:
    """The entries above, for the record of the waypoints."""
    kinds = waypoints.counts_from
    named = [HEIGHT_KINDS[code] for code in kinds.tolist()] if isinstance(kinds, np.ndarray) else kinds
    limits = waypoints.limits
    return {HEIGHTS_FROM: named, **({} if limits == HeightLimits() else {LIMITS: [limits.lowest_m, limits.highest_m]})}


def with_recorded_heights(waypoints: Waypoints, record: Mapping[str, Any]) -> Waypoints:
    """The waypoints with what their record says of heights; BadInput where it says something
    else."""
    limits = record.get(LIMITS)
    if limits is not None:
        if not (isinstance(limits, list) and len(limits) == 2 and all(bound is None or _is_number(bound) for bound in limits)):
            raise BadInput(f"{LIMITS} is {str(limits)[:40]}, expected the lowest height, or null, and the highest.")
        lowest_m, highest_m = limits
        waypoints = replace(waypoints, limits=HeightLimits(lowest_m=lowest_m, highest_m=USUAL_LIMIT_M if highest_m is None else highest_m))
    if HEIGHTS_FROM not in record:
        return _of_earlier(waypoints, record)
    named = record[HEIGHTS_FROM]
    if isinstance(named, str):
        return replace(waypoints, counts_from=_kind(named))
    if not isinstance(named, list):
        raise BadInput(f"{HEIGHTS_FROM} is {str(named)[:40]}, expected one of {', '.join(HEIGHT_KINDS)}, or one a waypoint.")
    return replace(waypoints, counts_from=height_codes([_kind(name) for name in named]))


def _of_earlier(waypoints: Waypoints, record: Mapping[str, Any]) -> Waypoints:
    if record.get("altitude_known") is False:
        if waypoints.ground_m is None:
            return replace(waypoints, counts_from="unknown")
        # Heights above the ground of a run whose altitudes counted from nothing.
        places = waypoints.lat_lon_alt - np.array([0.0, 0.0, waypoints.ground_m])
        return replace(waypoints, lat_lon_alt=places, ground_m=0.0)
    absolute = record.get("absolute") is True or float(waypoints.lat_lon_alt[:, 2].max()) > HIGHEST_FLIGHT_M
    return replace(waypoints, counts_from="absolute" if absolute or waypoints.ground_m else "takeoff")


def _kind(name: Any) -> HeightFrom:
    for kind in HEIGHT_KINDS:
        if name == kind:
            return kind
    raise BadInput(f"{HEIGHTS_FROM} has {str(name)[:40]!r}, expected one of {', '.join(HEIGHT_KINDS)}.")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
