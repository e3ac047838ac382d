"""Projects for other trainers, read back: COLMAP's by pycolmap, nerfstudio's by a reader of its own here."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import open3d as o3d
import pycolmap
import pytest

from radiant_core.errors import BadInput
from radiant_core.export.projects import ProjectPhotographs, save_colmap_project, save_nerfstudio_project
from radiant_core.io.photos.masks import mask_name, save_mask
from radiant_core.scene import SfmScene
from tests.core.io.test_scene_export import seen_scene

SIZE_WH = (640, 480)


def photographs_of(scene: SfmScene, folder: Path, *, masked: int) -> ProjectPhotographs:
    """A picture of each camera, the first `masked` with a mask."""
    for index, name in enumerate(scene.cameras.names):
        path = folder / "undistorted" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(path), np.full((*SIZE_WH[::-1], 3), index, np.uint8))
        if index < masked:
            save_mask(folder / "given" / mask_name(name), np.arange(SIZE_WH[0])[None].repeat(SIZE_WH[1], 0) > 40 * index)
    return ProjectPhotographs(images=folder / "undistorted", masks=folder / "given" if masked else None)


def with_two_lenses(scene: SfmScene) -> SfmScene:
    Ks = scene.cameras.Ks.copy()
    Ks[::2, 0, 0] *= 1.01
    Ks[::2, 0, 2] += 3.25
    return replace(scene, cameras=replace(scene.cameras, Ks=Ks))


@pytest.mark.parametrize("change", [lambda scene: scene, with_two_lenses], ids=["one lens", "two lenses"])
def test_pycolmap_reads_the_project_and_projects_every_point_where_it_was_seen(change, tmp_path: Path) -> None:
    scene = change(seen_scene())
    told: list[tuple[int, int]] = []
    counts = save_colmap_project(tmp_path / "out", scene, photographs_of(scene, tmp_path, masked=3), lambda *step: told.append(step))
    assert told[-1] == (24, 24)
    assert (counts.photographs, counts.masks, counts.missing) == (24, 3, ())
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["images", "masks", "sparse"]
    model = pycolmap.Reconstruction(str(tmp_path / "out" / "sparse" / "0"))
    assert (model.num_images(), model.num_points3D(), model.num_cameras()) == (24, 300, 1 if change is not with_two_lenses else 2)
    assert {camera.model.name for camera in model.cameras.values()} == {"PINHOLE"}
    assert model.compute_num_observations() == len(scene.observations)
    worst_px = worst_m = 0.0
    for image in model.images.values():
        index = scene.cameras.names.index(image.name)
        picture = cv2.imread(str(tmp_path / "out" / "images" / image.name))
        assert picture is not None and picture.shape[1::-1] == (model.cameras[image.camera_id].width, model.cameras[image.camera_id].height)
        np.testing.assert_array_equal(model.cameras[image.camera_id].calibration_matrix(), scene.cameras.Ks[index])
        worst_m = max(worst_m, float(np.abs(image.projection_center() - scene.cameras.centers[index]).max()))
        for point2d in image.get_observation_points2D():
            projected = image.project_point(model.points3D[point2d.point3D_id].xyz)
            worst_px = max(worst_px, float(np.abs(projected - point2d.xy).max()))
    # float64 through one quaternion.
    assert worst_m < 1e-9 and worst_px < 1e-6
    order = sorted(model.points3D)
    np.testing.assert_array_equal([model.points3D[point].xyz for point in order], scene.points)
    np.testing.assert_array_equal([model.points3D[point].color for point in order], scene.colors)
    for point in order[:20]:
        seen = {model.images[element.image_id].name for element in model.points3D[point].track.elements}
        assert seen == {scene.cameras.names[view] for view in scene.observations[scene.observations[:, 0] == point - 1, 1]}


def read_nerfstudio(folder: Path) -> tuple[dict[str, tuple[np.ndarray, np.ndarray]], np.ndarray, np.ndarray]:
    """Photograph → projection (3,4) in pixels and its centre; points and colours, all in the world before `applied_transform`.

    Written from nerfstudio's description of its format: poses are camera → world of a camera that looks along −z with y up, in
    the world that `applied_transform` has led to, as are the points.
    """
    meta = json.loads((folder / "transforms.json").read_text())
    applied = np.vstack([meta["applied_transform"], [0, 0, 0, 1]])
    views = {}
    for frame in meta["frames"]:
        lens = {**meta, **frame}
        assert [lens[name] for name in ("k1", "k2", "p1", "p2")] == [0, 0, 0, 0] and meta["camera_model"] == "OPENCV"
        pose = np.linalg.inv(applied) @ np.array(frame["transform_matrix"])
        right, up, back, center = (pose[:3, column] for column in range(4))
        rows = np.stack([right, -up, -back])
        K = np.array([[lens["fl_x"], 0, lens["cx"]], [0, lens["fl_y"], lens["cy"]], [0, 0, 1]])
        views[frame["file_path"]] = K @ np.column_stack([rows, -rows @ center]), center
    cloud = o3d.t.io.read_point_cloud(str(folder / meta["ply_file_path"])).point
    points = cloud["positions"].numpy().astype(float) @ np.linalg.inv(applied)[:3, :3].T + np.linalg.inv(applied)[:3, 3]
    return views, points, cloud["colors"].numpy()


@pytest.mark.parametrize("change", [lambda scene: scene, with_two_lenses], ids=["one lens", "two lenses"])
def test_another_reader_of_transforms_sees_every_point_where_the_scene_does(change, tmp_path: Path) -> None:
    scene = change(seen_scene())
    told: list[tuple[int, int]] = []
    counts = save_nerfstudio_project(tmp_path / "out", scene, photographs_of(scene, tmp_path, masked=2), lambda *step: told.append(step))
    assert told[-1] == (24, 24)
    # nerfstudio refuses a project in which some frames have a mask.
    assert (counts.photographs, counts.masks) == (24, 24)
    views, points, colors = read_nerfstudio(tmp_path / "out")
    # float32 at 100 m.
    np.testing.assert_allclose(points, scene.points, atol=1e-5)
    np.testing.assert_array_equal(colors, scene.colors)
    for point, view in scene.observations[::7]:
        name = scene.cameras.names[view]
        projection, center = views[f"images/{name}"]
        np.testing.assert_allclose(center, scene.cameras.centers[view], atol=1e-9)
        u, v, depth = projection @ np.append(scene.points[point], 1)
        camera = scene.cameras.cam_from_world[view] @ np.append(scene.points[point], 1)
        known = scene.cameras.Ks[view] @ camera[:3]
        np.testing.assert_allclose([u / depth, v / depth], known[:2] / known[2], atol=1e-6)
        assert depth > 0
    frames = json.loads((tmp_path / "out" / "transforms.json").read_text())["frames"]
    assert all((tmp_path / "out" / frame[key]).is_file() for frame in frames for key in ("file_path", "mask_path"))
    whole = cv2.imread(str(tmp_path / "out" / frames[5]["mask_path"]), cv2.IMREAD_UNCHANGED)
    assert whole is not None and whole.shape == SIZE_WH[::-1] and (whole == 255).all()


def test_missing_photographs_are_named_and_a_scene_without_cameras_is_refused(tmp_path: Path) -> None:
    scene = seen_scene()
    photographs = photographs_of(scene, tmp_path, masked=0)
    assert photographs.images is not None
    (photographs.images / scene.cameras.names[4]).unlink()
    assert save_colmap_project(tmp_path / "some", scene, photographs).missing == (scene.cameras.names[4],)
    assert save_colmap_project(tmp_path / "none", scene, ProjectPhotographs(images=None)).photographs == 0
    assert not (tmp_path / "none" / "images").exists() and not (tmp_path / "some" / "masks").exists()
    with pytest.raises(BadInput, match="no cameras"):
        save_colmap_project(tmp_path / "empty", scene.restricted_to(np.zeros(0, np.int64)), photographs)
    assert not (tmp_path / "empty").exists()
