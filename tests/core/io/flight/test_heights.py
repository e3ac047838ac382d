"""What a number counts from in each format that is read, and that it counts from the same in each list that is written.

The right values are those of the formats' own documents: KML of OGC 12-007r2 (KML 2.3, 9.20, and 2.2, 07-147r2, 9.20) and Google's
reference of gx:altitudeMode; GeoJSON of RFC 7946, 3.1.1; frames of MAVLink's common.xml (MAV_FRAME); QGroundControl's developer guide,
Plan File Format, and its AltMode; DJI's Cloud API, Wayline File Format Standard (template.kml, waylines.wpml); Litchi's CSV by
litchiutilities.com/docs/litchiCsv.php (altitudemode, "Above Ground").
"""

from __future__ import annotations

import csv
import io
import json
import zipfile
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from radiant_core.choices import HeightFrom, Heights
from radiant_core.errors import BadInput
from radiant_core.io.flight.kml import kml_route
from radiant_core.io.flight.qgc import qgc_plan
from radiant_core.io.flight.route import FlownHeights, Route, route_of
from radiant_core.io.flight.wpml import KML, WPML, wpml_kmz
from radiant_core.plan.heights import HEIGHT_KINDS, HeightLimits, height_codes
from radiant_core.plan.waypoints import Waypoints
from radiant_core.waypoints.reader import read_waypoints

NS = {"k": KML, "w": WPML}
GX = 'xmlns:gx="http://www.google.com/kml/ext/2.2"'


def read(folder: Path, name: str, text: str) -> list[tuple[str, float]]:
    """Kind and number of each waypoint's height."""
    (folder / name).write_text(text)
    found = read_waypoints(folder / name).waypoints
    return [(HEIGHT_KINDS[code], alt) for code, alt in zip(found.height_codes.tolist(), found.lat_lon_alt[:, 2].tolist(), strict=True)]


def placemark(mode: str, coordinates: str = "8.54,47.37,80", kind: str = "Point") -> str:
    return f"<Placemark><{kind}>{mode}<coordinates>{coordinates}</coordinates></{kind}></Placemark>"


def kml(body: str) -> str:
    return f'<kml xmlns="http://www.opengis.net/kml/2.2" {GX}><Document>{body}</Document></kml>'


KML_MODES: list[tuple[str, HeightFrom]] = [
    ("", "unknown"),
    ("<altitudeMode/>", "unknown"),
    ("<altitudeMode>clampToGround</altitudeMode>", "unknown"),
    ("<altitudeMode> relativeToGround </altitudeMode>", "ground"),
    ("<altitudeMode>absolute</altitudeMode>", "sea"),
    ("<gx:altitudeMode>clampToSeaFloor</gx:altitudeMode>", "unknown"),
    ("<gx:altitudeMode>relativeToSeaFloor</gx:altitudeMode>", "unknown"),
    ("<seaFloorAltitudeMode>relativeToSeaFloor</seaFloorAltitudeMode>", "unknown"),
    ("<altitudeMode>clampToGround</altitudeMode><gx:altitudeMode>clampToSeaFloor</gx:altitudeMode>", "unknown"),
    ("<extrude>1</extrude><tessellate>1</tessellate>", "unknown"),
]


@pytest.mark.parametrize("kind", ["Point", "LineString"])
@pytest.mark.parametrize(("mode", "counts_from"), KML_MODES)
def test_kml_says_by_each_geometry_what_its_heights_count_from(tmp_path: Path, mode: str, counts_from: HeightFrom, kind: str) -> None:
    number = 0.0 if counts_from == "unknown" else 80.0
    assert read(tmp_path, "a.kml", kml(placemark(mode, kind=kind))) == [(counts_from, number)]


def test_modes_may_differ_from_geometry_to_geometry(tmp_path: Path) -> None:
    parts = "".join(
        f"<Point>{mode}<coordinates>8.54{index},47.37,80</coordinates></Point>" for index, (mode, _) in enumerate(KML_MODES[:5])
    )
    multi = f"<Placemark><MultiGeometry>{parts}</MultiGeometry></Placemark>"
    line = placemark(KML_MODES[3][0], "8.55,47.37,60 8.55,47.371,61", "LineString")
    found = read(tmp_path, "a.kml", kml(f"<Folder>{multi}</Folder>{line}"))
    assert found == [("unknown", 0.0)] * 3 + [("ground", 80.0), ("sea", 80.0), ("ground", 60.0), ("ground", 61.0)]


@pytest.mark.parametrize(
    ("mode", "told"),
    [
        ("<altitudeMode>relativeToTerrain</altitudeMode>", "has the altitudeMode 'relativeToTerrain', expected one of clampToGround"),
        ("<altitudeMode>absolute</altitudeMode><gx:altitudeMode>clampToSeaFloor</gx:altitudeMode>", "which contradict: leave one"),
    ],
)
def test_a_mode_that_says_nothing_is_refused(tmp_path: Path, mode: str, told: str) -> None:
    with pytest.raises(BadInput, match=told):
        read(tmp_path, "a.kml", kml(placemark(mode)))


def test_what_is_clamped_is_said_with_the_number_that_is_none(tmp_path: Path) -> None:
    (tmp_path / "a.kml").write_text(kml(placemark("", "8.54,47.37,455.5 8.541,47.37,nan 8.542,47.37", "LineString")))
    found = read_waypoints(tmp_path / "a.kml")
    assert found.warnings[0].startswith("2 of 3 waypoints are clamped to the ground") and "up to 455.5, are no heights" in found.warnings[0]
    assert found.waypoints.heights_m is None and not found.waypoints.altitude_known


def test_heights_over_the_sea_floor_are_not_called_clamped(tmp_path: Path) -> None:
    (tmp_path / "a.kml").write_text(kml(placemark("<gx:altitudeMode>relativeToSeaFloor</gx:altitudeMode>")))
    assert read_waypoints(tmp_path / "a.kml").warnings[0].startswith("1 of 1 waypoints count from the sea floor")


@pytest.mark.parametrize("name", ["altitudeOffset", "gx:altitudeOffset"])
def test_an_offset_is_a_part_of_the_height(tmp_path: Path, name: str) -> None:
    mode = "<altitudeMode>relativeToGround</altitudeMode>"
    line = placemark(f"<{name}>30</{name}>{mode}", "8.54,47.37,80 8.541,47.37,81", "LineString")
    assert read(tmp_path, "a.kml", kml(line)) == [("ground", 110.0), ("ground", 111.0)]
    with pytest.raises(BadInput, match="the altitudeOffset of the placemark"):
        read(tmp_path, "a.kml", kml(placemark(f"<{name}>a</{name}>{mode}")))


@pytest.mark.parametrize(
    ("mode", "said"), [("", "has no executeHeightMode"), ("<wpml:heightMode>A</wpml:heightMode>", "its heightMode 'A' is not known")]
)
def test_heights_of_dji_without_a_mode_are_named(tmp_path: Path, mode: str, said: str) -> None:
    (tmp_path / "a.kml").write_text(wayline(mode, "<wpml:height>80</wpml:height>"))
    assert said in read_waypoints(tmp_path / "a.kml").warnings[0]


@pytest.mark.parametrize("column", ["height", "Height (ft)", "elevation", "z", "Altitude(km)", "Altitude (GPS)"])
def test_a_column_that_may_be_heights_is_named_where_it_is_not_read(tmp_path: Path, column: str) -> None:
    (tmp_path / "a.csv").write_text(f"latitude,longitude,{column},image height,photo\n47.37,8.54,80,3000,a.jpg\n")
    first, second = read_waypoints(tmp_path / "a.csv").warnings
    assert first.startswith(f"Not read as heights, since their names do not say what they count from in metres: {column.lower()!r}.")
    assert "None of 1 waypoints has an altitude" in second


@pytest.mark.parametrize(
    ("column", "counts_from"), [("Altitude (m AGL)", "ground"), ("Altitude [m, AMSL]", "sea"), ("Altitude (metres HAE)", "ellipsoid")]
)
def test_a_unit_may_stand_before_what_a_column_counts_from(tmp_path: Path, column: str, counts_from: HeightFrom) -> None:
    quoted = f'"{column}"'
    assert read(tmp_path, "a.csv", f"latitude,longitude,{quoted}\n47.37,8.54,80\n") == [(counts_from, 80.0)]
    with pytest.raises(BadInput, match="is in feet"):
        read(tmp_path, "b.csv", "latitude,longitude,Altitude (ft AGL)\n47.37,8.54,80\n")


def wayline(mode: str, height: str, more: str = "") -> str:
    mark = f"<Placemark><Point><coordinates>8.54,47.37</coordinates></Point><wpml:index>0</wpml:index>{height}</Placemark>"
    return f'<kml xmlns="{KML}" xmlns:wpml="{WPML}"><Document><Folder>{more}{mark}{mode}</Folder></Document></kml>'


@pytest.mark.parametrize(
    ("mode", "height", "counts_from", "number"),
    [
        ("<wpml:executeHeightMode>WGS84</wpml:executeHeightMode>", "<wpml:executeHeight>80</wpml:executeHeight>", "ellipsoid", 80),
        (
            "<wpml:executeHeightMode>relativeToStartPoint</wpml:executeHeightMode>",
            "<wpml:executeHeight>80</wpml:executeHeight>",
            "takeoff",
            80,
        ),
        (
            "<wpml:executeHeightMode>realTimeFollowSurface</wpml:executeHeightMode>",
            "<wpml:executeHeight>80</wpml:executeHeight>",
            "ground",
            80,
        ),
        ("", "<wpml:executeHeight>80</wpml:executeHeight>", "unknown", 0),
        (
            "<wpml:heightMode>EGM96</wpml:heightMode>",
            "<wpml:ellipsoidHeight>127</wpml:ellipsoidHeight><wpml:height>80</wpml:height>",
            "sea",
            80,
        ),
        ("<wpml:heightMode>relativeToStartPoint</wpml:heightMode>", "<wpml:height>80</wpml:height>", "takeoff", 80),
        ("<wpml:heightMode>aboveGroundLevel</wpml:heightMode>", "<wpml:height>80</wpml:height>", "ground", 80),
        (
            "<wpml:heightMode>relativeToStartPoint</wpml:heightMode><wpml:globalHeight>90</wpml:globalHeight>",
            "<wpml:height>80</wpml:height><wpml:useGlobalHeight>1</wpml:useGlobalHeight>",
            "takeoff",
            90,
        ),
    ],
)
def test_routes_of_dji_say_it_by_the_mode_of_the_route(
    tmp_path: Path, mode: str, height: str, counts_from: HeightFrom, number: float
) -> None:
    assert read(tmp_path, "waylines.kml", wayline(mode, height)) == [(counts_from, number)]
    assert read(tmp_path, "template.kml", wayline("", height, mode)) == [(counts_from, number)], "wherever the mode stands"


@pytest.mark.parametrize(
    ("feature", "expected"),
    [
        ({"geometry": {"type": "Point", "coordinates": [8.54, 47.37, 527.0]}}, ("ellipsoid", 527.0)),
        ({"geometry": {"type": "Point", "coordinates": [8.54, 47.37]}}, ("unknown", 0.0)),
        ({"geometry": {"type": "LineString", "coordinates": [[8.54, 47.37, 527.0]]}}, ("ellipsoid", 527.0)),
        (
            {"geometry": {"type": "Point", "coordinates": [8.54, 47.37]}, "properties": {"height_m": 80, "height_from": "takeoff"}},
            ("takeoff", 80.0),
        ),
    ],
)
def test_the_third_number_of_geojson_is_above_the_ellipsoid(tmp_path: Path, feature: dict, expected: tuple[str, float]) -> None:
    assert read(tmp_path, "a.geojson", json.dumps({"type": "Feature", **feature})) == [expected]


def test_half_a_height_of_geojson_is_refused(tmp_path: Path) -> None:
    for properties in ({"height_from": "takeoff"}, {"height_m": 3, "height_from": "moon"}, {"height_m": "3", "height_from": "sea"}):
        feature = {"type": "Feature", "geometry": {"type": "Point", "coordinates": [8.54, 47.37]}, "properties": properties}
        with pytest.raises(BadInput, match="height_from"):
            read(tmp_path, "a.geojson", json.dumps(feature))


@pytest.mark.parametrize(
    ("column", "counts_from"),
    [
        *((name, "takeoff") for name in ("altitude", "alt(m)", "height_above_takeoff(m)", "relative_altitude", "HeightAboveTakeoff [m]")),
        *((name, "ground") for name in ("altitude_agl", "AltitudeAGL", "alt_agl", "height_above_ground", "height above ground (m)", "AGL")),
        *((name, "sea") for name in ("altitudeAMSL", "altitude_msl", "AMSL (m)", "altitude_above_seaLevel(m)", "orthometric_height")),
        *(
            (name, "ellipsoid")
            for name in ("ellipsoidal height", "height_ellipsoid(m)", "HAE", "ellipsoid_height_m", "altitude_ellipsoid(m)")
        ),
        ("altitude_absolute(m)", "absolute"),
    ],
)
def test_a_column_says_by_its_name_what_it_counts_from(tmp_path: Path, column: str, counts_from: HeightFrom) -> None:
    assert read(tmp_path, "a.csv", f"lat,lon,{column}\n47.37,8.54,80\n47.38,8.54,\n") == [(counts_from, 80.0), ("unknown", 0.0)]


@pytest.mark.parametrize("column", ["altitude(ft)", "alt_agl (feet)", "height_above_takeoff(feet)", "altitudeAMSL ft", "hae_ft"])
def test_feet_are_no_metres(tmp_path: Path, column: str) -> None:
    with pytest.raises(BadInput, match="is in feet: convert it to metres"):
        read(tmp_path, "a.csv", f"lat,lon,{column}\n47.37,8.54,80\n")


def test_litchis_altitudemode_holds_line_by_line(tmp_path: Path) -> None:
    table = "latitude,longitude,altitude(m),altitudemode\n47.37,8.54,80,0\n47.371,8.54,70,1\n47.372,8.54,60,\n"
    assert read(tmp_path, "a.csv", table) == [("takeoff", 80.0), ("ground", 70.0), ("takeoff", 60.0)]
    with pytest.raises(BadInput, match="the altitudemode in line 2 is '2'"):
        read(tmp_path, "a.csv", "lat,lon,altitude,altitudemode\n47.37,8.54,80,2\n")


def test_of_several_columns_the_one_that_says_most_of_take_off_holds(tmp_path: Path) -> None:
    table = "lat,lon,altitude,height_above_takeoff,altitude_absolute\n47.37,8.54,455,80,500\n47.371,8.54,,,501\n"
    assert read(tmp_path, "a.csv", table) == [("takeoff", 80.0), ("absolute", 501.0)]
    (note,) = (said for said in read_waypoints(tmp_path / "a.csv").warnings if "column" in said)
    assert note == "Heights are those of the column 'height_above_takeoff'; 'altitude', 'altitude_absolute' only where that is empty."


def test_altitudes_of_a_column_that_says_nothing_are_absolute_beyond_500_m(tmp_path: Path) -> None:
    assert read(tmp_path, "a.csv", "lat,lon,alt\n47.37,8.54,490\n47.371,8.54,501\n") == [("absolute", 490.0), ("absolute", 501.0)]
    assert "altitudes up to 501 m" in read_waypoints(tmp_path / "a.csv").warnings[0]


def flight(kinds: tuple[HeightFrom, ...], height: float = 80.0) -> Waypoints:
    places = np.array([[47.37 + 1e-4 * k, 8.54, height + k] for k in range(len(kinds))])
    return Waypoints(names=tuple(f"w{k}" for k in range(len(kinds))), lat_lon_alt=places, counts_from=height_codes(kinds))


def flown(waypoints: Waypoints, heights: Heights | None = None, geoid_m: float | None = None) -> Route:
    return route_of("dev", waypoints, np.arange(len(waypoints)), FlownHeights(heights=heights, geoid_m=geoid_m), 8.0)


# MAV_FRAME_GLOBAL 0 (above mean sea level), _GLOBAL_RELATIVE_ALT 3 (above home), _GLOBAL_TERRAIN_ALT 10;
# AltitudeMode 1 relative, 2 absolute, 4 terrain frame.
LISTED: list[tuple[HeightFrom, tuple[int, int], str, str | None]] = [
    ("takeoff", (3, 1), "relativeToGround", "relativeToStartPoint"),
    ("ground", (10, 4), "relativeToGround", None),
    ("sea", (0, 2), "absolute", "WGS84"),
    ("ellipsoid", (0, 2), "absolute", "WGS84"),
]


@pytest.mark.parametrize(("kind", "frame", "mode", "executed"), LISTED)
def test_lists_keep_what_heights_count_from(kind: HeightFrom, frame: tuple[int, int], mode: str, executed: str | None) -> None:
    route = flown(flight((kind, kind)), geoid_m=47.0)
    from_the_sea = np.array([80.0, 81.0]) - (47.0 if kind == "ellipsoid" else 0.0)
    items = [item for item in json.loads(qgc_plan(route))["mission"]["items"] if item["command"] == 16]
    assert [(item["frame"], item["AltitudeMode"], item["Altitude"]) for item in items] == [(*frame, height) for height in from_the_sea]
    text = kml_route(route).decode()
    assert text.count(f"<altitudeMode>{mode}</altitudeMode>") == 2 and f",{from_the_sea[0]:.3f}<" in text
    assert (
        route.heights_text in text and {"sea": "above sea level", "ground": "above the ground below each point"}.get(kind, "above") in text
    )
    assert ("KML has no mode for that" in text) == (kind == "takeoff")
    if executed is None:
        with pytest.raises(BadInput, match="give --heights takeoff where the ground is level, or write another format"):
            wpml_kmz(route)
        return
    with zipfile.ZipFile(io.BytesIO(wpml_kmz(route))) as archive:
        lines, template = (ElementTree.fromstring(archive.read(f"wpmz/{name}")) for name in ("waylines.wpml", "template.kml"))
        assert route.heights_text in archive.read("wpmz/waylines.wpml").decode()
    assert lines.findtext(".//w:executeHeightMode", None, NS) == executed
    above_ellipsoid = np.array([80.0, 81.0]) + (47.0 if kind == "sea" else 0.0)
    assert [float(height.text or "") for height in lines.findall(".//w:executeHeight", NS)] == above_ellipsoid.tolist()
    assert [float(height.text or "") for height in template.findall(".//w:height", NS)] == from_the_sea.tolist()


def test_what_a_list_would_need_a_geoid_for_is_refused_without_it() -> None:
    for kind, writers in (("ellipsoid", (qgc_plan, kml_route, wpml_kmz)), ("sea", (wpml_kmz,))):
        for write in writers:
            with pytest.raises(BadInput, match="give --geoid with the metres"):
                write(flown(flight((kind, kind))))
    for write in (qgc_plan, kml_route, wpml_kmz):
        with pytest.raises(BadInput, match="nothing says whether the altitudes count from the sea or the ellipsoid"):
            write(flown(flight(("absolute", "absolute")), geoid_m=47.0))
    with pytest.raises(BadInput, match="expected how far the sea's level lies above the WGS84 ellipsoid"):
        FlownHeights(geoid_m=455.0)


def test_kinds_are_mixed_where_the_format_can_and_refused_elsewhere() -> None:
    route = flown(flight(("takeoff", "ground", "sea")))
    mission = json.loads(qgc_plan(route))["mission"]
    assert [item["frame"] for item in mission["items"] if item["command"] == 16] == [3, 10, 0] and mission["globalPlanAltitudeMode"] == 0
    modes = [part.split("<")[0] for part in kml_route(route).decode().split("<altitudeMode>")[1:]]
    assert modes == ["relativeToGround", "relativeToGround", "absolute"]
    with pytest.raises(BadInput, match="above take-off and above the ground below each point and above sea level"):
        wpml_kmz(route)


def test_no_list_flies_at_a_height_that_is_not_known() -> None:
    with pytest.raises(BadInput, match="1 of 2 waypoints have no height to fly at, 'w1' first: give --height with metres above take-off"):
        flown(flight(("takeoff", "unknown")))
    with pytest.raises(BadInput, match="give --ground, or --height"):
        flown(flight(("sea", "sea")), "takeoff")
    assert flown(flight(("unknown", "unknown")).at_height(80.0)).heights_m.tolist() == [80.0, 80.0]


@pytest.mark.parametrize(
    ("height", "limits", "told"),
    [
        (80.0, HeightLimits(), None),
        (119.0, HeightLimits(), None),
        (
            119.5,
            HeightLimits(),
            "1 of 2 heights are more than 120 m above take-off or ground, 'w1' first with 120.5 m.*give --max-height 121",
        ),
        (455.5, HeightLimits(), "are they feet, or from the sea.*give --max-height 457.*--ground.*or --height"),
        (455.5, HeightLimits(highest_m=457.0), None),
        (-1.0, HeightLimits(), "2 of 2 heights are not above take-off or ground, 'w0' first with -1 m.*give --min-height -1"),
        (0.0, HeightLimits(), "1 of 2 heights are not above take-off or ground, 'w0' first with 0 m"),
        (-1.0, HeightLimits(lowest_m=-1.0), None),
        (-1.0, HeightLimits(lowest_m=-0.5), "1 of 2 heights are below -0.5 m"),
    ],
)
def test_heights_beyond_what_is_usual_are_flown_only_when_asked_for(height: float, limits: HeightLimits, told: str | None) -> None:
    for kind in ("takeoff", "ground"):
        waypoints = replace(flight((kind, kind), height), limits=limits)
        if told is None:
            assert flown(waypoints).heights_m.tolist() == [height, height + 1]
        else:
            with pytest.raises(BadInput, match=told):
                flown(waypoints)


def test_heights_over_known_ground_are_held_to_the_limits_too() -> None:
    high = flight(("sea", "sea"), 455.5)
    assert flown(high).heights_m.tolist() == [455.5, 456.5], "how high that is above the ground nobody knows"
    assert flown(high.with_ground(400.0)).heights_m.tolist() == [55.5, 56.5]
    with pytest.raises(BadInput, match="more than 120 m above take-off or ground"):
        flown(high.with_ground(300.0))
    for kinds in (("ground", "ground"), ("sea", "takeoff"), ("unknown", "unknown")):
        with pytest.raises(BadInput, match="--ground is the altitude of the ground among those of the waypoints, and these are"):
            flight(kinds).with_ground(400.0)


def test_limits_and_heights_are_numbers_in_order() -> None:
    for lowest, highest in ((10.0, 5.0), (None, -3.0), (float("nan"), 120.0), (None, float("inf"))):
        with pytest.raises(BadInput, match="expected numbers that rise"):
            HeightLimits(lowest_m=lowest, highest_m=highest)
    with pytest.raises(BadInput, match="--height is nan, expected metres above take-off"):
        flight(("takeoff", "takeoff")).at_height(float("nan"))


def test_a_table_of_mixed_kinds_comes_back(tmp_path: Path) -> None:
    from radiant_core.export.plan import COLUMNS, save_device_waypoints
    from radiant_core.io.records import load_plan_file, save_plan
    from tests.core.io.test_plan_export import planned

    kinds = tuple(HEIGHT_KINDS[index % len(HEIGHT_KINDS)] for index in range(30))
    made, cloud, edges = planned(count=30)
    limits = HeightLimits(highest_m=150.0)
    waypoints = replace(made, lat_lon_alt=made.lat_lon_alt - [0, 0, 350.0], counts_from=height_codes(kinds), limits=limits)
    save_device_waypoints(tmp_path, cloud, edges, waypoints)
    seen = 0
    for plan in edges:
        for device in plan.device_ids:
            rows = np.sort(plan.cameras_of(device))
            if not len(rows):
                continue
            back = read_waypoints(tmp_path / f"{device}.csv").waypoints
            assert [HEIGHT_KINDS[code] for code in back.height_codes] == [kinds[row] for row in rows]
            known = ~waypoints.counting_from("unknown")[rows]
            np.testing.assert_allclose(back.lat_lon_alt[known, 2], waypoints.lat_lon_alt[rows[known], 2], atol=5.1e-4)
            with (tmp_path / f"{device}.csv").open(newline="") as file:
                assert set(COLUMNS.values()) <= set(next(csv.reader(file)))
            seen += len(rows)
    assert seen == 30
    save_plan(tmp_path / "plan.json", cloud, edges, waypoints)
    kept = load_plan_file(tmp_path / "plan.json").waypoints
    assert kept is not None and kept.limits == limits and kept.height_codes.tolist() == waypoints.height_codes.tolist()


@pytest.mark.parametrize("speed_m_per_s", [0.5, 15.1, 30.0])
def test_a_wayline_of_dji_has_the_speeds_that_it_can(speed_m_per_s: float) -> None:
    with pytest.raises(BadInput, match="expected 1 to 15 for a DJI wayline"):
        wpml_kmz(replace(flown(flight(("takeoff", "takeoff"))), speed_m_per_s=speed_m_per_s))
