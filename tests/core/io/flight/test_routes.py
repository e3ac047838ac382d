"""Flight lists as others read them: WPML by zip and XML against DJI's elements, .plan as JSON against QGroundControl's, KML by fastkml."""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import replace
from xml.etree import ElementTree

import fastkml
import numpy as np
import pytest
from pygeoif import Point

from radiant_core.choices import HeightFrom, Heights
from radiant_core.errors import BadInput
from radiant_core.io.flight.kml import kml_route
from radiant_core.io.flight.qgc import qgc_plan
from radiant_core.io.flight.route import FlownHeights, Route, route_of
from radiant_core.io.flight.wpml import KML, WPML, wpml_kmz
from radiant_core.plan.heights import HEIGHT_KINDS
from radiant_core.plan.waypoints import Waypoints
from radiant_core.waypoints.kml_reader import kml_rows

NS = {"k": KML, "w": WPML}


def waypoints(*, absolute: bool = False, counts_from: HeightFrom = "ellipsoid") -> Waypoints:
    places = np.array([[47.37 + 1e-4 * k, 8.54 - 2e-4 * k, (460.0 if absolute else 80.0) + k] for k in range(6)])
    looks = np.array([[90.0, -90.0], [np.nan, np.nan], [270.0, -45.0], [270.0, -45.0], [np.nan, -60.0], [10.0, np.nan]])
    names = ('a & "b"', "<c>", "d", "e", "f", "ü")
    return Waypoints(names=names, lat_lon_alt=places, heading_pitch_deg=looks, counts_from=counts_from if absolute else "takeoff")


def route(heights: Heights | None = None, *, absolute: bool = False, geoid_m: float | None = 47.0) -> Route:
    return route_of("dev-1", waypoints(absolute=absolute), np.array([0, 2, 3, 5]), FlownHeights(heights=heights, geoid_m=geoid_m), 7.5)


def test_the_drones_file_of_wpml_says_place_height_and_picture() -> None:
    modes: tuple[tuple[Heights, str, tuple[int, ...]], ...] = (
        ("takeoff", "relativeToStartPoint", (80, 82, 83, 85)),
        ("absolute", "WGS84", (460, 462, 463, 465)),
    )
    for heights, mode, values in modes:
        with zipfile.ZipFile(io.BytesIO(wpml_kmz(route(heights, absolute=heights == "absolute")))) as archive:
            assert archive.namelist() == ["wpmz/template.kml", "wpmz/waylines.wpml"] and archive.testzip() is None
            lines, template = (ElementTree.fromstring(archive.read(name)) for name in ("wpmz/waylines.wpml", "wpmz/template.kml"))
        for root in (lines, template):
            config = root.find(".//w:missionConfig", NS)
            assert config is not None
            needed = (
                "flyToWaylineMode",
                "finishAction",
                "exitOnRCLost",
                "executeRCLostAction",
                "takeOffSecurityHeight",
                "globalTransitionalSpeed",
            )
            assert all(config.findtext(f"w:{name}", None, NS) for name in needed)
            assert (
                config.find("w:droneInfo/w:droneEnumValue", NS) is not None
                and config.find("w:payloadInfo/w:payloadEnumValue", NS) is not None
            )
            # Above the ellipsoid where it is flown, 47 m less above the sea where Pilot 2 edits it.
            below_m = 47 if heights == "absolute" and root is template else 0
            written = root.findall(f".//w:{'executeHeight' if root is lines else 'height'}", NS)
            assert [float(height.text or "") for height in written] == [value - below_m for value in values]
        assert template.findtext(".//w:heightMode", None, NS) == ("EGM96" if heights == "absolute" else "relativeToStartPoint")
        assert [float(height.text or "") for height in template.findall(".//w:ellipsoidHeight", NS)] == list(values)
        folder = lines.find(".//k:Folder", NS)
        assert folder is not None and folder.findtext("w:executeHeightMode", None, NS) == mode
        assert float(folder.findtext("w:distance", "0", NS)) == pytest.approx(94, abs=2)  # 5 steps of 11 and 15 m
        points = folder.findall("k:Placemark", NS)
        assert [int(point.findtext("w:index", "", NS)) for point in points] == [0, 1, 2, 3]
        for point, (lat, lon) in zip(points, route(absolute=heights == "absolute", heights=heights).lat_lon.tolist(), strict=True):
            written = [float(value) for value in point.findtext("k:Point/k:coordinates", "", NS).split(",")]
            assert written == pytest.approx([lon, lat], abs=1e-9)
            group = point.find("w:actionGroup", NS)
            assert group is not None and group.findtext("w:actionTrigger/w:actionTriggerType", None, NS) == "reachPoint"
            assert [action.text for action in group.findall("w:action/w:actionActuatorFunc", NS)] == ["gimbalRotate", "takePhoto"]
        pitches = [float(pitch.text) for pitch in lines.findall(".//w:gimbalPitchRotateAngle", NS)]
        assert pitches == [-90, -45, -45, -90], "straight down where the plan does not say"
        assert [float(angle.text) for angle in lines.findall(".//w:waypointHeadingAngle", NS)] == [90, -90, -90, 10], "DJI counts to ±180"
        assert template.findtext(".//w:waylineCoordinateSysParam/w:coordinateMode", None, NS) == "WGS84"
        assert template.findtext(".//w:templateType", None, NS) == "waypoint"


def test_a_file_is_the_same_whenever_it_is_written() -> None:
    assert wpml_kmz(route()) == wpml_kmz(route())


def test_the_plan_of_qgroundcontrol_has_its_fields() -> None:
    frames: tuple[tuple[Heights, int, int], ...] = (("takeoff", 3, 1), ("absolute", 0, 2))
    for heights, frame, mode in frames:
        given = route(heights, absolute=heights == "absolute")
        plan = json.loads(qgc_plan(given))
        assert (plan["fileType"], plan["version"], plan["groundStation"]) == ("Plan", 1, "QGroundControl")
        assert plan["geoFence"]["version"] == 2 and plan["rallyPoints"]["version"] == 2
        mission = plan["mission"]
        assert (mission["version"], mission["globalPlanAltitudeMode"], mission["cruiseSpeed"]) == (2, mode, 7.5)
        assert len(mission["plannedHomePosition"]) == 3
        items = mission["items"]
        assert [item["doJumpId"] for item in items] == list(range(1, len(items) + 1))
        assert all(item["type"] == "SimpleItem" and len(item["params"]) == 7 and item["autoContinue"] is True for item in items)
        places = [item for item in items if item["command"] == 16]
        np.testing.assert_allclose([item["params"][4:6] for item in places], given.lat_lon, atol=1e-9)
        above_m = (given.heights_m - (47.0 if heights == "absolute" else 0.0)).tolist()
        assert [item["Altitude"] for item in places] == above_m == [item["params"][6] for item in places]
        assert all((item["frame"], item["AltitudeMode"]) == (frame, mode) for item in places)
        assert [item["command"] for item in items].count(2000) == 4, "a picture at each"
        assert (items[0]["command"], items[-1]["command"]) == (22, 20)
        assert [item["params"][0] for item in items if item["command"] == 205] == [-90, -45], "the gimbal turns where its pitch changes"


def test_kml_is_read_by_fastkml_and_by_radiant() -> None:
    modes: tuple[tuple[Heights, str], ...] = (("takeoff", "relativeToGround"), ("absolute", "absolute"))
    for heights, mode in modes:
        given = route(heights, absolute=heights == "absolute")
        data = kml_route(given)
        document = fastkml.KML.from_string(data.decode().split("\n", 1)[1]).features[0]
        assert isinstance(document, fastkml.Document)
        marks = [mark for mark in document.features if isinstance(mark, fastkml.Placemark)]
        assert [mark.name for mark in marks] == list(given.names)
        above_m = given.heights_m - (47.0 if heights == "absolute" else 0.0)
        for mark, (lat, lon), height in zip(marks, given.lat_lon.tolist(), above_m.tolist(), strict=True):
            assert isinstance(mark.kml_geometry, fastkml.Point) and isinstance(mark.geometry, Point)
            assert mark.kml_geometry.altitude_mode is not None
            assert next(iter(mark.geometry.coords)) == pytest.approx((lon, lat, height), abs=1e-6)
            assert mark.kml_geometry.altitude_mode.value == mode
        rows = kml_rows(data.decode())
        assert rows.names == list(given.names)
        assert {HEIGHT_KINDS[code] for code in rows.height_codes} == {"sea" if heights == "absolute" else "ground"}


def test_heights_that_nobody_knows_are_refused() -> None:
    with pytest.raises(BadInput, match="--ground"):
        route("takeoff", absolute=True)
    with pytest.raises(BadInput, match="absolute heights are asked for"):
        route("absolute")
    grounded = replace(waypoints(absolute=True), ground_m=400.0)
    assert route_of("d", grounded, np.array([0]), FlownHeights(), 5.0).heights_m.tolist() == [60.0]
    assert route_of("d", grounded, np.array([0]), FlownHeights(heights="absolute"), 5.0).heights_m.tolist() == [460.0]


def test_an_empty_route_is_whole_and_too_long_a_one_refused() -> None:
    empty = route_of("d", waypoints(), np.zeros(0, np.int64), FlownHeights(), 5.0)
    assert json.loads(qgc_plan(empty))["mission"]["items"][-1]["command"] == 20
    assert zipfile.ZipFile(io.BytesIO(wpml_kmz(empty))).testzip() is None
    one = route()
    long = replace(one, names=one.names * 20_000)
    with pytest.raises(BadInput, match="65535"):
        wpml_kmz(long)
