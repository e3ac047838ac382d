"""Structure from motion on real pixels: the hamlet with its truth, and the brighton photographs."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from scipy.spatial import KDTree

from radiant_core.errors import BadInput
from radiant_core.geometry.align import compare_centers
from radiant_core.io.colmap.model import read_model
from radiant_core.io.colmap.text import write_model
from radiant_core.scene import SfmScene
from radiant_core.sfm.colmap.calls import pycolmap
from radiant_core.sfm.config import SfmConfig, SfmProgress, SfmResult
from radiant_core.sfm.known_poses import scene_from_mill19, triangulate
from radiant_core.sfm.reconstruct import reconstruct, scene_from_colmap
from radiant_core.sfm.world_frame.world import cameras_of

QUICK = SfmConfig(max_image_size_px=640, max_num_features=1500, num_threads=2)
REFERENCE_ERROR_PERCENT = 0.5


def quiet(_: SfmProgress) -> None:
    pass


def write_blotches(path: Path, seed: int) -> None:
    coarse = np.random.default_rng(seed).integers(0, 256, (60, 80, 3), np.uint8)
    cv2.imwrite(str(path), cv2.resize(coarse, (320, 240), interpolation=cv2.INTER_CUBIC))


@pytest.fixture(scope="module")
def hamlet_result(hamlet: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[SfmResult, list[SfmProgress], Path]:
    """The hamlet, a truncated photograph and one of another place, in a work folder that an
    interrupted attempt left dirty."""
    photos, work = tmp_path_factory.mktemp("photos dir"), tmp_path_factory.mktemp("work")
    for path in sorted((hamlet / "images").iterdir()):
        # Names with spaces: COLMAP's own list of pairs cannot hold them.
        shutil.copy(path, photos / path.name.replace("_", " (").replace(".jpg", ").jpg"))
    (photos / "cut.jpg").write_bytes(sorted((hamlet / "images").iterdir())[0].read_bytes()[:5000])
    write_blotches(photos / "other.jpg", seed=0)
    (work / "database.db").write_bytes(b"half written")
    (work / "undistorted.part").mkdir()
    (work / "undistorted").mkdir()
    (work / "undistorted" / "old.jpg").touch()
    (work / "mine.txt").write_text("not ours to remove")
    told: list[SfmProgress] = []
    return reconstruct(photos, work, QUICK, told.append), told, work


def test_the_hamlet_is_registered_near_its_truth(hamlet: Path, hamlet_result: tuple) -> None:
    result: SfmResult = hamlet_result[0]
    known = cameras_of(read_model(hamlet / "known"))
    truth = dict(zip(known.names, known.centers, strict=True))
    cameras = result.scene.cameras
    assert len(cameras) >= len(known) - 1
    errors = compare_centers(cameras.centers, [truth[name.replace(" (", "_").replace(")", "")] for name in cameras.names])
    # 2 %: images of 320 px with a dozen views; the sets of real size keep 0.5 %.
    assert errors.max_percent < 2.0
    assert 100 * np.median(errors.errors) / errors.extent < REFERENCE_ERROR_PERCENT
    assert result.scene.frame.kind == "metric"
    # GPS is off by at most 1 m here, so metres are metres to some percent over a site of 40 m.
    assert errors.reference_from_scene.scale == pytest.approx(1.0, abs=0.05)
    assert result.scene.frame.residual_m is not None
    assert result.scene.frame.residual_m < 1.5
    assert cameras.centers[:, 2].min() > np.percentile(result.scene.points[:, 2], 95)


@pytest.mark.parametrize("folder", ["undistorted/sparse", "sparse"])
def test_the_colmap_models_left_behind_are_in_the_frame_of_the_scene(folder: str, hamlet_result: tuple) -> None:
    result, _, work = hamlet_result
    _assert_in_frame_of(result.scene, pycolmap.Reconstruction(work / folder))


def test_an_undistorted_model_of_somebody_else_is_in_the_frame_of_the_scene(hamlet: Path, tmp_path: Path) -> None:
    model = read_model(hamlet / "known")
    write_model(tmp_path / "model", model)
    f, _, cx, cy = model.cameras[min(model.cameras)].params
    lens = "".join(f"{number} SIMPLE_RADIAL 320 240 {f} {cx} {cy} -0.05\n" for number in model.cameras)
    (tmp_path / "model" / "cameras.txt").write_text(lens)
    before = {path.name: path.read_bytes() for path in (tmp_path / "model").iterdir()}
    result = scene_from_colmap(tmp_path / "model", hamlet / "images", tmp_path / "work", quiet)
    _assert_in_frame_of(result.scene, pycolmap.Reconstruction(tmp_path / "work" / "undistorted" / "sparse"))
    assert {path.name: path.read_bytes() for path in (tmp_path / "model").iterdir()} == before, "what was given stays"


def _assert_in_frame_of(scene: SfmScene, model: pycolmap.Reconstruction) -> None:
    centers = {image.name: image.projection_center() for image in model.images.values()}
    assert set(centers) == set(scene.cameras.names)
    # 1e-6 m: two ways through the same similarity in float64, over some hundred metres.
    np.testing.assert_allclose(scene.cameras.centers, [centers[name] for name in scene.cameras.names], atol=1e-6)
    points = np.array([point.xyz for point in model.points3D.values()])
    assert len(points) == len(scene.points)
    assert KDTree(points).query(scene.points)[0].max() < 1e-6


def test_what_was_skipped_and_decided_is_said(hamlet_result: tuple) -> None:
    result: SfmResult = hamlet_result[0]
    assert any(warning.startswith("cut.jpg is truncated") for warning in result.warnings)
    assert result.unregistered == ("other.jpg",)
    assert any("other.jpg" in warning and "no pose" in warning for warning in result.warnings)
    assert len(result.unnamed_warnings) == len(result.warnings) and "each of which is truncated" in " ".join(result.unnamed_warnings)
    assert not any(name in warning for name in ("cut", "other") for warning in result.unnamed_warnings)
    topics = {decision.topic for decision in result.decisions}
    assert {"matching", "frame"} <= topics
    assert result.decisions[0].choice.startswith("spatial")


def test_undistorted_photographs_keep_their_names_and_fit_their_cameras(hamlet_result: tuple) -> None:
    result, _, work = hamlet_result
    assert {path.name for path in result.undistorted_folder.iterdir()} == set(result.scene.cameras.names)
    for name, size_wh in zip(result.scene.cameras.names, result.scene.cameras.sizes_wh, strict=True):
        image = cv2.imread(str(result.undistorted_folder / name))
        assert image is not None
        assert image.shape[1::-1] == tuple(size_wh)
    assert not (work / "undistorted.part").exists()
    assert not (work / "undistorted" / "old.jpg").exists()
    assert (work / "mine.txt").exists()


def test_points_project_to_where_the_photographs_show_them(hamlet_result: tuple) -> None:
    result: SfmResult = hamlet_result[0]
    scene, model = result.scene, read_model(result.undistorted_folder.parent / "sparse")
    assert np.array_equal(model.observations(), scene.observations)
    image_of_id = {image.image_id: index for index, image in enumerate(model.images)}
    point, image_id, keypoint = model.points.tracks.T
    image = np.array([image_of_id[int(i)] for i in image_id])
    poses, Ks = scene.cameras.cam_from_world[image], scene.cameras.Ks[image]
    in_camera = np.einsum("tij,tj->ti", poses[:, :3, :3], scene.points[point]) + poses[:, :3, 3]
    pixels = np.einsum("tij,tj->ti", Ks, in_camera / in_camera[:, 2:])[:, :2]
    found = np.array([model.images[i].points2d[k] for i, k in zip(image, keypoint, strict=True)])
    # COLMAP drops observations over 4 px; the median of a sound model stays below one.
    assert np.median(np.linalg.norm(pixels - found, axis=1)) < 1.0


def test_points_that_two_photographs_see_are_kept_and_lie_as_well(hamlet: Path, hamlet_result: tuple) -> None:
    """By the true poses: their own would let a point of two photographs lie anywhere on a line."""
    result: SfmResult = hamlet_result[0]
    scene, model = result.scene, read_model(result.undistorted_folder.parent / "sparse")
    seen_by = np.bincount(scene.observations[:, 0], minlength=len(scene.points))
    assert seen_by.min() == 2 and (seen_by == 2).mean() > 0.1
    known = cameras_of(read_model(hamlet / "known"))
    row_of = {name: row for row, name in enumerate(known.names)}
    true = known.select([row_of[name.replace(" (", "_").replace(")", "")] for name in scene.cameras.names])
    places = compare_centers(scene.cameras.centers, true.centers).reference_from_scene.apply(scene.points)
    image_of_id = {image.image_id: index for index, image in enumerate(model.images)}
    point, image_id, keypoint = model.points.tracks.T
    image = np.array([image_of_id[int(i)] for i in image_id])
    in_camera = np.einsum("tij,tj->ti", true.cam_from_world[image][:, :3, :3], places[point]) + true.cam_from_world[image][:, :3, 3]
    pixels = np.einsum("tij,tj->ti", scene.cameras.Ks[image], in_camera / in_camera[:, 2:])[:, :2]
    found = np.array([model.images[i].points2d[k] for i, k in zip(image, keypoint, strict=True)])
    errors = np.linalg.norm(pixels - found, axis=1)
    two, more = (float(np.median(errors[mask])) for mask in (seen_by[point] == 2, seen_by[point] > 2))
    assert two < 1.5 * more < 3.0, (two, more)


def test_triangulating_leaves_poses_and_lenses_alone(hamlet_result: tuple, tmp_path: Path) -> None:
    result, _, work = hamlet_result
    model = pycolmap.Reconstruction(work / "sparse")
    before = {name: (model.find_image_with_name(name).cam_from_world().matrix().copy()) for name in result.scene.cameras.names}
    lenses = {number: camera.params.copy() for number, camera in model.cameras.items()}
    for point_id in [number for number, point in model.points3D.items() if point.track.length() == 2]:
        model.delete_point3D(point_id)
    num_points = len(model.points3D)
    triangulate(model, work / "database.db", work, tmp_path, QUICK, refinements=1)
    after = pycolmap.Reconstruction(tmp_path)
    assert len(after.points3D) > 1.1 * num_points
    for name, pose in before.items():
        np.testing.assert_allclose(after.find_image_with_name(name).cam_from_world().matrix(), pose, rtol=0, atol=1e-12)
    for number, params in lenses.items():
        np.testing.assert_array_equal(after.cameras[number].params, params)


def test_progress_moves_through_the_phases_and_ends_complete(hamlet_result: tuple) -> None:
    told: list[SfmProgress] = hamlet_result[1]
    phases = list(dict.fromkeys(progress.phase for progress in told))
    assert phases[:5] == ["checking photographs", "features", "pairs", "matching", "mapping"]
    assert phases[-1] == "undistorting"
    assert all(0 <= progress.done <= progress.total for progress in told)
    for phase in phases:
        last = [progress for progress in told if progress.phase == phase][-1]
        assert last.done == last.total
    assert [next(progress.step for progress in told if progress.phase == phase) for phase in phases] == list(range(1, len(phases) + 1))
    assert {progress.num_steps for progress in told} == {len(phases)}


def test_an_existing_pinhole_model_is_used_as_it_is(hamlet: Path, tmp_path: Path) -> None:
    result = scene_from_colmap(hamlet / "known", hamlet / "images", tmp_path / "work", quiet)
    model = read_model(hamlet / "known")
    assert result.undistorted_folder == hamlet / "images"
    assert len(result.scene.points) == len(model.points.ids)
    before, after = cameras_of(model), result.scene.cameras
    errors = compare_centers(after.centers, before.centers)
    # 1e-9: only a similarity lies between them; and GPS within 1 m fixes the scale to some percent.
    assert errors.max_percent < 1e-9
    assert errors.reference_from_scene.scale == pytest.approx(1.0, abs=0.05)
    assert result.scene.frame.kind == "metric"


def test_a_model_whose_images_are_not_there_is_refused_by_name(hamlet: Path, tmp_path: Path) -> None:
    for path in sorted((hamlet / "images").iterdir())[:-1]:
        shutil.copy(path, tmp_path)
    with pytest.raises(BadInput, match=r"drone_0011\.jpg"):
        scene_from_colmap(hamlet / "known", tmp_path, tmp_path / "work", quiet)


def test_a_mill_19_folder_keeps_its_poses_and_gets_points(hamlet: Path, tmp_path: Path) -> None:
    cameras = cameras_of(read_model(hamlet / "known"))
    drb_from_world = np.array([[0.0, 0, -1], [1, 0, 0], [0, -1, 0]])
    torch.save({"origin_drb": torch.zeros(3), "pose_scale_factor": 50.0}, tmp_path / "coordinates.pt")  # noqa: TID251
    for split in ("train", "val"):
        (tmp_path / split / "metadata").mkdir(parents=True)
        (tmp_path / split / "rgbs").mkdir()
    for index, name in enumerate(cameras.names):
        stem, split = f"{index:06d}", "val" if index == 5 else "train"
        shutil.copy(hamlet / "images" / name, tmp_path / split / "rgbs" / f"{stem}.jpg")
        rotation = drb_from_world @ cameras.cam_from_world[index, :3, :3].T @ np.diag([1.0, -1, -1])
        c2w = np.column_stack([rotation, drb_from_world @ cameras.centers[index] / 50.0])
        K = cameras.Ks[index]
        metadata = {
            "W": 320,
            "H": 240,
            "c2w": torch.tensor(c2w),
            "intrinsics": torch.tensor([K[0, 0], K[1, 1], K[0, 2], K[1, 2]]),
        }
        torch.save(metadata, tmp_path / split / "metadata" / f"{stem}.pt")  # noqa: TID251
    result = scene_from_mill19(tmp_path, tmp_path / "work", quiet, QUICK)
    order = np.argsort([name.rsplit("/", 1)[1] for name in result.scene.cameras.names])
    assert result.scene.cameras.names[0] == "train/rgbs/000000.jpg"
    # 1e-9 m: the poses went through a change of axes and a division by 50 in float64.
    assert np.allclose(result.scene.cameras.centers[order], cameras.centers, atol=1e-9)
    assert result.scene.frame.kind == "unscaled"
    known = read_model(hamlet / "known").points.xyz
    inside = ((result.scene.points >= known.min(axis=0) - 3) & (result.scene.points <= known.max(axis=0) + 3)).all(axis=1)
    # Of a few hundred points some far ones have a small parallax and lie metres off.
    assert len(inside) > 200
    assert inside.mean() > 0.9
    assert (result.undistorted_folder / result.scene.cameras.names[0]).is_file()


def test_the_global_mapper_can_be_asked_for(hamlet: Path, tmp_path: Path) -> None:
    result = reconstruct(hamlet / "images", tmp_path, replace(QUICK, mapper="global"), quiet)
    known = cameras_of(read_model(hamlet / "known"))
    cameras = result.scene.cameras
    assert len(cameras) >= len(known) - 2
    # 5 %: the global mapper is rougher on a dozen small images.
    errors = compare_centers(cameras.centers, known.named(cameras.names).centers)
    assert 100 * np.median(errors.errors) / errors.extent < 5.0


def test_images_of_another_size_are_not_undistorted_with_the_wrong_camera(hamlet: Path, tmp_path: Path) -> None:
    model = read_model(hamlet / "known")
    (tmp_path / "images").mkdir()
    write_model(tmp_path / "model", model)
    path = tmp_path / "model" / "cameras.txt"
    fx, _, cx, cy = model.cameras[min(model.cameras)].params
    path.write_text("".join(f"{number} SIMPLE_RADIAL 320 240 {fx} {cx} {cy} -0.05\n" for number in model.cameras))
    for image in model.images:
        pixels = cv2.imread(str(hamlet / "images" / image.name))
        assert pixels is not None
        cv2.imwrite(str(tmp_path / "images" / image.name), pixels[::2, ::2])
    with pytest.raises(BadInput, match=r"\(160, 120\) px and its camera \(320, 240\)"):
        scene_from_colmap(tmp_path / "model", tmp_path / "images", tmp_path / "work", quiet)
    result = scene_from_colmap(tmp_path / "model", hamlet / "images", tmp_path / "work", quiet)
    assert result.undistorted_folder == tmp_path / "work" / "undistorted" / "images"
    assert len(list(result.undistorted_folder.iterdir())) == len(result.scene.cameras) == len(model.images)


@pytest.mark.parametrize("distortion", ["PINHOLE 320 240 {f} {f} {cx} {cy}", "SIMPLE_RADIAL 320 240 {f} {cx} {cy} -0.05"])
def test_a_truncated_image_of_a_model_is_skipped_and_named(distortion: str, hamlet: Path, tmp_path: Path) -> None:
    model = read_model(hamlet / "known")
    write_model(tmp_path / "model", model)
    f, _, cx, cy = model.cameras[min(model.cameras)].params
    camera = distortion.format(f=f, cx=cx, cy=cy)
    (tmp_path / "model" / "cameras.txt").write_text("".join(f"{number} {camera}\n" for number in model.cameras))
    shutil.copytree(hamlet / "images", tmp_path / "images")
    cut = tmp_path / "images" / model.images[3].name
    cut.write_bytes(cut.read_bytes()[:5000])
    result = scene_from_colmap(tmp_path / "model", tmp_path / "images", tmp_path / "work", quiet)
    assert len(result.scene.cameras) == len(model.images) - 1
    assert any(warning.startswith(f"{cut.name} is truncated") for warning in result.warnings)
    pixels = cv2.imread(str(hamlet / "images" / cut.name))
    assert pixels is not None
    cv2.imwrite(str(cut), pixels[:, :120])
    with pytest.raises(BadInput, match=r"has \(120, 240\) px and its camera \(320, 240\)"):
        scene_from_colmap(tmp_path / "model", tmp_path / "images", tmp_path / "work2", quiet)


def test_each_size_and_camera_gets_intrinsics_of_its_own(hamlet: Path, tmp_path: Path) -> None:
    photos = tmp_path / "photos"
    photos.mkdir()
    for index, path in enumerate(sorted((hamlet / "images").iterdir())):
        if index % 2:
            shutil.copy(path, photos)
        else:
            image = cv2.imread(str(path))
            assert image is not None
            cv2.imwrite(str(photos / path.name), cv2.resize(image, (288, 216), interpolation=cv2.INTER_AREA))
    result = reconstruct(photos, tmp_path / "work", QUICK, quiet)
    sizes = {tuple(size_wh) for size_wh in read_sizes(tmp_path / "work" / "sparse")}
    assert sizes == {(320, 240), (288, 216)}
    assert len(read_model(tmp_path / "work" / "sparse").cameras) == 2
    # Half of the photographs lost their GPS in resizing: too few for neighbours.
    assert result.decisions[0].choice.startswith("exhaustive")


def read_sizes(folder: Path) -> list[tuple[int, int]]:
    return [camera.size_wh for camera in read_model(folder).cameras.values()]


def test_photographs_that_do_not_overlap_are_refused_in_one_sentence(tmp_path: Path) -> None:
    for index in range(4):
        write_blotches(tmp_path / f"{index}.jpg", index)
    with pytest.raises(BadInput, match="do not overlap"):
        reconstruct(tmp_path, tmp_path / "work", QUICK, quiet)


@pytest.mark.parametrize(
    "wrong", [{"max_num_features": 0}, {"num_threads": -1}, {"matching": "guess"}, {"mapper": "none"}, {"num_neighbors": 2.5}]
)
def test_a_setting_out_of_range_is_named(wrong: dict) -> None:
    with pytest.raises(BadInput, match=next(iter(wrong))):
        SfmConfig(**wrong)


@pytest.mark.stress
def test_brighton_agrees_with_its_reference_model(data_folder: Path, tmp_path: Path) -> None:
    reference = read_model(data_folder / "brighton" / "sparse" / "0")
    centers = {image.name: np.linalg.inv(image.cam_from_world)[:3, 3] for image in reference.images}
    result = reconstruct(
        data_folder / "brighton" / "images",
        tmp_path,
        SfmConfig(num_threads=2, max_image_size_px=800, max_num_features=4000),
        quiet,
    )
    cameras = result.scene.cameras
    assert len(cameras) >= len(reference.images) - 1
    errors = compare_centers(cameras.centers, [centers[name] for name in cameras.names])
    assert errors.max_percent < REFERENCE_ERROR_PERCENT
    assert result.scene.frame.residual_m is not None
    assert result.scene.frame.residual_m < 0.5
