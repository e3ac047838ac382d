"""A route as DJI's WPML: a KMZ with wpmz/template.kml, which Pilot 2 edits, and wpmz/waylines.wpml,
which the drone flies. A picture at every waypoint.

Format: DJI, Cloud API, Wayline File Format Standard, namespace wpmz/1.0.2. The drone is written as
M3E; Pilot 2 asks before it flies a route on another one. Heights above take-off are
relativeToStartPoint in both. Absolute ones are flown above the WGS84 ellipsoid (executeHeightMode
WGS84) and edited above sea level (heightMode EGM96), so that the geoid between must be known. A
route has one mode, and none for the ground below each point that a drone without a terrain model
could fly.
"""

from __future__ import annotations

import io
import math
import zipfile
from datetime import UTC, datetime
from typing import NamedTuple
from xml.sax.saxutils import escape

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.frames import enu_from_geodetic
from radiant_core.io.flight.route import NEEDS_GEOID, Route
from radiant_core.numerics import FloatArray
from radiant_core.plan.heights import ABOVE, FROM_THE_SEA

KML, WPML = "http://www.opengis.net/kml/2.2", "http://www.dji.com/wpmz/1.0.2"
MAX_WAYPOINTS = 65_535
DRONE, PAYLOAD = 77, 66
"""Mavic 3 Enterprise, and its camera."""
SAFE_HEIGHT_M, TRANSIT_M_PER_S = 20.0, 10.0
MIN_M_PER_S, MAX_M_PER_S = 1.0, 15.0
"""Speeds of a wayline (waypointSpeed, autoFlightSpeed)."""
_WRITTEN = datetime(1980, 1, 1, tzinfo=UTC)


def wpml_kmz(route: Route) -> bytes:
    """The file's content; BadInput for more waypoints than a wayline holds, speeds that none flies,
    and heights of a kind that it has no mode for."""
    if len(route.names) > MAX_WAYPOINTS:
        raise BadInput(
            f"{route.name} has {len(route.names)} waypoints, more than the {MAX_WAYPOINTS} of a DJI wayline: plan with more devices."
        )
    if not MIN_M_PER_S <= route.speed_m_per_s <= MAX_M_PER_S:
        raise BadInput(f"--speed is {route.speed_m_per_s:g} m/s, expected {MIN_M_PER_S:g} to {MAX_M_PER_S:g} for a DJI wayline.")
    heights = _heights(route)
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in (("wpmz/template.kml", _template(route, heights)), ("wpmz/waylines.wpml", _waylines(route, heights))):
            # A time of its own would make every file another one.
            entry = zipfile.ZipInfo(name, _WRITTEN.timetuple()[:6])
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, text.encode())
    return content.getvalue()


class _Heights(NamedTuple):
    """Modes and heights (P,) of what the drone flies and of what Pilot 2 edits."""

    execute_mode: str
    executed_m: FloatArray
    edit_mode: str
    edited_m: FloatArray


def _heights(route: Route) -> _Heights:
    if set(route.kinds) <= {"takeoff"}:
        mode = "relativeToStartPoint"
        return _Heights(execute_mode=mode, executed_m=route.heights_m, edit_mode=mode, edited_m=route.heights_m)
    if not set(route.kinds) <= set(FROM_THE_SEA):
        kinds = " and ".join(ABOVE[kind] for kind in route.kinds)
        raise BadInput(
            f"a DJI wayline has heights above take-off alone or absolute ones alone, and these are {kinds}: give --heights takeoff where "
            "the ground is level, or write another format."
        )
    if route.geoid_m is None and "absolute" not in route.kinds:
        raise BadInput(f"a DJI wayline needs absolute heights above sea level and above the WGS84 ellipsoid: {NEEDS_GEOID}.")
    return _Heights(
        execute_mode="WGS84",
        executed_m=route.heights_above("ellipsoid"),
        edit_mode="EGM96",
        edited_m=route.heights_above("sea"),
    )


def _document(body: list[str]) -> str:
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<kml xmlns="{KML}" xmlns:wpml="{WPML}">',
        "<Document>",
        *body,
        "</Document>",
        "</kml>",
    ]
    return "\n".join(lines) + "\n"


def _tag(name: str, value: object) -> str:
    return f"<wpml:{name}>{value}</wpml:{name}>"


def _config() -> str:
    drone = _tag("droneInfo", _tag("droneEnumValue", DRONE) + _tag("droneSubEnumValue", 0))
    payload = _tag("payloadInfo", _tag("payloadEnumValue", PAYLOAD) + _tag("payloadPositionIndex", 0))
    fields = (
        ("flyToWaylineMode", "safely"),
        ("finishAction", "goHome"),
        ("exitOnRCLost", "executeLostAction"),
        ("executeRCLostAction", "goBack"),
        ("takeOffSecurityHeight", f"{SAFE_HEIGHT_M:g}"),
        ("globalTransitionalSpeed", f"{TRANSIT_M_PER_S:g}"),
    )
    return _tag("missionConfig", "".join(_tag(*field) for field in fields) + drone + payload)


def _template(route: Route, heights: _Heights) -> str:
    system = _tag("waylineCoordinateSysParam", _tag("coordinateMode", "WGS84") + _tag("heightMode", heights.edit_mode))
    head = [
        _tag("author", "radiant"),
        f"<!-- {escape(route.heights_text)} -->",
        _config(),
        "<Folder>",
        _tag("templateType", "waypoint") + _tag("templateId", 0) + system + _tag("autoFlightSpeed", f"{route.speed_m_per_s:g}"),
        _tag("globalWaypointTurnMode", "toPointAndStopWithDiscontinuityCurvature") + _tag("globalUseStraightLine", 1),
        _tag("gimbalPitchMode", "usePointSetting"),
        _tag("globalHeight", f"{float(np.median(heights.edited_m)) if len(heights.edited_m) else 0.0:.3f}"),
        _tag("globalWaypointHeadingParam", _heading(math.nan)),
    ]
    points = [
        _placemark(route, row, f"{_tag('ellipsoidHeight', f'{flown:.3f}')}{_tag('height', f'{edited:.3f}')}{_tag('useGlobalHeight', 0)}")
        for row, (flown, edited) in enumerate(zip(heights.executed_m.tolist(), heights.edited_m.tolist(), strict=True))
    ]
    return _document([*head, *points, "</Folder>"])


def _waylines(route: Route, heights: _Heights) -> str:
    length_m = 0.0
    if len(route.lat_lon):
        level = np.column_stack([route.lat_lon, route.heights_m])
        length_m = float(np.linalg.norm(np.diff(enu_from_geodetic(level, level[0]), axis=0), axis=1).sum())
    head = [
        f"<!-- {escape(route.heights_text)} -->",
        _config(),
        "<Folder>",
        _tag("templateId", 0) + _tag("executeHeightMode", heights.execute_mode) + _tag("waylineId", 0),
        _tag("distance", f"{length_m:.3f}") + _tag("duration", f"{length_m / route.speed_m_per_s:.3f}"),
        _tag("autoFlightSpeed", f"{route.speed_m_per_s:g}"),
    ]
    points = [_placemark(route, row, _tag("executeHeight", f"{value:.3f}")) for row, value in enumerate(heights.executed_m.tolist())]
    return _document([*head, *points, "</Folder>"])


def _placemark(route: Route, row: int, height: str) -> str:
    lat, lon = route.lat_lon[row].tolist()
    heading, pitch = route.heading_pitch_deg[row].tolist()
    turn = _tag("waypointTurnMode", "toPointAndStopWithDiscontinuityCurvature") + _tag("waypointTurnDampingDist", 0)
    return (
        f"<Placemark><Point><coordinates>{lon:.9f},{lat:.9f}</coordinates></Point>{_tag('index', row)}{height}"
        f"{_tag('waypointSpeed', f'{route.speed_m_per_s:g}')}{_tag('waypointHeadingParam', _heading(heading))}"
        f"{_tag('waypointTurnParam', turn)}{_tag('useStraightLine', 1)}{_actions(row, pitch)}</Placemark>"
    )


def _heading(heading_deg: float) -> str:
    if math.isnan(heading_deg):
        return _tag("waypointHeadingMode", "followWayline") + _tag("waypointHeadingPathMode", "followBadArc")
    turned = (heading_deg + 180) % 360 - 180
    angle = _tag("waypointHeadingAngle", f"{turned:.3f}") + _tag("waypointHeadingAngleEnable", 1)
    return _tag("waypointHeadingMode", "smoothTransition") + angle + _tag("waypointHeadingPathMode", "followBadArc")


def _actions(row: int, pitch_deg: float) -> str:
    """Turn the gimbal, straight down unless the plan says, and take a picture."""
    pitch = -90.0 if math.isnan(pitch_deg) else pitch_deg
    gimbal = "".join(
        _tag(name, value)
        for name, value in (
            ("gimbalHeadingYawBase", "aircraft"),
            ("gimbalRotateMode", "absoluteAngle"),
            ("gimbalPitchRotateEnable", 1),
            ("gimbalPitchRotateAngle", f"{pitch:.3f}"),
            ("gimbalRollRotateEnable", 0),
            ("gimbalRollRotateAngle", 0),
            ("gimbalYawRotateEnable", 0),
            ("gimbalYawRotateAngle", 0),
            ("gimbalRotateTimeEnable", 0),
            ("gimbalRotateTime", 0),
            ("payloadPositionIndex", 0),
        )
    )
    picture = _tag("payloadPositionIndex", 0) + _tag("useGlobalPayloadLensIndex", 0)
    actions = [("gimbalRotate", gimbal), ("takePhoto", picture)]
    written = "".join(
        _tag("action", _tag("actionId", number) + _tag("actionActuatorFunc", name) + _tag("actionActuatorFuncParam", values))
        for number, (name, values) in enumerate(actions)
    )
    group = _tag("actionGroupId", row) + _tag("actionGroupStartIndex", row) + _tag("actionGroupEndIndex", row)
    return _tag(
        "actionGroup",
        group + _tag("actionGroupMode", "sequence") + _tag("actionTrigger", _tag("actionTriggerType", "reachPoint")) + written,
    )
