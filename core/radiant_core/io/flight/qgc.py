"""A route as a QGroundControl plan (.plan, version 1): takeoff, a picture at each waypoint, return.

Format: QGroundControl developer guide, Plan File Format; commands of MAVLink's MAV_CMD.
"""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np

from radiant_core.choices import HeightFrom
from radiant_core.io.flight.route import Route
from radiant_core.numerics import FloatArray
from radiant_core.plan.heights import FROM_THE_SEA, HEIGHT_KINDS

WAYPOINT, RETURN, TAKEOFF, GIMBAL, PICTURE = 16, 20, 22, 205, 2000
FRAME: dict[HeightFrom, int] = {"takeoff": 3, "ground": 10, "sea": 0}
"""MAV_FRAME_GLOBAL_RELATIVE_ALT, above home; _GLOBAL_TERRAIN_ALT, above the ground below the point;
_GLOBAL, above mean sea level (MAVLink, common.xml)."""
ALTITUDE_MODE: dict[HeightFrom, int] = {"takeoff": 1, "ground": 4, "sea": 2}
"""QGroundControl's AltitudeModeRelative, TerrainFrame and Absolute."""
MIXED_MODES = 0
_MISSION_FRAME, _MAVLINK_MOUNT = 2, 2
_PX4, _QUADROTOR = 12, 2


def qgc_plan(route: Route) -> bytes:
    """The file's content; BadInput for heights above the ellipsoid without a geoid."""
    heights_m, kinds = _heights(route)
    rows = list(zip(route.lat_lon.tolist(), heights_m.tolist(), kinds, route.heading_pitch_deg.tolist(), strict=True))
    items: list[dict[str, Any]] = []
    home = [0.0, 0.0, 0.0]
    if rows:
        (lat, lon), height, kind, _ = rows[0]
        home = [lat, lon, 0.0]
        # The ground below is that of take-off there.
        items.append(_place(TAKEOFF, "takeoff" if kind == "ground" else kind, (lat, lon, height), [0, 0, 0, None]))
    pitch_now: float | None = None
    for (lat, lon), height, kind, (heading, pitch) in rows:
        if not math.isnan(pitch) and pitch != pitch_now:
            items.append(_item(GIMBAL, _MISSION_FRAME, [pitch, 0, 0, 0, 0, 0, _MAVLINK_MOUNT]))
            pitch_now = pitch
        items.append(_place(WAYPOINT, kind, (lat, lon, height), [0, 0, 0, None if math.isnan(heading) else heading]))
        items.append(_item(PICTURE, _MISSION_FRAME, [0, 0, 1, 0, 0, 0, 0]))
    items.append(_item(RETURN, _MISSION_FRAME, [0, 0, 0, 0, 0, 0, 0]))
    for number, item in enumerate(items, 1):
        item["doJumpId"] = number
    mission = {
        "version": 2,
        "firmwareType": _PX4,
        "vehicleType": _QUADROTOR,
        "cruiseSpeed": route.speed_m_per_s,
        "hoverSpeed": route.speed_m_per_s,
        "globalPlanAltitudeMode": MIXED_MODES if len(set(kinds)) > 1 else ALTITUDE_MODE[kinds[0] if kinds else "takeoff"],
        "plannedHomePosition": home,
        "items": items,
    }
    plan = {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "mission": mission,
        "geoFence": {"circles": [], "polygons": [], "version": 2},
        "rallyPoints": {"points": [], "version": 2},
    }
    return (json.dumps(plan, indent=1, allow_nan=False) + "\n").encode()


def _heights(route: Route) -> tuple[FloatArray, list[HeightFrom]]:
    """Heights (P,) and their kinds, those from the ellipsoid from the sea."""
    kinds: list[HeightFrom] = [HEIGHT_KINDS[code] for code in route.height_codes.tolist()]
    is_absolute = np.array([kind in FROM_THE_SEA for kind in kinds], bool)
    heights_m = np.where(is_absolute, route.heights_above("sea"), route.heights_m) if is_absolute.any() else route.heights_m
    return heights_m, ["sea" if kind in FROM_THE_SEA else kind for kind in kinds]


def _place(command: int, kind: HeightFrom, place: tuple[float, float, float], params: list[float | None]) -> dict[str, Any]:
    lat, lon, height = place
    item = _item(command, FRAME[kind], [*params, round(lat, 9), round(lon, 9), round(height, 3)])
    return {**item, "AMSLAltAboveTerrain": None, "Altitude": round(height, 3), "AltitudeMode": ALTITUDE_MODE[kind]}


def _item(command: int, frame: int, params: list[float | None]) -> dict[str, Any]:
    return {"type": "SimpleItem", "autoContinue": True, "command": command, "doJumpId": 0, "frame": frame, "params": params}
