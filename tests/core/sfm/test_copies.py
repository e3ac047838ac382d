"""Copies that only look alike: found by their poses and pictures, before anything is held out."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial import KDTree

from radiant_core.cameras import Cameras
from radiant_core.io.colmap.model import read_model
from radiant_core.io.colmap.text import write_model
from radiant_core.sfm.config import SfmConfig, SfmProgress
from radiant_core.sfm.copies import find_repeats
from radiant_core.sfm.reconstruct import reconstruct, scene_from_colmap
from tests.core.scenes import cameras_above


def quiet(_: SfmProgress) -> None:
    pass


def saved_anew(source: Path, target: Path) -> None:
    """The photograph as a messenger sends it: compressed harder, without EXIF."""
    image = cv2.imread(str(source))
    assert image is not None
    cv2.imwrite(str(target), image, [cv2.IMWRITE_JPEG_QUALITY, 75])


@pytest.mark.parametrize("copy", [shutil.copy, saved_anew])
def test_every_photograph_of_a_project_that_has_all_twice_is_used_once(copy: Callable, hamlet: Path, tmp_path: Path) -> None:
    model = read_model(hamlet / "known")
    images = tmp_path / "images"
    shutil.copytree(hamlet / "images", images)
    doubles = []
    for number, image in enumerate(model.images):
        copy(images / image.name, images / f"z_{image.name}")
        double = replace(image, image_id=1_000 + number, name=f"z_{image.name}")
        doubles.append(replace(double, points2d=np.zeros((0, 2)), point3d_ids=np.zeros(0, np.int64)))
    write_model(tmp_path / "model", replace(model, images=(*model.images, *doubles)))
    result = scene_from_colmap(tmp_path / "model", images, tmp_path / "work", quiet)
    assert result.scene.cameras.names == tuple(image.name for image in model.images)
    (told,) = [warning for warning in result.warnings if "copies" in warning]
    assert told.startswith("12 of 24 photographs are copies of others") and "z_drone_0000.jpg (of drone_0000.jpg)" in told


@pytest.mark.parametrize("kind", ["photographs", "colmap"])
def test_copies_are_neither_in_the_scene_nor_in_what_is_left_for_other_programs(kind: str, hamlet: Path, tmp_path: Path) -> None:
    photos, work = tmp_path / "photos", tmp_path / "work"
    shutil.copytree(hamlet / "images", photos)
    model = read_model(hamlet / "known")
    doubles = [replace(image, image_id=1_000 + number, name=f"z {image.name}") for number, image in enumerate(model.images[3:5])]
    for double in doubles:
        saved_anew(photos / double.name.removeprefix("z "), photos / double.name)
    given = sorted(path.name for path in photos.iterdir())
    if kind == "photographs":
        result = reconstruct(photos, work, SfmConfig(max_image_size_px=640, max_num_features=1500, num_threads=2), quiet)
    else:
        doubles = [replace(image, points2d=np.zeros((0, 2)), point3d_ids=np.zeros(0, np.int64)) for image in doubles]
        write_model(tmp_path / "model", replace(model, images=(*model.images, *doubles)))
        f, _, cx, cy = model.cameras[min(model.cameras)].params
        lens = "".join(f"{number} SIMPLE_RADIAL 320 240 {f} {cx} {cy} -0.05\n" for number in model.cameras)
        (tmp_path / "model" / "cameras.txt").write_text(lens)
        result = scene_from_colmap(tmp_path / "model", photos, work, quiet)
        assert len(read_model(tmp_path / "model").images) == len(given), "what was given stays"
    cameras = result.scene.cameras
    assert len(cameras) == len(given) - 2 and any("2 of 14 photographs are copies" in warning for warning in result.warnings)
    assert sorted(path.name for path in (work / "undistorted/images").iterdir()) == sorted(cameras.names)
    assert sorted(path.name for path in photos.iterdir()) == given
    for folder in ["sparse", "undistorted/sparse"]:
        left = read_model(work / folder)
        of_model = {image.name: -image.cam_from_world[:3, :3].T @ image.translation for image in left.images}
        assert sorted(of_model) == sorted(cameras.names)
        np.testing.assert_allclose(cameras.centers, [of_model[name] for name in cameras.names], atol=1e-6)
        assert len(left.points.xyz) and KDTree(result.scene.points).query(left.points.xyz)[0].max() < 1e-6


def standing_together(size_wh: tuple[int, int]) -> Cameras:
    """Two places, and a camera at the first of another picture size and equal field of view."""
    cameras = cameras_above([(0.0, 0.0), (3.0, 0.0)], size_wh=(96, 72))
    order = [0, 1, 0]
    Ks, sizes_wh = cameras.Ks[order], cameras.sizes_wh[order]
    Ks[2, :2] *= size_wh[0] / 96
    sizes_wh[2] = size_wh
    return Cameras(names=("a", "b", "a small"), Ks=Ks, cam_from_world=cameras.cam_from_world[order], sizes_wh=sizes_wh)


def test_a_copy_of_half_the_size_is_one_and_another_picture_is_none() -> None:
    coarse = np.random.default_rng(0).integers(0, 256, (9, 12, 3), np.uint8)
    large = np.asarray(cv2.resize(coarse, (96, 72), interpolation=cv2.INTER_CUBIC))
    small = np.asarray(cv2.resize(large, (48, 36), interpolation=cv2.INTER_AREA))
    cameras, points = standing_together((48, 36)), np.random.default_rng(1).uniform(-2, 2, (50, 3))
    assert find_repeats(cameras, points, [large, large, small].__getitem__) == {2: 0}
    assert find_repeats(cameras, points, [large, large, 255 - small].__getitem__) == {}


def test_pictures_are_read_only_where_cameras_stand_together() -> None:
    asked: list[int] = []

    def picture_of(index: int) -> np.ndarray:
        asked.append(index)
        return np.zeros((72, 96, 3), np.uint8)

    find_repeats(standing_together((96, 72)), np.zeros((10, 3)), picture_of)
    assert sorted(asked) == [0, 2]
