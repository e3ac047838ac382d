"""Masks through structure from motion, on the hamlet: nothing of what is masked remains."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.io.photos.listing import list_photographs
from radiant_core.io.photos.masks import find_masks, load_mask, mask_name, save_mask
from radiant_core.sfm.colmap.calls import pycolmap
from radiant_core.sfm.colmap.database import extract_features
from radiant_core.sfm.colmap.undistort import undistort
from radiant_core.sfm.config import SfmConfig, SfmProgress
from radiant_core.sfm.masks import take_masks, undistort_masks, without_masked_points
from radiant_core.sfm.reconstruct import scene_from_colmap

SIZE_WH = (320, 240)
USED = np.ones(SIZE_WH[::-1], bool)
USED[60:180, 40:150] = False


def quiet(_: SfmProgress) -> None:
    pass


@pytest.fixture
def masks(hamlet: Path, tmp_path: Path) -> Path:
    """Masks of all photographs but the last."""
    for path in sorted((hamlet / "images").iterdir())[:-1]:
        save_mask(tmp_path / "masks" / f"{path.stem}.png", USED)
    return tmp_path / "masks"


def test_no_feature_lies_under_a_mask_and_photographs_without_one_keep_theirs(hamlet: Path, masks: Path, tmp_path: Path) -> None:
    names = [path.name for path in sorted((hamlet / "images").iterdir())][-3:]
    photographs = list_photographs(hamlet / "images", names=names).photographs
    given = take_masks(masks, photographs, tmp_path)
    config = SfmConfig(max_image_size_px=640, max_num_features=1500, num_threads=1)
    extract_features(tmp_path / "masked.db", hamlet / "images", photographs, config, quiet, given)
    extract_features(tmp_path / "whole.db", hamlet / "images", photographs, config, quiet)
    hidden = {}
    for kind in ("masked", "whole"):
        with pycolmap.Database.open(tmp_path / f"{kind}.db") as store:
            keypoints = {image.name: store.read_keypoints(image.image_id)[:, :2].astype(int) for image in store.read_all_images()}
            assert len({image.camera_id for image in store.read_all_images()}) == 1
        assert set(keypoints) == set(names)
        hidden[kind] = [int((~USED[keypoints[name][:, 1], keypoints[name][:, 0]]).sum()) for name in names]
    assert hidden["masked"] == [0, 0, hidden["whole"][2]]
    assert min(hidden["whole"]) > 20


def distorted_model(hamlet: Path, folder: Path) -> Path:
    """The hamlet's known poses behind a lens that distorts."""
    model = pycolmap.Reconstruction(hamlet / "known")
    for camera in model.cameras.values():
        focal_px = camera.mean_focal_length()
        camera.model = pycolmap.CameraModelId.SIMPLE_RADIAL
        camera.params = [focal_px, camera.width / 2, camera.height / 2, -0.15]
    folder.mkdir()
    model.write_binary(folder)
    return folder


def test_masks_are_undistorted_as_photographs_are(hamlet: Path, tmp_path: Path) -> None:
    model = distorted_model(hamlet, tmp_path / "model")
    photos, work = tmp_path / "photos", tmp_path / "work"
    # Photographs that show their own masks: whoever undistorts them undistorts the masks.
    for path in sorted((hamlet / "images").iterdir()):
        (photos / path.name).parent.mkdir(exist_ok=True)
        cv2.imwrite(str(photos / path.name), np.repeat(USED[..., None] * np.uint8(255), 3, axis=2), [cv2.IMWRITE_JPEG_QUALITY, 100])
        save_mask(work / "masks.given" / mask_name(path.name), USED)
    shown = undistort(model, photos, work, 1, quiet).image_folder
    final = undistort_masks(work / "masks.given", model, work, 1)
    assert final is not None and not (work / "masks.given").exists() and not (work / "masks.part").exists()
    for path in sorted(photos.iterdir()):
        picture = cv2.imread(str(shown / path.name), cv2.IMREAD_GRAYSCALE)
        assert picture is not None
        used = load_mask(final / mask_name(path.name), (picture.shape[1], picture.shape[0]))
        # JPEG's ringing at the edge moves the half by a pixel here and there.
        assert ((picture > 127) != used).mean() < 0.002
        assert used.shape != USED.shape, "this lens distorts"


def test_points_seen_only_under_masks_are_left_out(hamlet: Path, masks: Path, tmp_path: Path) -> None:
    (tmp_path / "project").mkdir()
    whole = scene_from_colmap(hamlet / "known", hamlet / "images", tmp_path / "whole", quiet)
    result = scene_from_colmap(hamlet / "known", hamlet / "images", tmp_path / "masked", quiet, masks)
    assert whole.masks_folder is None and result.masks_folder == tmp_path / "masked" / "masks"
    assert [d.topic for d in result.decisions].count("masks") == 1
    before, after = whole.scene, result.scene
    rows, pixels = after.observed_pixels(after.cameras)
    masked = after.observations[rows, 1] != after.cameras.names.index(sorted(after.cameras.names)[-1])
    assert USED[pixels[masked, 1], pixels[masked, 0]].all()
    rows, pixels = before.observed_pixels(before.cameras)
    last = before.cameras.names.index(sorted(before.cameras.names)[-1])
    used = USED[pixels[:, 1], pixels[:, 0]] | (before.observations[rows, 1] == last)
    assert 0 < used.sum() < len(used)
    assert len(after.observations) == len(before.observations) - (~used).sum()
    assert len(after.points) <= len(before.points) and len(np.unique(after.observations[:, 0])) == len(after.points)


def test_a_scene_without_masks_stays_as_it_is(hamlet: Path, tmp_path: Path) -> None:
    scene = scene_from_colmap(hamlet / "known", hamlet / "images", tmp_path, quiet).scene
    assert without_masked_points(scene, None) is scene


def test_masks_that_do_not_fit_are_refused_and_those_of_an_earlier_attempt_go(hamlet: Path, masks: Path, tmp_path: Path) -> None:
    name = next(iter(find_masks(masks, [path.name for path in (hamlet / "images").iterdir()])))
    shutil.copytree(masks, tmp_path / "wrong")
    save_mask(tmp_path / "wrong" / f"{Path(name).stem}.png", USED[1:])
    with pytest.raises(BadInput, match="320 × 239 px and its photograph 320 × 240"):
        scene_from_colmap(hamlet / "known", hamlet / "images", tmp_path / "work", quiet, tmp_path / "wrong")
    (tmp_path / "work" / "masks").mkdir(exist_ok=True)
    (tmp_path / "work" / "masks" / "old.jpg.png").touch()
    result = scene_from_colmap(hamlet / "known", hamlet / "images", tmp_path / "work", quiet, masks)
    assert result.masks_folder is not None and not (result.masks_folder / "old.jpg.png").exists()
