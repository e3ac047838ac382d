"""Exports as others read them: PLY and SPZ by Open3D, GeoJSON by shapely."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from shapely.geometry import Point, shape

from radiant_core.choices import SpzVersion
from radiant_core.errors import BadInput
from radiant_core.export.scene import colmap_model, save_scene_geojson, save_spz
from radiant_core.frames import Frame, enu_from_geodetic
from radiant_core.io.model_reader import read_model
from radiant_core.io.open3d_formats import SPZ_MEAN_STEP
from radiant_core.io.ply import save_ply
from radiant_core.io.spz_cuts import spz_cuts
from radiant_core.scene import SfmScene
from tests.core.io.test_sog import model
from tests.viewer.made_up_run import made_up_town

ORIGIN = np.array([47.37, 8.54, 430.0])


def test_open3d_reads_ply_exactly_and_spz_within_its_steps(tmp_path: Path) -> None:
    splats = model(500)
    save_ply(tmp_path / "a.ply", splats)
    points = o3d.t.io.read_point_cloud(tmp_path / "a.ply").point
    np.testing.assert_array_equal(points["positions"].numpy(), splats.means)
    np.testing.assert_array_equal(points["opacity"].numpy()[:, 0], splats.logit_opacities)
    assert points["scale"].numpy() == pytest.approx(np.exp(splats.log_scales), rel=1e-6)
    far = replace(splats, means=np.where(np.arange(500)[:, None] == 7, 3000.0, splats.means), log_scales=splats.log_scales + 8)
    cuts = save_spz(tmp_path / "a.spz", far, 4)
    assert cuts.num_left_out == 0 and cuts.step == 2**-11, "3,000 units fit with one bit less of a fraction"
    assert cuts.num_shrunk > 100
    points = o3d.t.io.read_point_cloud(tmp_path / "a.spz").point
    assert np.abs(points["positions"].numpy() - far.means).max() <= 2 * SPZ_MEAN_STEP
    with pytest.raises(BadInput, match="none of 500"):
        save_spz(tmp_path / "b.spz", replace(far, means=far.means + 1e9))
    assert not (tmp_path / "b.spz").exists()


@pytest.mark.parametrize("version", [2, 3, 4])
def test_a_small_scene_of_fine_gaussians_keeps_them_apart_in_spz(version: SpzVersion, tmp_path: Path) -> None:
    """A thing of 0.2 units with Gaussians of 0.2 mm and less, where 12 bits would move centres by half of their size."""
    splats = model(400)
    small = replace(splats, means=splats.means * np.float32(0.1 / np.abs(splats.means).max()), log_scales=splats.log_scales * 0 - 8.5)
    cuts = save_spz(tmp_path / "a.spz", small, version)
    # A sixteenth of e^-8.5 and no more than half of that too fine.
    assert np.exp(-8.5) / 32 < cuts.step <= np.exp(-8.5) / 16 and not cuts.sentence()
    back = o3d.t.io.read_point_cloud(tmp_path / "a.spz").point["positions"].numpy()
    nearest = np.linalg.norm(back[:, None] - small.means[None], axis=2).min(axis=0)
    # Half a step along each axis, and a whole one where Open3D cuts.
    assert nearest.max() <= np.sqrt(3) * cuts.step


def seen_scene() -> SfmScene:
    """The made-up town with 300 points, each seen by the cameras whose picture it falls into."""
    scene = made_up_town().scene
    points = scene.points[:300]
    pairs = []
    for index, (pose, K) in enumerate(zip(scene.cameras.cam_from_world, scene.cameras.Ks, strict=True)):
        in_camera = points @ pose[:3, :3].T + pose[:3, 3]
        pixels = (in_camera @ K.T)[:, :2] / in_camera[:, 2:]
        inside = ((pixels > 0) & (pixels < (640, 480))).all(axis=1)
        pairs.append(np.column_stack([np.flatnonzero(inside), np.full(inside.sum(), index)]))
    observations = np.unique(np.concatenate(pairs), axis=0)
    return SfmScene(cameras=scene.cameras, points=points, colors=scene.colors[:300], observations=observations, frame=scene.frame)


def test_geojson_puts_regions_and_cameras_on_the_globe(tmp_path: Path) -> None:
    town = made_up_town()
    scene = replace(town.scene, frame=Frame(kind="metric", origin_lat_lon_alt=ORIGIN))
    names = scene.cameras.names
    about = {name: {"edge": town.cloud_plan.edge_ids[edge]} for name, edge in zip(names, town.cloud_plan.edge_of_camera, strict=True)}
    save_scene_geojson(tmp_path / "a.geojson", scene, town.cloud_plan, town.edge_plans, about)
    features = json.loads((tmp_path / "a.geojson").read_text())["features"]
    kinds = [feature["properties"]["kind"] for feature in features]
    assert (kinds.count("region"), kinds.count("strip"), kinds.count("camera")) == (3, 6, 24)
    regions = {f["properties"]["edge"]: shape(f["geometry"]) for f in features if f["properties"]["kind"] == "region"}
    assert all(region.is_valid for region in regions.values())
    for feature in features[-24:]:
        lon, lat, alt = feature["geometry"]["coordinates"]
        assert regions[feature["properties"]["edge"]].covers(Point(lon, lat))
        place = enu_from_geodetic([[lat, lon, alt]], ORIGIN)[0]
        # Nine decimals of a degree are 0.1 mm, three of a metre half a millimetre.
        assert np.abs(place - scene.cameras.centers[names.index(feature["properties"]["name"])]).max() < 1e-3
    unscaled = replace(scene, frame=Frame(kind="unscaled", origin_lat_lon_alt=np.zeros(3)))
    with pytest.raises(BadInput, match="no GPS"):
        save_scene_geojson(tmp_path / "b.geojson", unscaled, town.cloud_plan, town.edge_plans, {})
    assert not (tmp_path / "b.geojson").exists()


def test_spz_cuts_are_counted_at_its_limits_to_the_last_bit(tmp_path: Path) -> None:
    """Centres under 2,047 on every axis have steps of 1/4096, others half as fine ones for each
    doubling; log scales up to 5.9375, which float32 holds exactly, need not shrink."""
    inside = np.nextafter(np.float32(2047), np.float32(0))
    means = np.zeros((4, 3), np.float32)
    means[0], means[1, 1], means[2, 2] = inside, 2047, -2047
    scales = np.full((4, 3), 5.9375, np.float32)
    scales[3, 1] = np.nextafter(np.float32(5.9375), np.float32(6))
    cuts = save_spz(tmp_path / "a.spz", replace(model(4, degree=0), means=means, log_scales=scales))
    assert (cuts.num_left_out, cuts.num_shrunk, cuts.step) == (0, 1, 2**-11)
    assert "1 Gaussians are larger than 379 units" in cuts.sentence() and "in steps of 0.000488 units, not 0.00024" in cuts.sentence()
    near = replace(model(1, degree=0), means=means[:1], log_scales=scales[:1])
    assert save_spz(tmp_path / "c.spz", near).sentence() == "" and spz_cuts(near).step == 2**-12
    # Of Gaussians of 1 mm steps stay as fine as a quarter of them, and what is then too far is left out.
    small = replace(model(4, degree=0), means=means, log_scales=np.full((4, 3), np.log(1e-3)))
    cuts = save_spz(tmp_path / "d.spz", small)
    assert (cuts.num_left_out, cuts.step) == (2, 2**-12)
    assert "2 Gaussians lie beyond 2,047 units of the origin and are left out" in cuts.sentence()
    told = r"cannot write .*b\.spz: none of 2 Gaussians lies within 2047 units of the origin"
    with pytest.raises(BadInput, match=told):
        save_spz(tmp_path / "b.spz", small.select([1, 2]))
    assert not (tmp_path / "b.spz").exists()


@pytest.mark.parametrize("version", [2, 3, 4])
def test_a_scene_of_ten_kilometres_is_kept_whole_at_the_steps_that_are_said(tmp_path: Path, version: SpzVersion) -> None:
    given = model(50, degree=0)
    far = replace(given, means=given.means * np.float32(10_000 / np.abs(given.means).max()), log_scales=np.full((50, 3), np.log(0.2)))
    cuts = save_spz(tmp_path / "a.spz", far, version)
    assert (cuts.num_left_out, cuts.step) == (0, 2**-9)
    read = read_model(tmp_path / "a.spz").splats.means
    wanted = far.means[np.abs(far.means[None] - read[:, None]).max(axis=2).argmin(axis=1)]
    assert np.abs(read - wanted).max() <= cuts.step
    assert o3d.t.io.read_point_cloud(tmp_path / "a.spz").point.positions.numpy() == pytest.approx(read, abs=1e-3)


def test_colours_and_sizes_beyond_spz_are_counted() -> None:
    given = model(4, degree=1)
    quiet = replace(given, sh0=np.zeros((4, 1, 3)), shN=np.zeros((4, 3, 3)), means=np.zeros((4, 3)), log_scales=np.full((4, 3), -3.0))
    assert spz_cuts(quiet).sentence() == ""
    base, rest = np.array([0, 3.3, 3.4, 0]), np.array([0, 0, 0, -1.01])
    loud = replace(quiet, sh0=np.tile(base[:, None, None], (1, 1, 3)), shN=np.tile(rest[:, None, None], (1, 3, 3)))
    tiny = replace(loud, log_scales=np.array([[-10.1] * 3, [-20, -20, -9], [-3] * 3, [-3] * 3]))
    cuts = spz_cuts(tiny)
    assert (cuts.num_clamped, cuts.num_grown, cuts.num_shrunk, cuts.num_left_out) == (2, 1, 0, 0)
    assert "2 Gaussians have colours beyond SPZ's range" in cuts.sentence() and "1 Gaussians are smaller than 4.5e-05" in cuts.sentence()


def test_a_colmap_model_has_one_camera_per_size_and_matrix_and_counts_from_one(tmp_path: Path) -> None:
    scene = seen_scene()
    Ks, sizes = scene.cameras.Ks.copy(), scene.cameras.sizes_wh.copy()
    Ks[1, 0, 0], Ks[2, 1, 2] = 501.5, 239.25
    sizes[3] = (641, 480)
    cameras = replace(scene.cameras, Ks=Ks, sizes_wh=sizes)
    records = colmap_model(replace(scene, cameras=cameras))
    assert sorted(records.cameras) == [1, 2, 3, 4]
    assert [image.image_id for image in records.images] == list(range(1, 25)) and records.points.ids.tolist() == list(range(1, 301))
    for index, image in enumerate(records.images):
        camera = records.cameras[image.camera_id]
        assert camera.size_wh == tuple(sizes[index]) and camera.model == "PINHOLE"
        assert camera.params == (Ks[index, 0, 0], Ks[index, 1, 1], Ks[index, 0, 2], Ks[index, 1, 2])
        seen = scene.observations[scene.observations[:, 1] == index, 0]
        assert image.point3d_ids.tolist() == (np.unique(seen) + 1).tolist()
        in_camera = np.column_stack([scene.points[np.unique(seen)], np.ones(len(seen))]) @ scene.cameras.cam_from_world[index][:3].T
        np.testing.assert_allclose(image.points2d, (in_camera @ Ks[index].T)[:, :2] / in_camera[:, 2:], rtol=1e-12)
    np.testing.assert_array_equal(records.observations(), scene.observations)
    assert not records.points.errors_px.any()
    tracks = records.points.tracks
    assert (np.diff(tracks[:, 0] * 100 + tracks[:, 1]) > 0).all(), "by point, then by image"
    for point, image, at in tracks.tolist():
        assert records.images[image - 1].point3d_ids[at] == point + 1


def test_a_point_in_the_plane_of_a_camera_is_written_as_a_finite_number(tmp_path: Path) -> None:
    scene = seen_scene()
    pose = scene.cameras.cam_from_world[0]
    points = scene.points.copy()
    points[0] = scene.cameras.centers[0] + pose[:3, :3].T @ [1.0, 0.0, 0.0]
    with pytest.raises(BadInput, match="not finite or beyond"):
        colmap_model(replace(scene, points=points, observations=np.array([[0, 0]])))
    points[0] = scene.cameras.centers[0]
    assert np.isfinite(colmap_model(replace(scene, points=points, observations=np.array([[0, 0]]))).images[0].points2d).all()


def test_what_is_told_of_a_camera_stands_beside_its_name(tmp_path: Path) -> None:
    town = made_up_town()
    scene = replace(town.scene, frame=Frame(kind="metric", origin_lat_lon_alt=ORIGIN))
    first = scene.cameras.names[0]
    save_scene_geojson(tmp_path / "a.geojson", scene, town.cloud_plan, town.edge_plans, {first: {"psnr": 30.5}})
    found = [f["properties"] for f in json.loads((tmp_path / "a.geojson").read_text())["features"] if f["properties"]["kind"] == "camera"]
    assert found[0] == {"kind": "camera", "name": first, "psnr": 30.5}
    assert found[1] == {"kind": "camera", "name": scene.cameras.names[1]}
