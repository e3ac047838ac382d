"""A model in a coordinate system: Gaussians and cameras where PROJ puts them, small numbers in the file, and what says so."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pyproj import CRS, Transformer

from radiant_core.errors import BadInput
from radiant_core.frames import Frame, ecef_from_local, geodetic_from_enu
from radiant_core.georef.crs import parse_crs
from radiant_core.georef.features import crs_member, in_crs
from radiant_core.georef.reference import georeference, local_comments, local_record
from radiant_core.georef.sidecar import require_no_sidecar, save_local_sidecar, save_sidecar
from radiant_core.io.ply import load_ply, save_ply
from radiant_core.scene import SfmScene
from tests.core.scenes import cameras_above, ground_splats

ORIGIN = np.array([47.37, 8.54, 430.0])
FRAME = Frame(kind="metric", origin_lat_lon_alt=ORIGIN, residual_m=0.1)


def by_pyproj(points_m: np.ndarray, code: str) -> np.ndarray:
    lat, lon, alt = geodetic_from_enu(points_m, ORIGIN).T
    return np.column_stack(Transformer.from_crs("EPSG:4979", code, always_xy=True).transform(lon, lat, alt))


@pytest.mark.parametrize("code", ["EPSG:32632", "EPSG:2056", "EPSG:25832"])
def test_a_file_and_its_offset_are_the_places(code: str, tmp_path: Path) -> None:
    splats = ground_splats(half_side_m=300.0)
    reference = georeference(FRAME, parse_crs(code))
    save_ply(tmp_path / "a.ply", reference.move(splats), reference.comments())
    read = load_ply(tmp_path / "a.ply")
    assert np.abs(read.means[:, :2]).max() < 1000, "small enough for float32"
    # 1e-4 m: float32 of some 500 m has steps of 3e-5.
    assert np.abs(read.means + reference.offset - by_pyproj(splats.means.astype(np.float64), code)).max() < 1e-4
    header = (tmp_path / "a.ply").read_bytes()[:600].decode("latin-1")
    assert f"comment crs {code}\n" in header and "comment offset " in header
    east, north, up = (float(word) for word in header.split("comment offset ")[1].split("\n")[0].split())
    assert (east, north, up) == tuple(reference.offset)


def test_cameras_move_with_what_they_see() -> None:
    cameras = cameras_above([(-80.0, 10.0), (120.0, -60.0)], height_m=60.0)
    points = np.array([[-80.0, 11.0, 0.0], [-79.0, 9.0, 1.0], [121.0, -58.0, 2.0]])
    scene = SfmScene(cameras=cameras, points=points, colors=np.zeros((3, 3)), observations=[[0, 0], [1, 0], [2, 1]], frame=FRAME)
    moved = georeference(FRAME, parse_crs("EPSG:32632")).move_scene(scene)
    for point, camera in scene.observations:
        before, after = (
            s.cameras.Ks[camera] @ (s.cameras.cam_from_world[camera, :3] @ np.append(s.points[point], 1)) for s in (scene, moved)
        )
        # 0.05 px: UTM stretches the plane by 4e-4 and heights not at all.
        assert np.abs(before[:2] / before[2] - after[:2] / after[2]).max() < 0.05


def test_what_stands_beside_a_file_says_where_it_lies(tmp_path: Path) -> None:
    reference = georeference(FRAME, parse_crs("EPSG:2056"))
    json_path, prj_path = save_sidecar(tmp_path / "model.spz", reference)
    record = json.loads(json_path.read_text())
    assert (record["crs"], record["epsg"], record["file"], record["unit"]) == ("EPSG:2056", 2056, "model.spz", "metre")
    assert CRS.from_wkt(prj_path.read_text()).name.startswith("CH1903+")
    with pytest.raises(BadInput, match="choose another name"):
        require_no_sidecar(tmp_path / "model.spz")


def test_a_file_in_the_scenes_own_frame_has_the_earths_axes(tmp_path: Path) -> None:
    record = local_record(FRAME)
    ecef = np.array(record["ecef_from_file"]) @ [12.0, -7.0, 3.0, 1.0]
    lat, lon, alt = geodetic_from_enu([[12.0, -7.0, 3.0]], ORIGIN)[0]
    expected = Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True).transform(lon, lat, alt)
    assert np.abs(ecef[:3] - expected).max() < 1e-6
    assert ecef_from_local(ORIGIN).shape == (4, 4)
    assert json.loads(save_local_sidecar(tmp_path / "a.sog", record).read_text())["file"] == "a.sog"
    assert "47.37" in local_comments(FRAME)[1]


def test_scenes_without_a_place_have_no_coordinates() -> None:
    nowhere = Frame(kind="scaled", origin_lat_lon_alt=np.zeros(3))
    assert local_comments(nowhere) == ()
    with pytest.raises(BadInput, match="--gcp"):
        georeference(nowhere, parse_crs("EPSG:32632"))
    with pytest.raises(BadInput, match="degrees"):
        georeference(FRAME, parse_crs("EPSG:4326"))
    level = Frame(kind="metric", origin_lat_lon_alt=ORIGIN, residual_m=0.1, altitude_known=False)
    with pytest.raises(BadInput, match="no datum"):
        georeference(level, parse_crs("EPSG:32632+5773"))


def test_features_are_where_pyproj_puts_them() -> None:
    ring = [[8.54, 47.37], [8.541, 47.37], [8.541, 47.371], [8.54, 47.37]]
    features = [
        {"type": "Feature", "properties": {}, "geometry": {"type": "Polygon", "coordinates": [ring]}},
        {"type": "Feature", "properties": {}, "geometry": {"type": "Point", "coordinates": [8.54, 47.37, 430.0]}},
    ]
    polygon, point = in_crs(features, parse_crs("EPSG:2056"))
    expected = Transformer.from_crs("EPSG:4326", "EPSG:2056", always_xy=True)
    for got, (lon, lat) in zip(polygon["geometry"]["coordinates"][0], ring, strict=True):
        assert np.abs(np.array(got) - expected.transform(lon, lat)).max() <= 5.1e-4  # written to the millimetre
    assert point["geometry"]["coordinates"][2] == 430.0
    assert crs_member(parse_crs("EPSG:2056"))["properties"]["name"].endswith("2056")
