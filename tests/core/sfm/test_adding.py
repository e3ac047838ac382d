"""New photographs of the hamlet find their true places among old ones, which do not move."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_core.errors import BadInput
from radiant_core.io.photos.listing import load_thumbnail
from radiant_core.scene import SfmScene
from radiant_core.sfm.adding import AddedPhotographs, add_photographs
from radiant_core.sfm.config import SfmConfig
from radiant_core.sfm.reconstruct import scene_from_colmap

NUM_OLD = 9
IMAGES = sample_scenes_folder() / "hamlet" / "images"


@pytest.fixture(scope="module")
def true_scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    work = tmp_path_factory.mktemp("hamlet")
    return scene_from_colmap(IMAGES.parent / "known", IMAGES, work, lambda progress: None).scene


@pytest.fixture(scope="module")
def flown_again(tmp_path_factory: pytest.TempPathFactory, true_scene: SfmScene) -> Path:
    folder = tmp_path_factory.mktemp("again") / "second"
    folder.mkdir()
    for name in true_scene.cameras.names[NUM_OLD:]:
        shutil.copyfile(IMAGES / name, folder / name)
    # Nothing of the hamlet: it finds no place.
    noise = np.random.default_rng(4).integers(0, 255, (24, 32, 3), dtype=np.uint8)
    cv2.imwrite(str(folder / "elsewhere.jpg"), cv2.resize(noise, (320, 240), interpolation=cv2.INTER_CUBIC))
    return folder


@pytest.fixture(scope="module")
def added(tmp_path_factory: pytest.TempPathFactory, true_scene: SfmScene, flown_again: Path) -> AddedPhotographs:
    old = true_scene.restricted_to(np.arange(NUM_OLD))
    return add_photographs(old, IMAGES, flown_again, tmp_path_factory.mktemp("work"), SfmConfig(num_threads=1), lambda progress: None)


def test_the_new_ones_stand_where_they_were_flown_and_the_old_ones_where_they_stood(true_scene: SfmScene, added: AddedPhotographs) -> None:
    old = true_scene.restricted_to(np.arange(NUM_OLD))
    cameras = added.scene.cameras
    assert cameras.names == (*old.cameras.names, *(f"second/{name}" for name in true_scene.cameras.names[NUM_OLD:]))
    assert cameras.cam_from_world[:NUM_OLD].tobytes() == old.cameras.cam_from_world.tobytes()
    assert added.scene.points[: len(old.points)].tobytes() == old.points.tobytes()
    assert (added.scene.observations[: len(old.observations)] == old.observations).all()
    # Two pixels of 0.15 m on the ground, from 32 m above it.
    away_m = np.linalg.norm(cameras.centers[NUM_OLD:] - true_scene.cameras.centers[NUM_OLD:], axis=1)
    assert away_m.max() < 0.3
    turned = cameras.cam_from_world[NUM_OLD:, :3, :3] @ true_scene.cameras.cam_from_world[NUM_OLD:, :3, :3].transpose(0, 2, 1)
    angles_deg = np.degrees(np.arccos(np.clip((np.trace(turned, axis1=1, axis2=2) - 1) / 2, -1, 1)))
    assert angles_deg.max() < 0.5


def test_new_points_are_seen_by_a_new_photograph_and_lie_on_the_ground(true_scene: SfmScene, added: AddedPhotographs) -> None:
    num_old = len(true_scene.restricted_to(np.arange(NUM_OLD)).points)
    assert len(added.scene.points) > num_old + 100
    observed = added.scene.observations[added.scene.observations[:, 0] >= num_old]
    for point in np.unique(observed[:, 0]):
        views = observed[observed[:, 0] == point, 1]
        assert len(views) >= 2
        assert views.max() >= NUM_OLD
    low, high = np.quantile(true_scene.points[:, 2], [0, 1])
    inside = (added.scene.points[num_old:, 2] > low - 2) & (added.scene.points[num_old:, 2] < high + 2)
    assert inside.mean() > 0.95
    for name, size_wh in zip(added.scene.cameras.names[NUM_OLD:], added.scene.cameras.sizes_wh[NUM_OLD:], strict=True):
        assert load_thumbnail(added.images / name, 10_000).shape[1::-1] == tuple(size_wh)


def test_what_finds_no_place_is_named(added: AddedPhotographs) -> None:
    assert added.unplaced == ("elsewhere.jpg",)
    assert any("1 of 4 new photographs could not be placed" in warning and "elsewhere.jpg" in warning for warning in added.warnings)


def test_photographs_that_fit_nowhere_or_are_there_already_are_refused(
    tmp_path: Path, true_scene: SfmScene, flown_again: Path, added: AddedPhotographs
) -> None:
    other = tmp_path / "other"
    other.mkdir()
    for number in range(2):
        noise = np.random.default_rng(number).integers(0, 255, (24, 32, 3), dtype=np.uint8)
        cv2.imwrite(str(other / f"{number}.jpg"), cv2.resize(noise, (320, 240), interpolation=cv2.INTER_CUBIC))
    old, config = true_scene.restricted_to(np.arange(NUM_OLD)), SfmConfig(num_threads=1)
    with pytest.raises(BadInput, match=r"none of the 2 photographs .* could be placed against the 9 of the scene \(0.jpg, 1.jpg\)"):
        add_photographs(old, IMAGES, other, tmp_path / "work", config, lambda progress: None)
    with pytest.raises(BadInput, match=r"has a photograph 'second/drone_0009.jpg' already"):
        add_photographs(added.scene, IMAGES, flown_again, tmp_path / "again", config, lambda progress: None)
    repeated = tmp_path / "repeated"
    repeated.mkdir()
    for name in old.cameras.names[:3]:
        shutil.copyfile(IMAGES / name, repeated / name)
    with pytest.raises(BadInput, match="repeat photographs of the scene"):
        add_photographs(old, IMAGES, repeated, tmp_path / "repeats", config, lambda progress: None)
