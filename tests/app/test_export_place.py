"""`radiant export --crs` of the small run that comes with the project: what is written, and what is refused."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import open3d as o3d
import pytest
from pyproj import Transformer
from scipy.spatial import KDTree
from typer.testing import CliRunner, Result

from radiant_app.cli.app import app
from radiant_app.workers.sources import load_scene_of
from radiant_core.errors import BadInput
from radiant_core.export.sog import save_sog
from radiant_core.frames import geodetic_from_enu
from radiant_core.io.colmap.model import read_model
from radiant_core.io.ply import load_ply
from radiant_core.io.records import load_scene, save_scene

RUN = Path(__file__).parents[2] / "sample_scenes" / "runs" / "tiny"


def export(*arguments: object) -> str:
    result = CliRunner().invoke(app, ["export", str(RUN), *(str(argument) for argument in arguments)])
    if result.exception is not None:
        raise result.exception
    return result.stdout


def swiss(points_m: np.ndarray) -> np.ndarray:
    lat, lon, alt = geodetic_from_enu(points_m, load_scene_of(RUN).frame.origin_lat_lon_alt).T
    return np.column_stack(Transformer.from_crs("EPSG:4979", "EPSG:2056", always_xy=True).transform(lon, lat, alt))


def test_a_model_is_where_proj_puts_it(tmp_path: Path) -> None:
    said = export(tmp_path / "a.ply", "--crs", "EPSG:2056")
    assert "add it to the file's coordinates" in said and "a.georef.json, a.prj" in said
    offset = json.loads((tmp_path / "a.georef.json").read_text())["offset"]
    expected = swiss(load_ply(RUN / "scene.ply").means.astype(np.float64))
    # 1e-4 m: float32 within a kilometre of the offset.
    assert np.abs(load_ply(tmp_path / "a.ply").means + np.array(offset) - expected).max() < 1e-4
    export(tmp_path / "b.sog", "--crs", "EPSG:2056")
    assert {path.name for path in tmp_path.iterdir()} == {
        f"{n}.{e}" for n, m in (("a", "ply"), ("b", "sog")) for e in (m, "georef.json", "prj")
    }


def test_points_of_surfaces_are_where_proj_puts_them_to_a_millimetre(tmp_path: Path) -> None:
    coarse = ("--resolution", "0.5", "--long-side-px", "96")
    for name, more in (("metres", ()), ("map", ("--crs", "EPSG:2056"))):
        export(tmp_path / f"{name}.ply", "--format", "mesh", *coarse, *more)
    metres, on_map = (np.asarray(o3d.io.read_triangle_mesh(str(tmp_path / f"{name}.ply")).vertices) for name in ("metres", "map"))
    offset = json.loads((tmp_path / "map.georef.json").read_text())["offset"]
    # Open3D's threads give vertices in another order each time.
    near, other_way = swiss(metres) - offset, on_map
    distances = [KDTree(a).query(b)[0].max() for a, b in ((near, other_way), (other_way, near))]
    assert len(metres) == len(on_map) > 100 and max(distances) < 1e-3
    for name, crs in (("utm", "EPSG:32632"), ("swiss", "EPSG:2056")):
        export(tmp_path / f"{name}.laz", *coarse, "--crs", crs)
    utm, in_swiss = (laspy.read(tmp_path / f"{name}.laz").xyz for name in ("utm", "swiss"))
    lon, lat = Transformer.from_crs("EPSG:32632", "EPSG:4326", always_xy=True).transform(*utm[:, :2].T)
    expected = np.column_stack(Transformer.from_crs("EPSG:4979", "EPSG:2056", always_xy=True).transform(lon, lat, utm[:, 2]))
    assert len(utm) == len(in_swiss) > 100
    # Either file is rounded to a millimetre, so half of one each.
    assert np.abs(in_swiss - expected)[:, :2].max() < 1.001e-3


def test_levels_and_tiles_say_where_on_the_globe_their_metres_lie(tmp_path: Path) -> None:
    frame = load_scene_of(RUN).frame
    point_m = np.array([[12.0, -7.0, 3.0]])
    ecef = Transformer.from_crs("EPSG:4979", "EPSG:4978").transform(*geodetic_from_enu(point_m, frame.origin_lat_lon_alt)[0])
    for kind, name in (("lod", "lod-meta"), ("tiles", "tileset")):
        assert f"{name}.georef.json" in export(tmp_path / kind, "--format", kind)
        record = json.loads((tmp_path / kind / f"{name}.georef.json").read_text())
        assert record["file"] == f"{name}.json" and record["origin_lat_lon_alt"] == frame.origin_lat_lon_alt.tolist()
        placed = np.array(record["ecef_from_file"]) @ np.append(point_m[0], 1.0)
        assert np.abs(placed[:3] - ecef).max() < 1e-6  # m: rounding of numbers of 6e6 m
        # What no model may carry: names of photographs, and places of cameras.
        text = (tmp_path / kind / f"{name}.georef.json").read_text()
        assert not [one for one in load_scene_of(RUN).cameras.names if one in text]
        assert set(record) == {"schema", "version", "crs", "unit", "axes", "origin_lat_lon_alt", "ecef_from_file", "file"}


def test_cameras_are_where_proj_puts_them(tmp_path: Path) -> None:
    export(tmp_path / "project", "--crs", "EPSG:2056")
    offset = json.loads((tmp_path / "project.georef.json").read_text())["offset"]
    images = read_model(tmp_path / "project" / "sparse" / "0").images
    centers = {image.name: -image.cam_from_world[:3, :3].T @ image.cam_from_world[:3, 3] for image in images}
    cameras = load_scene_of(RUN).cameras
    expected = dict(zip(cameras.names, swiss(cameras.centers), strict=True))
    assert max(float(np.abs(centers[name] + offset - expected[name]).max()) for name in centers) < 1e-3
    export(tmp_path / "regions.geojson", "--crs", "EPSG:2056")
    places = [
        f["geometry"]["coordinates"]
        for f in json.loads((tmp_path / "regions.geojson").read_text())["features"]
        if "held_out" in f["properties"]
    ]
    assert KDTree(np.array(places)[:, :2]).query(swiss(cameras.centers)[:, :2])[0].max() < 1e-3


def test_a_model_in_its_own_metres_says_where_its_origin_is(tmp_path: Path) -> None:
    export(tmp_path / "a.ply")
    lat, lon, _ = load_scene_of(RUN).frame.origin_lat_lon_alt
    assert f"comment origin {lat:.10f} {lon:.10f}".encode() in (tmp_path / "a.ply").read_bytes()[:400]


@pytest.mark.parametrize(
    ("name", "crs", "said"),
    [
        ("a.ply", "EPSG:4326", "degrees"),
        ("a.ply", "Bern", "unknown"),
        ("a.tif", "EPSG:2263", "unit is the"),
        ("a.ply", "EPSG:25832+7837", "de_bkg_gcg2016.tif"),
    ],
)
def test_systems_that_do_not_fit_are_refused_and_nothing_is_written(tmp_path: Path, name: str, crs: str, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        export(tmp_path / name, "--crs", crs, *(("--format", "dsm") if name.endswith(".tif") else ()))
    assert not list(tmp_path.iterdir())


def test_what_would_be_overwritten_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.prj").write_text("mine")
    with pytest.raises(BadInput, match=r"a\.prj exists"):
        export(tmp_path / "a.ply", "--crs", "EPSG:2056")
    result = CliRunner().invoke(app, ["export", str(RUN / "scene.ply"), str(tmp_path / "b.ply"), "--crs", "EPSG:2056"])
    assert isinstance(result.exception, BadInput) and "model without a scene" in str(result.exception)


@pytest.mark.parametrize(
    ("name", "arguments", "said"),
    [
        ("a.ply", ("--tile-px", "256"), "--tile-px is of GeoTIFFs"),
        ("a.ply", ("--long-side-px", "320"), "--long-side-px is of the pictures"),
        ("a.tif", ("--format", "ortho", "--long-side-px", "320"), "--long-side-px is of the pictures"),
        ("a.laz", ("--tile-px", "256"), "--tile-px is of GeoTIFFs"),
        ("a.tif", ("--format", "dsm", "--tile-px", "100"), "multiple of 16"),
        ("a.geojson", ("--format", "contours", "--interval", "0"), "--interval is 0.0, expected a number above zero"),
        ("a.geojson", ("--format", "contours", "--interval", "nan"), "expected a number above zero"),
        ("tiles", ("--format", "tiles", "--crs", "EPSG:2056"), "ECEF"),
        ("page.html", ("--crs", "EPSG:2056"), "scene's own metres"),
    ],
)
def test_options_that_a_format_has_not_are_refused_at_once(tmp_path: Path, name: str, arguments: tuple[str, ...], said: str) -> None:
    with pytest.raises(BadInput, match=said):
        export(tmp_path / name, *arguments)
    assert not list(tmp_path.iterdir())


def test_files_of_a_run_share_one_offset(tmp_path: Path) -> None:
    export(tmp_path / "a.ply", "--crs", "EPSG:32632")
    export(tmp_path / "project", "--crs", "EPSG:32632")
    offsets = [json.loads((tmp_path / f"{name}.georef.json").read_text())["offset"] for name in ("a", "project")]
    origin = geodetic_from_enu(np.zeros((1, 3)), load_scene_of(RUN).frame.origin_lat_lon_alt)[0]
    east, north = Transformer.from_crs("EPSG:4979", "EPSG:32632", always_xy=True).transform(origin[1], origin[0])
    assert offsets[0] == offsets[1] == [np.floor(east / 100) * 100, np.floor(north / 100) * 100, 0.0]


NEW_YORK = np.array([40.70, -73.90, 30.0])


def in_new_york(tmp_path: Path) -> Path:
    """The run, as if it had been flown in New York, where feet are the unit and grids are missing."""
    run = tmp_path / "run"
    shutil.copytree(RUN, run)
    scene_path = next(run.rglob("scene.safetensors"))
    scene = load_scene(scene_path)
    save_scene(scene_path, replace(scene, frame=replace(scene.frame, origin_lat_lon_alt=NEW_YORK)))
    return run


def exported(run: Path, *arguments: object) -> Result:
    return CliRunner().invoke(app, ["export", str(run), *(str(argument) for argument in arguments)])


@pytest.mark.parametrize("name", ["a.ply", "a.spz", "a.sog", "project", "a.geojson"])
def test_a_missing_grid_is_a_warning_with_the_metres_or_a_refusal(tmp_path: Path, name: str) -> None:
    run = in_new_york(tmp_path)
    refused = exported(run, tmp_path / name, "--crs", "EPSG:2263", "--require-grids")
    assert isinstance(refused.exception, BadInput) and "us_noaa_njhpgn.tif" in str(refused.exception)
    assert not (tmp_path / name).exists()
    result = exported(run, tmp_path / name, "--crs", "EPSG:2263")
    assert result.exception is None
    said = " ".join((result.output + result.stderr).split())
    assert "EPSG:2263 is computed here to about 4 m instead of 2 m" in said and "pyproj sync --file us_noaa_njhpgn" in said


def test_a_model_in_feet_is_as_high_as_it_is(tmp_path: Path) -> None:
    run = in_new_york(tmp_path)
    assert exported(run, tmp_path / "a.ply", "--crs", "EPSG:2263").exception is None
    before, after = load_ply(RUN / "scene.ply"), load_ply(tmp_path / "a.ply")
    ratio = np.ptp(after.means.astype(np.float64), axis=0) / np.ptp(before.means.astype(np.float64), axis=0) * (1200 / 3937)
    # 1 %: the grid's north is turned by 0.06° against east and north of the scene.
    assert np.abs(ratio - 1).max() < 0.01
    assert np.abs(np.exp(after.log_scales - before.log_scales) * (1200 / 3937) - 1).max() < 1e-3
    record = json.loads((tmp_path / "a.georef.json").read_text())
    assert (record["unit"], record["height_unit"]) == ("US survey foot", "US survey foot")
    assert exported(run, tmp_path / "cameras.geojson", "--crs", "EPSG:2263").exception is None
    heights = [
        f["geometry"]["coordinates"][2]
        for f in json.loads((tmp_path / "cameras.geojson").read_text())["features"]
        if "held_out" in f["properties"]
    ]
    metres = load_scene_of(run).cameras.centers[:, 2] + NEW_YORK[2]
    assert np.median(heights) * (1200 / 3937) == pytest.approx(np.median(metres), abs=0.05)


@pytest.mark.parametrize(
    ("name", "crs", "said"),
    [
        ("a.tif", "EPSG:2263", "its unit is the US survey foot"),
        ("a.laz", "EPSG:2263", "its unit is the US survey foot"),
        ("a.glb", "EPSG:2263", "its unit is the US survey foot"),
        ("a.tif", "EPSG:26918+6360", "heights are in metres, and EPSG:26918\\+6360 has them in units of 1 US survey foot"),
        ("a.ply", "EPSG:2263+5703", "which would press a model"),
        ("project", "EPSG:26918+6360", "which would stretch a model"),
        ("a.spz", "EPSG:2263+6360", "us_noaa_g1999u08.tif and us_noaa_nadcon5_nad83_1986_nad83_harn_conus.tif"),
        ("a.sog", "EPSG:4269", "counts in degrees"),
    ],
)
def test_units_that_do_not_fit_are_refused_by_name(tmp_path: Path, name: str, crs: str, said: str) -> None:
    kind = ("--format", "dsm") if name.endswith(".tif") else ()
    result = exported(in_new_york(tmp_path), tmp_path / name, "--crs", crs, *kind)
    assert isinstance(result.exception, BadInput)
    assert re.search(said, str(result.exception)), str(result.exception)


def test_a_switch_without_a_system_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="give it with --crs"):
        export(tmp_path / "a.ply", "--require-grids")


MESHES: tuple[tuple[str, tuple[str, ...]], ...] = (("metres", ()), ("feet", ("--crs", "EPSG:2263")))


def test_figures_of_files_in_feet_are_in_the_unit_that_they_name(tmp_path: Path) -> None:
    run = in_new_york(tmp_path)
    said = json.loads(exported(run, tmp_path / "c.sog", "--crs", "EPSG:2263", "--json").stdout)
    assert exported(run, tmp_path / "a.ply", "--crs", "EPSG:2263").exception is None
    in_feet = save_sog(tmp_path / "b.sog", load_ply(tmp_path / "a.ply")).position_max_m
    # Three digits are said; a US survey foot is 1200/3937 m.
    assert said["position_max_m"] == pytest.approx(in_feet * 1200 / 3937, rel=5e-3)
    mesh = [json.loads(exported(run, tmp_path / f"{n}.ply", "--format", "mesh", *more, "--json").stdout) for n, more in MESHES]
    assert [figures["unit"] for figures in mesh] == ["m", "US survey foot"]
    assert mesh[1]["resolution"] == pytest.approx(mesh[0]["resolution"] * 3937 / 1200, abs=1e-4)
