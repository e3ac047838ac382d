"""Grids that PROJ lacks: all of them are named, with the metres, both ways, and the grid is used once it is there."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from pyproj import CRS, Transformer, datadir

from radiant_core.errors import BadInput
from radiant_core.georef import operation, proj
from radiant_core.georef.control_points import ControlRequest, parse_control
from radiant_core.georef.crs import grid_warnings, parse_crs
from tests.core.georef.published_points import OSTN15

OSTN = "uk_os_OSTN15_NTv2_OSGBtoETRS"
LACKING = [
    ("EPSG:27700", (51.5, -0.1), "2 m instead of 1 m", (OSTN,)),
    ("EPSG:31467", (51.0, 9.0), "3 m instead of 1 m", ("de_adv_BETA2007",)),
    ("EPSG:31468", (48.1, 11.5), "3 m instead of 1 m", ("de_adv_BETA2007",)),
    ("EPSG:23030", (40.4, -3.7), "1.5 m instead of 1 m", ("es_ign_SPED2ETV2",)),
    ("EPSG:27200", (-41.3, 174.8), "4 m instead of 1 m", ("nz_linz_nzgd2kgrid0005",)),
    ("EPSG:26718", (40.7, -73.9), "10 m instead of 2 m", ("ca_nrc_ntv2_0",)),
    ("EPSG:26918", (40.7, -73.9), "4 m instead of 2 m", ("us_noaa_njhpgn",)),
    ("EPSG:2263", (40.7, -73.9), "4 m instead of 2 m", ("us_noaa_njhpgn",)),
]
NEEDING = [
    ("EPSG:7415", (52.2, 5.0), ("nl_nsgi_nlgeo2018", "nl_nsgi_rdtrans2018")),
    ("EPSG:2263+6360", (40.7, -73.9), ("us_noaa_g1999u08", "us_noaa_nadcon5_nad83_1986_nad83_harn_conus")),
    ("EPSG:25832+7837", (51.0, 9.0), ("de_bkg_gcg2016",)),
]


def forget() -> None:
    """What was chosen with other grids."""
    for cached in (operation.operation_at, proj.described, proj._system, proj._transformer):
        cached.cache_clear()


@pytest.fixture(autouse=True)
def without_grids(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """PROJ as pyproj's wheel brings it, whatever the user has fetched; a folder for grids of a test."""
    before = datadir.get_data_dir()
    datadir.set_data_dir(before.split(os.pathsep)[0])
    monkeypatch.setenv("PROJ_USER_WRITABLE_DIRECTORY", str(tmp_path / "user"))
    grids = tmp_path / "grids"
    grids.mkdir()
    forget()
    yield grids
    datadir.set_data_dir(before)
    forget()


@pytest.mark.parametrize(("text", "place", "metres", "grids"), LACKING)
def test_a_missing_grid_is_told_with_the_metres(text: str, place: tuple[float, float], metres: str, grids: tuple[str, ...]) -> None:
    crs = parse_crs(text)
    said = crs.shortfall(*place)
    assert said is not None and metres in said
    for grid in grids:
        assert f"{grid}.tif" in said and f"`pyproj sync --file {grid}`" in said
    with pytest.raises(BadInput, match="--require-grids"):
        grid_warnings(crs, np.array([place]), require_grids=True)
    assert grid_warnings(crs, np.array([place])) == (said,)


@pytest.mark.parametrize(("text", "place", "metres", "grids"), LACKING)
def test_ground_control_is_told_of_the_missing_grid(text: str, place: tuple[float, float], metres: str, grids: tuple[str, ...]) -> None:
    east, north, up = parse_crs(text).from_geodetic([[*place, 20.0]])[0].tolist()
    listed = f"{text}\n{east!r} {north!r} {up!r} 1 2 a.jpg one\n"
    (warning,) = parse_control(ControlRequest(text=listed, source="gcp_list.txt")).warnings
    assert warning.startswith("gcp_list.txt: ") and metres in warning and all(grid in warning for grid in grids)
    with pytest.raises(BadInput, match=grids[0]):
        parse_control(ControlRequest(text=listed, source="gcp_list.txt", require_grids=True))


@pytest.mark.parametrize(("text", "place", "grids"), NEEDING)
def test_all_grids_that_a_system_cannot_do_without_are_named(text: str, place: tuple[float, float], grids: tuple[str, ...]) -> None:
    crs = parse_crs(text)
    with pytest.raises(BadInput) as error:
        crs.from_geodetic([[*place, 100.0]])
    for grid in grids:
        assert f"{grid}.tif" in str(error.value) and f"`pyproj sync --file {grid}`" in str(error.value)
    assert "without its vertical datum" in str(error.value)
    rough = parse_crs(text.partition("+")[0] if "+" in text else "EPSG:28992").from_geodetic([[*place, 100.0]])
    with pytest.raises(BadInput, match=grids[0]):
        crs.to_geodetic(rough)


@pytest.mark.parametrize("text", ["EPSG:32632", "EPSG:25832", "EPSG:2056", "EPSG:3857", "EPSG:4326"])
def test_systems_without_grids_lack_none(text: str) -> None:
    assert parse_crs(text).shortfall(47.37, 8.54) is None


@pytest.mark.parametrize("point", sorted(OSTN15))
def test_without_ostn15_the_national_grid_is_metres_off_and_says_so(point: str) -> None:
    place, published = OSTN15[point]
    crs = parse_crs("EPSG:27700")
    off_m = np.linalg.norm(crs.from_geodetic([place])[0, :2] - published[:2])
    # Ordnance Survey's guide: the Helmert transformation is good to some 5 m.
    assert 0.1 < off_m < 6
    assert OSTN in str(crs.shortfall(*place[:2]))
    back = crs.to_geodetic([[*published[:2], place[2]]])[0]
    assert 0.1 < 111_320 * np.hypot(back[0] - place[0], (back[1] - place[1]) * np.cos(np.radians(place[0]))) < 6


@pytest.mark.parametrize("point", sorted(OSTN15))
def test_with_the_grid_the_published_places_come_out(point: str, without_grids: Path) -> None:
    place, published = OSTN15[point]
    # The grid's shift at this point alone, by the National Grid's own formulas: OSGB36 minus ETRS89.
    lon, lat = Transformer.from_crs("EPSG:27700", "EPSG:4277", always_xy=True).transform(*published[:2])
    write_constant_ntv2(without_grids / f"{OSTN}.tif", 3600 * (place[0] - lat), 3600 * (place[1] - lon))
    datadir.append_data_dir(str(without_grids))
    forget()
    crs = parse_crs("EPSG:27700")
    assert crs.shortfall(*place[:2]) is None
    # 1 mm, as it is published; a float32 of some seconds is good to 1e-5 m.
    np.testing.assert_allclose(crs.from_geodetic([place])[0, :2], published[:2], atol=1e-3)
    back = crs.to_geodetic([[*published[:2], place[2]]])[0]
    np.testing.assert_allclose(back[:2], place[:2], atol=1e-8)
    assert grid_warnings(crs, np.array([place]), require_grids=True) == ()


NATIONAL_GRID = "+proj=tmerc +lat_0=49 +lon_0=-2 +k=0.9996012717 +x_0=400000 +y_0=-100000 +ellps=airy +units=m"
OPTIONAL = [
    (f"{NATIONAL_GRID} +nadgrids=@OSTN15_NTv2_OSGBtoETRS.gsb", (51.5, -0.1), "OSTN15_NTv2_OSGBtoETRS"),
    (f"{NATIONAL_GRID} +nadgrids=@OSTN15_NTv2_OSGBtoETRS.gsb,@null", (51.5, -0.1), "OSTN15_NTv2_OSGBtoETRS"),
    (CRS(f"{NATIONAL_GRID} +nadgrids=@OSTN15_NTv2_OSGBtoETRS.gsb +type=crs").to_wkt("WKT1_GDAL"), (51.5, -0.1), "OSTN15_NTv2_OSGBtoETRS"),
    ("+proj=utm +zone=32 +datum=WGS84 +units=m +geoidgrids=@egm96_15.gtx", (47.0, 9.0), "egm96_15"),
    ("+proj=utm +zone=32 +datum=WGS84 +units=m +geoidgrids=egm96_15.gtx", (47.0, 9.0), "egm96_15"),
]


@pytest.mark.parametrize(("text", "place", "grid"), OPTIONAL)
def test_a_grid_that_is_optional_is_not_skipped_in_silence(text: str, place: tuple[float, float], grid: str) -> None:
    # PROJ 9.5.1 computes the first ones without any shift: 110 m beside the National Grid.
    crs = parse_crs(text)
    with pytest.raises(BadInput, match=f"needs the grid {grid}.*`pyproj sync --file {grid}`"):
        crs.from_geodetic([[*place, 100.0]])
    assert crs.shortfall(*place) is None


def test_no_shift_that_is_asked_for_is_no_system_of_epsg() -> None:
    crs = parse_crs(f"{NATIONAL_GRID} +nadgrids=@null")
    assert parse_crs("EPSG:27700").horizontal_epsg == 27700 and crs.horizontal_epsg is None
    off_m = np.linalg.norm(np.subtract(*(system.from_geodetic([[51.5, -0.1, 0.0]])[0, :2] for system in (crs, parse_crs("EPSG:27700")))))
    assert off_m > 100


@pytest.mark.parametrize(("text", "place", "metres"), [("EPSG:24378", (28.0, 77.0), "22 m"), ("EPSG:22195", (-34.6, -58.4), "9 m")])
def test_a_system_that_is_coarse_by_itself_says_its_metres(text: str, place: tuple[float, float], metres: str) -> None:
    crs = parse_crs(text)
    (told,) = grid_warnings(crs, np.array([place]), require_grids=True)
    assert f"to about {metres} (EPSG's figure)" in told and crs.shortfall(*place) is None
    assert grid_warnings(parse_crs("EPSG:2056"), np.array([[47.4, 8.5]])) == ()


@pytest.mark.parametrize("text", ["EPSG:5555", "EPSG:25832+5783"])
def test_heights_that_proj_cannot_compute_are_named_for_it(text: str) -> None:
    # DHHN92 has no operation in PROJ 9.5.1, by grids or without.
    with pytest.raises(BadInput, match=r"no operation between heights.*without its vertical datum"):
        parse_crs(text).from_geodetic([[51.0, 9.0, 100.0]])


def test_a_system_without_a_name_is_called_by_its_text() -> None:
    text = "+proj=utm +zone=18 +datum=NAD27 +units=us-ft"
    assert str(parse_crs(text).shortfall(40.7, -74.0)).startswith(f"{text} is computed here")


def test_a_list_of_another_system_is_refused_where_that_is_not_used() -> None:
    with pytest.raises(BadInput, match=r"where EPSG:26918 .* is not used: are they of another zone, in another unit"):
        parse_crs("EPSG:26918").to_geodetic([[583_960 / 0.3048, 4_507_523 / 0.3048, 10.0]])


def test_a_scene_on_the_180th_meridian_has_one_middle() -> None:
    assert proj.middle_deg(np.array([[-17.0, 179.9], [-17.0, -179.9], [-17.0, 180.0]])) == (-17.0, -180.0)


def write_constant_ntv2(path: Path, lat_s: float, lon_s: float) -> None:
    """A grid in NTv2's form over Great Britain: the same shift in seconds everywhere (PROJ tells the form by its content)."""

    def record(key: str, value: int | float | str) -> bytes:
        if isinstance(value, int):
            return key.ljust(8).encode() + struct.pack("<i4x", value)
        return key.ljust(8).encode() + (struct.pack("<d", value) if isinstance(value, float) else value.ljust(8).encode())

    step_s, south, north, west, east = 18_000.0, 45, 65, -15, 10
    count = int((north - south) * 3600 / step_s + 1) * int((east - west) * 3600 / step_s + 1)
    ellipsoids = {"MAJOR_F": 6377563.396, "MINOR_F": 6356256.909, "MAJOR_T": 6378137.0, "MINOR_T": 6356752.314}
    names = {"GS_TYPE": "SECONDS", "VERSION": "TEST", "SYSTEM_F": "OSGB36", "SYSTEM_T": "ETRS89"}
    overview = {"NUM_OREC": 11, "NUM_SREC": 11, "NUM_FILE": 1, **names, **ellipsoids}
    # NTv2 counts longitudes to the west.
    limits = {"S_LAT": south * 3600.0, "N_LAT": north * 3600.0, "E_LONG": -east * 3600.0, "W_LONG": -west * 3600.0}
    part = {
        "SUB_NAME": "GB",
        "PARENT": "NONE",
        "CREATED": "",
        "UPDATED": "",
        **limits,
        "LAT_INC": step_s,
        "LONG_INC": step_s,
        "GS_COUNT": count,
    }
    records = b"".join(record(key, value) for key, value in (*overview.items(), *part.items()))
    path.write_bytes(records + struct.pack("<4f", lat_s, -lon_s, 0, 0) * count + b"END     " + bytes(8))
