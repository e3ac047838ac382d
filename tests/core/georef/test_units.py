"""Feet, links and kilometres: a metre up is as long as a metre east, in files and on the way in."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.frames import Frame, enu_from_geodetic, geodetic_from_enu
from radiant_core.georef.control_list import parse_control_list, world_places
from radiant_core.georef.control_points import ControlRequest, parse_control
from radiant_core.georef.crs import Crs, parse_crs
from radiant_core.georef.features import crs_member, in_crs
from radiant_core.georef.reference import georeference, map_offset
from radiant_core.georef.sidecar import save_sidecar
from radiant_core.waypoints.geojson_reader import geojson_rows
from tests.core.georef.published_points import FEET_M
from tests.core.scenes import ground_splats

NEW_YORK, TOBAGO, ACCRA = (40.70, -74.0), (10.5, -61.4), (6.0, -1.0)
UNITS = [
    ("EPSG:2263", NEW_YORK, "US survey foot"),
    ("EPSG:6539", NEW_YORK, "US survey foot"),
    ("EPSG:2223", (33.4, -112.0), "foot"),
    ("EPSG:30200", TOBAGO, "Clarke's link"),
    ("EPSG:2136", ACCRA, "Gold Coast foot"),
    ("+proj=utm +zone=18 +datum=WGS84 +units=us-ft", NEW_YORK, "US survey foot"),
    ("+proj=utm +zone=18 +datum=WGS84 +units=ft", NEW_YORK, "foot"),
    ("+proj=utm +zone=18 +datum=WGS84 +units=km", NEW_YORK, "kilometre"),
    ("+proj=utm +zone=18 +datum=WGS84 +units=us-ft +vunits=us-ft", NEW_YORK, "US survey foot"),
]


def frame_at(place: tuple[float, float]) -> Frame:
    return Frame(kind="metric", origin_lat_lon_alt=np.array([*place, 30.0]), residual_m=0.1)


@pytest.mark.parametrize(("text", "place", "unit"), UNITS)
def test_a_hundred_metres_are_as_long_up_as_east(text: str, place: tuple[float, float], unit: str) -> None:
    crs, frame = parse_crs(text), frame_at(place)
    assert crs.height_unit == unit and crs.height_unit_m == pytest.approx(FEET_M[unit], rel=1e-9)
    reference = georeference(frame, crs)
    corners = reference.apply(np.array([[0.0, 0, 0], [100, 0, 0], [0, 100, 0], [0, 0, 100]]))
    lengths = np.linalg.norm(corners[1:] - corners[0], axis=1) * FEET_M[unit]
    # 0.1 %: these projections stretch the plane by 4e-4 at most, heights not at all.
    np.testing.assert_allclose(lengths, 100, rtol=1e-3)
    assert lengths[2] == pytest.approx(100, rel=1e-7)  # differences of coordinates of 1e7
    assert corners[0, 2] * FEET_M[unit] == pytest.approx(30, rel=1e-9)


@pytest.mark.parametrize(("text", "place", "unit"), UNITS)
def test_gaussians_keep_their_size_in_metres(text: str, place: tuple[float, float], unit: str) -> None:
    splats = ground_splats(half_side_m=30.0)
    moved = georeference(frame_at(place), parse_crs(text)).move(splats)
    ratio = np.exp(moved.log_scales.astype(np.float64) - splats.log_scales) * FEET_M[unit]
    assert np.abs(ratio - 1).max() < 1e-3  # UTM's 4e-4, float32


@pytest.mark.parametrize(("text", "place", "unit"), UNITS)
def test_what_stands_beside_a_file_names_the_unit_of_heights(text: str, place: tuple[float, float], unit: str, tmp_path: Path) -> None:
    reference = georeference(frame_at(place), parse_crs(text))
    record = json.loads(save_sidecar(tmp_path / "a.ply", reference)[0].read_text())
    assert (record["unit"], record["height_unit"]) == (unit, unit) and unit in record["heights"]
    assert record["unit_m"] == record["height_unit_m"] == pytest.approx(FEET_M[unit])
    assert f"units {unit}, heights {unit}" in reference.comments()


@pytest.mark.parametrize(("text", "place", "unit"), UNITS)
def test_ground_control_is_read_in_the_unit_of_its_system(text: str, place: tuple[float, float], unit: str) -> None:
    truth = np.array([[0.0, 0, 0], [40, 0, 10], [0, 30, -5]])
    origin = np.array([*place, 171.6640])
    # The plane by our own map, which the tests above prove; heights by the definition of the unit.
    plane = parse_crs(text).from_geodetic(geodetic_from_enu(truth, origin))[:, :2]
    ups = geodetic_from_enu(truth, origin)[:, 2] / FEET_M[unit]
    written = [" ".join(repr(float(value)) for value in (*flat, up)) for flat, up in zip(plane, ups, strict=True)]
    lines = [f"{place_of} 1 2 a.jpg p{row}" for row, place_of in enumerate(written)]
    control = parse_control(ControlRequest(text="\n".join([text, *lines]), source="gcp_list.txt"))
    assert control.origin_lat_lon_alt is not None
    # 1e-3 m: the list's plane touches the globe in its own middle, 20 m off.
    np.testing.assert_allclose(control.places_m - control.places_m[0], truth - truth[0], atol=1e-3)
    assert geodetic_from_enu(control.places_m[:1], control.origin_lat_lon_alt)[0, 2] == pytest.approx(171.664, abs=1e-4)
    table = parse_control_list("\n".join([text, *(f"p{row} {place_of}" for row, place_of in enumerate(written))]), "points.txt")
    expected = enu_from_geodetic(geodetic_from_enu(truth, origin), [*place, 30.0])
    # 5e-3 m: PROJ's shift of a datum leaves heights as they are, so the way back is not quite the same.
    np.testing.assert_allclose(world_places(table, frame_at(place)), expected, atol=5e-3)


def test_a_height_of_563_199_feet_is_171_664_metres() -> None:
    # 563.199 · 1200/3937 by hand.
    assert parse_crs("EPSG:2263").to_geodetic([[984250.0, 194305.0, 563.199]])[0, 2] == pytest.approx(171.6634, abs=5e-4)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("EPSG:2263+5703", "counts the plane in units of 1 US survey foot and heights in units of 1 metre"),
        ("EPSG:26918+6360", "counts the plane in units of 1 metre and heights in units of 1 US survey foot"),
        ("EPSG:2263+8228", "us_noaa"),
        ("EPSG:2263+6360", "us_noaa_g1999u08.tif and us_noaa_nadcon5_nad83_1986_nad83_harn_conus.tif"),
        ("+proj=utm +zone=18 +datum=WGS84 +units=m +vunits=us-ft", "name a vertical datum in units of 1 metre"),
        ("EPSG:4269", "degrees"),
        ("EPSG:3857", "stretches a model by 1.32"),
        ("EPSG:32618+5715", "count downwards"),
    ],
)
def test_a_model_is_not_pressed_into_a_system(text: str, said: str) -> None:
    with pytest.raises(BadInput, match=re.escape(said)):
        georeference(frame_at(NEW_YORK), parse_crs(text))


@pytest.mark.parametrize(("text", "place", "said"), [("EPSG:4807", (48.8, 2.3), "counts in grads"), ("EPSG:5513", (50.0, 15.0), "mirrors")])
def test_grads_and_mirrored_axes_are_no_model(text: str, place: tuple[float, float], said: str) -> None:
    with pytest.raises(BadInput, match=said):
        georeference(frame_at(place), parse_crs(text))


def test_vertical_datums_have_their_own_units() -> None:
    # EPSG dataset: 5703 NAVD88 height in metres, 6360 in US survey feet, 8228 in feet.
    units = {text: parse_crs(f"EPSG:2263+{text}").height_unit for text in ("5703", "6360", "8228")}
    assert units == {"5703": "metre", "6360": "US survey foot", "8228": "foot"}


def test_westings_and_southings_are_named(tmp_path: Path) -> None:
    reference = georeference(frame_at((-26.0, 28.0)), parse_crs("EPSG:2053"))
    assert reference.record()["axes"] == ["west", "south", "up"]
    east, west = reference.apply(np.array([[10.0, 0, 0], [-10, 0, 0]]))
    assert west[0] - east[0] == pytest.approx(20, rel=1e-3)


@pytest.mark.parametrize(("unit_m", "step"), [(1.0, 100.0), (0.3048, 100.0), (0.2012, 100.0), (20.1168, 1.0), (1000.0, 0.1)])
def test_offsets_are_round_numbers_of_some_hundred_metres(unit_m: float, step: float) -> None:
    offset = map_offset(np.array([583_960.7, 4_507_523.2, 12.0]), unit_m)
    assert offset[2] == 0 and np.abs(offset / step - np.round(offset / step)).max() < 1e-6
    assert (np.array([583_960.7, 4_507_523.2]) - offset[:2] < step).all()


def test_geojson_keeps_feet_there_and_back_and_names_both_parts() -> None:
    point = {"type": "Feature", "properties": {}, "geometry": {"type": "Point", "coordinates": [-74.0, 40.7, 100.0]}}
    crs = parse_crs("EPSG:2263")
    (moved,) = in_crs([point], crs)
    assert moved["geometry"]["coordinates"][2] == pytest.approx(100 * 3937 / 1200, abs=5e-4)
    rows = geojson_rows(json.dumps({"type": "FeatureCollection", "features": [moved], "crs": crs_member(crs)}))
    np.testing.assert_allclose(rows.lat_lon_alt, [[40.7, -74.0, 100.0]], atol=3e-4)  # written to a thousandth of a foot
    assert rows.shortfall is not None and "us_noaa_njhpgn.tif" in rows.shortfall


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("EPSG:2056", "urn:ogc:def:crs:EPSG::2056"),
        ("EPSG:2263+6360", "urn:ogc:def:crs,crs:EPSG::2263,crs:EPSG::6360"),
        ("EPSG:7415", "urn:ogc:def:crs,crs:EPSG::28992,crs:EPSG::5709"),
    ],
)
def test_a_compound_system_keeps_its_vertical_part_in_geojson(text: str, name: str) -> None:
    import rasterio.crs
    from pyproj import CRS

    member = crs_member(parse_crs(text))
    assert member["properties"]["name"] == name
    # What GDAL (3.10) and PROJ read of it.
    compound = name.count("crs:EPSG") == 2
    assert CRS.from_user_input(name).is_compound == compound
    assert ("VERT" in rasterio.crs.CRS.from_user_input(name).to_wkt()) == compound
    if compound:
        point = {"type": "Point", "coordinates": [121687.0, 487484.0, 5.0], "crs": member}
        with pytest.raises(BadInput, match=r"\.tif"):
            geojson_rows(json.dumps(point))


def test_geojson_names_no_unit_of_heights_that_a_code_does_not_say() -> None:
    with pytest.raises(BadInput, match="code 32618, which says nothing of heights in units of 1 US survey foot"):
        crs_member(parse_crs("+proj=utm +zone=18 +datum=WGS84 +units=m +vunits=us-ft"))
    assert crs_member(parse_crs("EPSG:4937"))["properties"]["name"] == "urn:ogc:def:crs:EPSG::4937"


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("urn:ogc:def:crs,crs:OGC:1.3:CRS84,crs:EPSG::5773", "EPSG:4326+5773 needs the grid us_nga_egm96_15.tif"),
        ("EPSG:2056+ESRI:115700", "expected WGS84 longitude and latitude, or one by its EPSG code"),
        ("urn:ogc:def:crs,crs:EPSG::2263,crs:ESRI::115700", "expected WGS84 longitude and latitude, or one by its EPSG code"),
    ],
)
def test_no_part_of_a_compound_system_is_dropped(name: str, said: str) -> None:
    member = {"type": "name", "properties": {"name": name}}
    with pytest.raises(BadInput, match=re.escape(said)):
        geojson_rows(json.dumps({"type": "Point", "coordinates": [8.5, 47.3, 500.0], "crs": member}))


def test_geojson_digits_hold_a_millimetre_in_any_unit() -> None:
    point = {"type": "Feature", "properties": {}, "geometry": {"type": "Point", "coordinates": [-74.0, 40.7, 100.0]}}
    kilometres: Crs = parse_crs("+proj=utm +zone=18 +datum=WGS84 +units=km")
    (moved,) = in_crs([point], kilometres)
    expected = kilometres.from_geodetic([[40.7, -74.0, 100.0]])[0]
    np.testing.assert_allclose(moved["geometry"]["coordinates"], expected, atol=5.1e-7)
