"""Coordinate systems against pyproj, there and back, with a datum of heights, and what is refused."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from pyproj import CRS, Transformer

from radiant_core.errors import BadInput
from radiant_core.georef.crs import parse_crs

ZURICH = np.array([[47.37, 8.54, 430.0], [47.38, 8.56, 512.5]])


@pytest.mark.parametrize("text", ["EPSG:32632", "32632", "epsg:2056", "EPSG:25832", "EPSG:3857", "EPSG:4326"])
def test_places_agree_with_pyproj_and_come_back(text: str) -> None:
    crs = parse_crs(text)
    code = text if ":" in text else f"EPSG:{text}"
    lat, lon, alt = ZURICH.T
    expected = np.column_stack(Transformer.from_crs("EPSG:4979", code, always_xy=True).transform(lon, lat, alt))
    places = crs.from_geodetic(ZURICH)
    # 1e-6 m: our own series is within 0.2 µm of PROJ; degrees agree to the bit.
    assert np.abs(places - expected).max() < 1e-6
    assert np.abs(crs.to_geodetic(places) - ZURICH).max() < 1e-6


@pytest.mark.parametrize(
    ("text", "epsg"),
    [
        ("WGS84 UTM 32N", 32632),
        ("WGS 84 / UTM zone 33S", 32733),
        ("+proj=utm +zone=32 +ellps=WGS84 +datum=WGS84 +units=m +no_defs", 32632),
        ("+proj=utm +zone=10 +south +datum=WGS84 +units=m", 32710),
    ],
)
def test_the_names_of_odm_are_zones_of_our_own(text: str, epsg: int) -> None:
    crs = parse_crs(text)
    assert (crs.is_builtin, crs.horizontal_epsg, crs.unit) == (True, epsg, "metre")


def test_a_zone_in_wkt_is_the_zone(tmp_path: Path) -> None:
    for epsg in (32632, 32733):
        assert CRS.from_wkt(parse_crs(f"EPSG:{epsg}").wkt()).to_epsg() == epsg
    assert CRS.from_wkt(parse_crs("EPSG:2056").wkt()).to_epsg(min_confidence=60) == 2056
    wkt = CRS.from_epsg(2056).to_wkt()
    assert parse_crs(" ".join(wkt.split())).horizontal_epsg == 2056


def test_heights_over_a_geoid_are_lower_by_its_undulation(tmp_path: Path) -> None:
    grid = tmp_path / "geoid.gtx"
    rows, columns, undulation_m = 5, 5, 48.25
    header = struct.pack(">4d2i", 45.0, 6.0, 1.0, 1.0, rows, columns)
    grid.write_bytes(header + struct.pack(f">{rows * columns}f", *[undulation_m] * (rows * columns)))
    crs = parse_crs(f"+proj=utm +zone=32 +datum=WGS84 +units=m +geoidgrids={grid} +vunits=m +no_defs +type=crs")
    places = crs.from_geodetic(ZURICH)
    np.testing.assert_allclose(places[:, 2], ZURICH[:, 2] - undulation_m, atol=1e-5)  # the grid is float32
    np.testing.assert_allclose(places[:, :2], parse_crs("EPSG:32632").from_geodetic(ZURICH)[:, :2], atol=1e-6)
    assert np.abs(crs.to_geodetic(places) - ZURICH).max() < 1e-6


def test_a_datum_of_heights_without_its_grid_is_refused_by_the_grids_name() -> None:
    crs = parse_crs("EPSG:32632+5773")
    assert (crs.horizontal_epsg, crs.vertical_epsg) == (32632, 5773)
    with pytest.raises(BadInput, match=r"needs the grid us_nga_egm96_15.tif, which is not installed: get it with `pyproj sync"):
        crs.from_geodetic(ZURICH)


@pytest.mark.parametrize(
    "text", ["", "EPSG:99999", "Switzerland", "EPSG:", "WGS84 UTM 61N", "+proj=nothing", "EPSG:5773", "PROJCS[broken", "a\0b"]
)
def test_what_names_no_plane_is_refused(text: str) -> None:
    with pytest.raises(BadInput):
        parse_crs(text)


@pytest.mark.parametrize("place", [[np.nan, 0, 0], [np.inf, 0, 0], [47.37, 8.54, 400.0], [5.2e6, 4.6e5, 0]])
def test_what_is_no_place_of_the_zone_is_refused(place: list[float]) -> None:
    with pytest.raises(BadInput):
        parse_crs("EPSG:32632").to_geodetic([place])


def test_places_outside_of_a_system_are_refused() -> None:
    with pytest.raises(BadInput):
        parse_crs("EPSG:2056").from_geodetic([[-89.0, 170.0, 0.0]])
    with pytest.raises(BadInput):
        parse_crs("EPSG:32632").from_geodetic([[47.0, 60.0, 0.0]])
