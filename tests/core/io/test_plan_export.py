"""Exported plans: flight planners read the same polygons and waypoints as were planned."""

from __future__ import annotations

import csv
import json
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from shapely.geometry import MultiPolygon, Point, Polygon, shape
from shapely.geometry.base import BaseGeometry

from radiant_core.choices import HeightFrom
from radiant_core.errors import BadInput
from radiant_core.export.plan import CSV_HEADER, land_features, save_device_waypoints, save_regions_geojson
from radiant_core.frames import geodetic_from_enu
from radiant_core.georef.crs import parse_crs
from radiant_core.io.csv_cells import cell_of_text, text_of_cell
from radiant_core.plan.borders.buffers import EdgeBuffer
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.heights import HeightLimits
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.regions.edge_sites import place_edges
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_core.plan.waypoints import Waypoints
from radiant_core.waypoints.reader import read_waypoints
from tests.core.plan.instances import random_system

Planned = tuple[Waypoints, CloudPlan, tuple[EdgePlan, ...]]


def planned(origin: tuple[float, float, float] = (47.37, 8.54, 430.0), reach_m: float = 500.0, count: int = 240) -> Planned:
    rng = np.random.default_rng(3)
    positions = rng.uniform(-1, 1, (count, 3)) * [reach_m, reach_m / 2, 10.0]
    names = tuple(f'f,"{index}" ö' for index in range(count))
    limits = HeightLimits(lowest_m=-100.0, highest_m=1e3)
    waypoints = Waypoints(names=names, lat_lon_alt=geodetic_from_enu(positions, origin), limits=limits)
    system = place_edges(random_system(rng, 3), waypoints.positions_m[:, :2], waypoints.origin, 0)
    cloud = plan_regions(waypoints.positions_m[:, :2], system)
    assert isinstance(cloud, CloudPlan)
    return waypoints, cloud, split_edges(waypoints.positions_m[:, :2], cloud, system)


def features(path: Path, kind: str) -> list[dict[str, Any]]:
    collection = json.loads(path.read_text())
    assert collection["type"] == "FeatureCollection"
    return [feature for feature in collection["features"] if feature["properties"]["kind"] == kind]


def test_a_devices_list_is_read_back_as_its_waypoints_in_order(tmp_path: Path) -> None:
    waypoints, cloud, edges = planned()
    written = save_device_waypoints(tmp_path, cloud, edges, waypoints)
    assert [path.name for path in written] == [f"{device}.csv" for plan in edges for device in plan.device_ids]
    total = 0
    for plan in edges:
        for device in plan.device_ids:
            with (tmp_path / f"{device}.csv").open(newline="", encoding="utf-8") as file:
                rows = list(csv.reader(file))
            assert tuple(rows[0]) == CSV_HEADER
            indices = np.sort(plan.cameras_of(device))
            assert len(rows) - 1 == len(indices)
            total += len(indices)
            if not len(indices):
                continue
            back = read_waypoints(tmp_path / f"{device}.csv").waypoints
            assert back.names == tuple(waypoints.names[index] for index in indices)
            # Half of the last of 9 decimals is 0.06 mm of a degree; metres have 3.
            np.testing.assert_allclose(back.lat_lon_alt, waypoints.lat_lon_alt[indices], atol=5.1e-4)
            np.testing.assert_allclose(back.lat_lon_alt[:, :2], waypoints.lat_lon_alt[indices, :2], atol=5.1e-10)
    assert total == len(waypoints)


@pytest.mark.parametrize(
    ("origin", "reach_m"),
    [((47.37, 8.54, 430.0), 500.0), ((-33.9, 151.2, 5.0), 20_000.0), ((-17.0, 180.0, 0.0), 500.0), ((64.0, -180.0, 90.0), 5000.0)],
)
def test_every_waypoint_lies_in_the_polygons_of_its_edge_and_device(
    tmp_path: Path, origin: tuple[float, float, float], reach_m: float
) -> None:
    waypoints, cloud, edges = planned(origin, reach_m)
    save_regions_geojson(tmp_path / "r.geojson", cloud, edges, waypoints)
    strips = {feature["properties"]["device"]: feature for feature in features(tmp_path / "r.geojson", "strip")}
    regions = {feature["properties"]["edge"]: feature for feature in features(tmp_path / "r.geojson", "region")}
    points = features(tmp_path / "r.geojson", "waypoint")
    assert len(points) == len(waypoints)
    # Strips end midway between cameras; a straight side in degrees may bend by 1 cm, a millionth of
    # a degree is 11 cm.
    for point in points:
        about, place = point["properties"], Point(point["geometry"]["coordinates"])
        assert shape(strips[about["device"]]["geometry"]).distance(place) < 1e-6
        assert shape(regions[about["edge"]]["geometry"]).distance(place) < 1e-6
    counts = Counter(point["properties"]["device"] for point in points)
    assert {name: feature["properties"]["cameras"] for name, feature in strips.items()} == dict(counts)
    assert [regions[edge]["properties"]["planned_s"] for edge in cloud.edge_ids if edge in regions] == [
        time_s for edge, time_s in zip(cloud.edge_ids, cloud.edge_time_s, strict=True) if edge in regions
    ]


def rings(geometry: BaseGeometry) -> list[Polygon]:
    assert isinstance(geometry, Polygon | MultiPolygon)
    return list(geometry.geoms) if isinstance(geometry, MultiPolygon) else [geometry]


@pytest.mark.parametrize("lon", [8.54, 179.999, -179.999, 180.0])
def test_polygons_follow_rfc_7946(tmp_path: Path, lon: float) -> None:
    waypoints, cloud, edges = planned((-17.0, lon, 5.0))
    save_regions_geojson(tmp_path / "r.geojson", cloud, edges, waypoints)
    region_area = 0.0
    for kind in ("region", "strip"):
        found = features(tmp_path / "r.geojson", kind)
        assert found
        for feature in found:
            for polygon in rings(shape(feature["geometry"])):
                assert polygon.is_valid
                assert polygon.exterior.is_ccw, "outer rings run counter-clockwise"
                west, south, east, north = polygon.bounds
                assert -180 <= west < east <= 180 and -90 <= south < north <= 90
                assert east - west < 0.1, "cut at the meridian, not round the globe"
                region_area += polygon.area if kind == "region" else 0.0
    # The regions tile the rectangle around the site: same area in square degrees as in metres, to
    # the bending of the ground.
    corners = np.concatenate([border for border in cloud.borders if len(border)])
    width_m, height_m = np.ptp(corners, axis=0)
    square_degree_m2 = 110_657.0 * 106_486.0  # of latitude and longitude at 17° (WGS84)
    assert region_area * square_degree_m2 == pytest.approx(width_m * height_m, rel=1e-3)


def test_long_sides_are_divided_so_that_straight_lines_stay_straight(tmp_path: Path) -> None:
    waypoints, cloud, edges = planned((60.0, 8.0, 0.0), reach_m=20_000.0)
    save_regions_geojson(tmp_path / "r.geojson", cloud, edges, waypoints)
    coordinates = np.array(features(tmp_path / "r.geojson", "region")[0]["geometry"]["coordinates"][0])
    steps_m = np.diff(coordinates, axis=0) * [111_320.0 * 0.5, 111_320.0]
    assert np.hypot(*steps_m.T).max() < 520


def test_our_own_regions_file_is_a_waypoint_file(tmp_path: Path) -> None:
    waypoints, cloud, edges = planned(count=30)
    save_regions_geojson(tmp_path / "r.geojson", cloud, edges, waypoints)
    found = read_waypoints(tmp_path / "r.geojson")
    assert sorted(found.waypoints.names) == sorted(waypoints.names)
    assert "Polygon ignored" in found.warnings[0]


@pytest.mark.parametrize("text", ["EPSG:2056", "EPSG:21781", "EPSG:32632", "EPSG:4258"])
@pytest.mark.parametrize("kind", ["ellipsoid", "takeoff", "ground", "sea"])
def test_heights_keep_what_they_count_from_in_a_system_without_a_vertical_datum(kind: HeightFrom, text: str, tmp_path: Path) -> None:
    waypoints, cloud, edges = planned(count=30)
    waypoints = replace(waypoints, counts_from=kind)
    save_regions_geojson(tmp_path / "r.geojson", cloud, edges, waypoints, crs=parse_crs(text))
    found = read_waypoints(tmp_path / "r.geojson").waypoints
    assert found.counts_from == kind
    heights = dict(zip(found.names, found.lat_lon_alt[:, 2].tolist(), strict=True))
    # Millimetres, as they are written.
    np.testing.assert_allclose([heights[name] for name in waypoints.names], waypoints.lat_lon_alt[:, 2], atol=6e-4)


def test_other_waypoints_than_the_plans_are_refused_and_nothing_is_written(tmp_path: Path) -> None:
    waypoints, cloud, edges = planned(count=30)
    for write in (
        lambda: save_device_waypoints(tmp_path, cloud, edges, waypoints.select(np.arange(29))),
        lambda: save_regions_geojson(tmp_path / "r.geojson", cloud, edges, waypoints.select(np.arange(29))),
    ):
        with pytest.raises(BadInput, match="plan is of 30 cameras, there are 29"):
            write()
    assert list(tmp_path.iterdir()) == []


def test_a_triangle_is_land_and_less_is_none() -> None:
    _, cloud, edges = planned()
    triangle = np.array([[0.0, 0.0], [100.0, 0.0], [0.0, 100.0]])
    for border, has_land in ((triangle, True), (triangle[:2], False)):
        own = replace(cloud, borders=(border, *cloud.borders[1:]))
        names = [feature["properties"]["name"] for feature in land_features(own, edges, np.array([47.0, 8.0, 400.0]))]
        assert (cloud.edge_ids[0] in names) is has_land


def test_an_edge_that_deals_itself_gets_the_list_of_all_its_waypoints(tmp_path: Path) -> None:
    waypoints, cloud, edges = planned()
    late = replace(
        edges[0], device_ids=(), device_of_camera=np.full(len(edges[0].camera_indices), -1), strips=(), device_time_s=[], dealt=False
    )
    written = save_device_waypoints(tmp_path, cloud, (late, *edges[1:]), waypoints)
    assert written[0] == tmp_path / "edges" / f"{late.edge_id}.csv"
    assert read_waypoints(written[0]).waypoints.names == tuple(waypoints.names[index] for index in np.sort(late.camera_indices))


def test_every_feature_says_exactly_what_it_is_and_no_digit_too_many(tmp_path: Path) -> None:
    waypoints, cloud, edges = planned(count=30)
    buffer = EdgeBuffer(
        edge_id=edges[0].edge_id,
        device_ids=edges[0].device_ids,
        camera_indices=edges[1].camera_indices[:2],
        device_of_camera=np.zeros(2, np.int64),
        device_time_s=np.zeros(len(edges[0].device_ids)),
        edge_time_s=1.0,
        planned_edge_time_s=1.0,
        num_refused=0,
    )
    save_regions_geojson(tmp_path / "r.geojson", cloud, edges, replace(waypoints, counts_from="ellipsoid"), [buffer])
    lines = (tmp_path / "r.geojson").read_text().splitlines()
    assert lines[0] == '{"type": "FeatureCollection", "features": [' and lines[-1] == "]}"
    assert all(line.endswith(",") for line in lines[1:-2]) and not lines[-2].endswith(","), "a feature a line"
    regions, strips, points, buffers = (features(tmp_path / "r.geojson", kind) for kind in ("region", "strip", "waypoint", "buffer"))
    counts = dict(zip(cloud.edge_ids, cloud.counts.tolist(), strict=True))
    times = dict(zip(cloud.edge_ids, cloud.edge_time_s.tolist(), strict=True))
    for feature in regions:
        name = feature["properties"]["name"]
        about = {"kind": "region", "name": name, "edge": name, "cameras": counts[name], "planned_s": times[name]}
        assert feature["properties"] == about and feature["type"] == "Feature"
    by_device = {device: (plan, index) for plan in edges for index, device in enumerate(plan.device_ids)}
    assert strips
    for feature in strips:
        name = feature["properties"]["name"]
        plan, index = by_device[name]
        about = {"kind": "strip", "name": name, "edge": plan.edge_id, "device": name, "cameras": len(plan.cameras_of(name))}
        assert feature["properties"] == {**about, "planned_s": plan.device_time_s[index]}
    for feature in points:
        plan, index = by_device[feature["properties"]["device"]]
        assert feature["properties"].keys() == {"kind", "name", "edge", "device"} and feature["properties"]["edge"] == plan.edge_id
    taken = [waypoints.names[camera] for camera in buffer.camera_indices]
    assert [feature["properties"] for feature in buffers] == [
        {"kind": "buffer", "name": name, "edge": buffer.edge_id, "device": buffer.device_ids[0]} for name in taken
    ]
    for feature in [*points, *buffers]:
        lon, lat, alt = feature["geometry"]["coordinates"]
        place = waypoints.lat_lon_alt[waypoints.names.index(feature["properties"]["name"])]
        assert (round(lon, 9), round(lat, 9), round(alt, 3)) == (lon, lat, alt)
        assert (np.abs(np.array([lat, lon, alt]) - place) <= [5.1e-10, 5.1e-10, 5.1e-4]).all()
    for feature in [*regions, *strips]:
        rings = np.array(feature["geometry"]["coordinates"][0])
        np.testing.assert_array_equal(rings, np.round(rings, 9))
        assert (np.abs(rings * 1e8 - np.rint(rings * 1e8)) > 0.05).any(), "and none too few"


def test_lists_say_where_the_camera_looks_and_whose_a_waypoint_is(tmp_path: Path) -> None:
    waypoints, cloud, edges = planned(count=30)
    looks = np.column_stack([np.arange(30.0) + 0.12345, np.where(np.arange(30) % 2, np.nan, -45.0)])
    aimed = replace(waypoints, heading_pitch_deg=looks)
    plan = edges[0]
    other = edges[1].camera_indices[:1]
    buffer = EdgeBuffer(
        edge_id=plan.edge_id, device_ids=plan.device_ids, camera_indices=other, device_of_camera=np.zeros(1, np.int64),
        device_time_s=np.zeros(len(plan.device_ids)), edge_time_s=1.0, planned_edge_time_s=1.0, num_refused=0,
    )  # fmt: skip
    only = np.ones(30, bool)
    only[plan.cameras_of(plan.device_ids[0])[:1]] = False
    save_device_waypoints(tmp_path, cloud, edges, aimed, [buffer], only=only)
    own = plan.cameras_of(plan.device_ids[0])
    text = (tmp_path / f"{plan.device_ids[0]}.csv").read_bytes().decode()
    assert text.endswith("\r\n") and text.count("\r\n") == text.count("\n"), "RFC 4180"
    rows = list(csv.reader(text.splitlines()))
    assert rows[0] == ["latitude", "longitude", "altitude(m)", "name", "heading(deg)", "gimbalpitchangle", "role"]
    wanted = sorted([*own[only[own]].tolist(), *other.tolist()])
    assert [row[3] for row in rows[1:]] == [waypoints.names[index] for index in wanted]
    assert [row[4:] for row in rows[1:]] == [
        [f"{looks[index, 0]:.3f}", "" if index % 2 else "-45.000", "buffer" if index in other else "own"] for index in wanted
    ]
    for row, index in zip(rows[1:], wanted, strict=True):
        assert row[:3] == [f"{value:.{digits}f}" for value, digits in zip(waypoints.lat_lon_alt[index], (9, 9, 3), strict=True)]
    rows = list(csv.reader((tmp_path / f"{edges[1].device_ids[0]}.csv").read_text().splitlines()))
    assert len(rows[0]) == 6, "an edge without buffers needs no roles"


def lists_of(folder: Path, waypoints: Waypoints) -> tuple[list[str], Waypoints, np.ndarray]:
    """Header of the first device's list, the list as our reader returns it, and its waypoints."""
    _, cloud, edges = planned(count=len(waypoints))
    folder.mkdir()
    save_device_waypoints(folder, cloud, edges, waypoints)
    path = folder / f"{edges[0].device_ids[0]}.csv"
    return path.read_text().split("\n")[0].split(","), read_waypoints(path).waypoints, np.sort(edges[0].cameras_of(edges[0].device_ids[0]))


def test_what_planners_fly_as_height_above_take_off_is_one(tmp_path: Path) -> None:
    waypoints = planned(count=30)[0]
    altitudes = waypoints.lat_lon_alt[:, 2]
    assert 410 < altitudes.min() < altitudes.max() < 450, "as GPS says them of a flight some 20 m over Zurich"
    header, back, own = lists_of(tmp_path / "taken", replace(waypoints, counts_from="absolute"))
    assert header == ["latitude", "longitude", "altitude_absolute(m)", "name"], "no column that is flown as height above take-off"
    np.testing.assert_allclose(back.lat_lon_alt[:, 2], altitudes[own], atol=5.1e-4)
    assert back.absolute and back.heights_m is None
    header, back, own = lists_of(tmp_path / "ground", replace(waypoints, counts_from="absolute", ground_m=405.0))
    assert header == ["latitude", "longitude", "altitude(m)", "name", "altitude_absolute(m)"]
    np.testing.assert_allclose(back.lat_lon_alt[:, 2], altitudes[own] - 405, atol=5.1e-4)
    assert not back.absolute and back.heights_m is not None
    text = (tmp_path / "ground" / f"{planned(count=30)[2][0].device_ids[0]}.csv").read_text().splitlines()[1:]
    np.testing.assert_allclose([float(line.split(",")[-1]) for line in text], altitudes[own], atol=5.1e-4)
    flown = replace(waypoints, lat_lon_alt=waypoints.lat_lon_alt - [0, 0, 350.0])
    header, back, own = lists_of(tmp_path / "planned", flown)
    assert header == list(CSV_HEADER) and not back.absolute
    np.testing.assert_allclose(back.lat_lon_alt[:, 2], altitudes[own] - 350, atol=5.1e-4)
    for name, moved_m in (("high", 0.0), ("low", -440.0)):
        unasked = replace(waypoints, lat_lon_alt=waypoints.lat_lon_alt - [0, 0, -moved_m], limits=HeightLimits())
        header, back, _ = lists_of(tmp_path / name, unasked)
        assert header == ["latitude", "longitude", "name"] and not back.altitude_known, "nobody asked for 430 m, nor for below take-off"


FORMULAS = (
    *("=cmd|' /C calc'!A0", "+1+1", "-2", "@SUM(A1)", "a;=1+1", "a;'=1", "'=1", "''=1", "a,=1"),
    *("\uff1d1", "=", ";-", "a;;+b", "plain", "'plain"),
)


def test_names_are_no_formulas_in_a_spreadsheet_and_come_back(tmp_path: Path) -> None:
    assert len({cell_of_text(name) for name in FORMULAS}) == len(FORMULAS)
    assert [text_of_cell(cell_of_text(name)) for name in FORMULAS] == list(FORMULAS)
    waypoints, cloud, edges = planned(count=30)
    waypoints = replace(waypoints, names=(*FORMULAS, *waypoints.names[len(FORMULAS) :]))
    save_device_waypoints(tmp_path, cloud, edges, waypoints)
    found: list[str] = []
    for path in (tmp_path / f"{device}.csv" for plan in edges for device in plan.device_ids if len(plan.cameras_of(device))):
        for delimiter in ",;":  # which of them separates cells is up to the country
            for row in csv.reader(path.read_text().splitlines()[1:], delimiter=delimiter):
                assert not [cell for cell in row if cell[:1] in "=+-@\uff1d" and cell and not is_number(cell)], row
        found += read_waypoints(path).waypoints.names
    assert sorted(found) == sorted(waypoints.names)


def is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def test_two_edges_that_deal_themselves_share_a_folder_and_their_points_name_no_device(tmp_path: Path) -> None:
    waypoints, cloud, edges = planned(count=30)
    late = [
        replace(plan, device_ids=(), device_of_camera=np.full(len(plan.camera_indices), -1), strips=(), device_time_s=[], dealt=False)
        for plan in edges
    ]
    save_device_waypoints(tmp_path, cloud, late, waypoints)
    assert {path.name for path in (tmp_path / "edges").iterdir()} == {f"{plan.edge_id}.csv" for plan in late}
    save_regions_geojson(tmp_path / "r.geojson", cloud, late, replace(waypoints, counts_from="unknown"))
    assert all(feature["properties"].keys() == {"kind", "name", "edge"} for feature in features(tmp_path / "r.geojson", "waypoint"))


def test_a_polygon_across_the_180th_meridian_is_cut_there_and_one_that_touches_it_is_not() -> None:
    _, cloud, edges = planned()
    for lon, east_m, parts in (
        (180.0, (-1000.0, 1000.0), 2),
        (-180.0, (-1000.0, 1000.0), 2),
        (180.0, (-1000.0, 0.0), 1),
        (-180.0, (0.0, 1000.0), 1),
    ):
        west, east = east_m
        square = np.array([[west, 0.0], [east, 0.0], [east, 500.0], [west, 500.0]])
        own = replace(cloud, borders=(square, *cloud.borders[1:]))
        geometry = next(land_features(own, edges, np.array([0.0, lon, 0.0])))["geometry"]
        found = shape(geometry)
        assert geometry["type"] == ("Polygon" if parts == 1 else "MultiPolygon") and len(rings(found)) == parts
        # A degree of longitude at the equator is 111,319.49 m, one of latitude 110,574.3 m (WGS84).
        assert found.area == pytest.approx((east - west) / 111319.49 * 500 / 110574.3, rel=1e-5)


@pytest.mark.parametrize(
    ("pole", "away_deg", "reach_m"), [(-90.0, 0.0, 100.0), (-90.0, 0.0009, 100.0), (90.0, 0.003, 100.0), (-90.0, 0.003, 20_000.0)]
)
def test_regions_at_a_pole_are_polygons_that_hold_their_waypoints(tmp_path: Path, pole: float, away_deg: float, reach_m: float) -> None:
    waypoints, cloud, edges = planned((pole - np.copysign(away_deg, pole), 30.0, 0.0), reach_m, count=60)
    save_regions_geojson(tmp_path / "r.geojson", cloud, edges, waypoints)
    regions = {feature["properties"]["edge"]: shape(feature["geometry"]) for feature in features(tmp_path / "r.geojson", "region")}
    for region in regions.values():
        west, south, east, north = region.bounds
        assert region.is_valid and region.area > 0 and -180 <= west < east <= 180 and -90 <= south < north <= 90
    held = [
        regions[point["properties"]["edge"]].distance(Point(point["geometry"]["coordinates"][:2]))
        for point in features(tmp_path / "r.geojson", "waypoint")
    ]
    # In degrees; sides are straight in metres and cut only every 500 m, which turns far beside a
    # pole.
    assert np.mean(np.array(held) < 1e-6) > 0.9
