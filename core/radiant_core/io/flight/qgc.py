"""A route as a QGroundControl plan (.plan, version 1): takeoff, a picture at each waypoint, return.

Format: QGroundControl developer guide, Plan File Format; commands of MAVLink's MAV_CMD.
"""

from __future__ import annotations

import json
import math
from typing import Any

from radiant_core.io.flight.route import Route

WAYPOINT, RETURN, TAKEOFF, GIMBAL, PICTURE = 16, 20, 22, 205, 2000
FRAME = {"takeoff": 3, "absolute": 0}
"""MAV_FRAME: relative to home, or above the sea."""
ALTITUDE_MODE = {"takeoff": 1, "absolute": 2}
_MISSION_FRAME, _MAVLINK_MOUNT = 2, 2
_PX4, _QUADROTOR = 12, 2


def qgc_plan(route: Route) -> bytes:
    """The file's content."""
    rows = list(zip(route.lat_lon.tolist(), route.heights_m.tolist(), route.heading_pitch_deg.tolist(), strict=True))
    items: list[dict[str, Any]] = []
    home = [0.0, 0.0, 0.0]
    if rows:
        (lat, lon), height, _ = rows[0]
        home = [lat, lon, 0.0]
        items.append(_place(TAKEOFF, route, lat, lon, height, [0, 0, 0, None]))
    pitch_now: float | None = None
    for (lat, lon), height, (heading, pitch) in rows:
        if not math.isnan(pitch) and pitch != pitch_now:
            items.append(_item(GIMBAL, _MISSION_FRAME, [pitch, 0, 0, 0, 0, 0, _MAVLINK_MOUNT]))
            pitch_now = pitch
        items.append(_place(WAYPOINT, route, lat, lon, height, [0, 0, 0, None if math.isnan(heading) else heading]))
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
        "globalPlanAltitudeMode": ALTITUDE_MODE[route.heights],
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


def _place(command: int, route: Route, lat: float, lon: float, height: float, params: list[float | None]) -> dict[str, Any]:
    item = _item(command, FRAME[route.heights], [*params, round(lat, 9), round(lon, 9), round(height, 3)])
    return {**item, "AMSLAltAboveTerrain": None, "Altitude": round(height, 3), "AltitudeMode": ALTITUDE_MODE[route.heights]}


def _item(command: int, frame: int, params: list[float | None]) -> dict[str, Any]:
    return {"type": "SimpleItem", "autoContinue": True, "command": command, "doJumpId": 0, "frame": frame, "params": params}
