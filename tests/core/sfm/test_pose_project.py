"""From an alignment to a scene and back to its coordinates: the file's own, in metres, on a map or geocentric, within 1 mm."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.geometry.align import fit_sim3
from radiant_core.georef.crs import parse_crs
from radiant_core.io.colmap.model import read_model
from radiant_core.io.photos.masks import save_mask
from radiant_core.sfm.config import SfmResult
from radiant_core.sfm.given_poses import Where, read_given_poses
from radiant_core.sfm.pose_project import Alignment, scene_from_alignment
from radiant_core.sfm.world_frame.placement import Placement
from radiant_core.survey.map_grid import map_frame_of
from tests.colmap_projects import quiet
from tests.core.io.poses import writers
from tests.core.io.poses.bent_hamlet import BROWN, Truth, bent_hamlet
from tests.core.io.poses.test_readers import ECEF


@pytest.fixture(scope="module")
def bent(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Truth]:
    folder = tmp_path_factory.mktemp("bent")
    return folder / "images", bent_hamlet(folder)


def given_points(truth: Truth, place: str) -> tuple[np.ndarray, np.ndarray]:
    """Centres and points in the file's coordinates."""
    if place == "ecef":
        return truth.C @ ECEF[:3, :3].T + ECEF[:3, 3], truth.points @ ECEF[:3, :3].T + ECEF[:3, 3]
    shift = writers.UTM if place == "utm" else np.zeros(3)
    return truth.C + shift, truth.points + shift


def require_back(result: SfmResult, truth: Truth, place: str) -> None:
    """The scene's cameras are the given ones after the way back, and what files hold differs by the offset alone."""
    given = result.given_frame
    assert given is not None and given.is_default
    numbers = [truth.names.index(name) for name in result.scene.cameras.names]
    centers, _ = given_points(truth, place)
    assert np.abs(given.given_from_scene.apply(result.scene.cameras.centers) - centers[numbers]).max() < 1e-3
    assert np.abs(given.apply(result.scene.cameras.centers) + given.offset - centers[numbers]).max() < 1e-3
    # What float32 keeps of a file's coordinates.
    assert np.abs(given.apply(result.scene.cameras.centers)).max() < 1e4


CASES = {
    "metres": (writers.metashape, "local", "scaled"),
    "utm": (lambda folder, truth: writers.pix4d(folder, truth, prj="EPSG:25832"), "utm", "metric"),
    "ecef": (lambda folder, truth: writers.metashape(folder, truth, ecef=ECEF), "ecef", "metric"),
    "enu": (writers.opensfm, "local", "metric"),
}


@pytest.mark.parametrize("name", CASES)
def test_the_frame_stays_that_of_the_file(name: str, tmp_path: Path, bent) -> None:
    photos, truth = bent
    write, place, kind = CASES[name]
    result = scene_from_alignment(Alignment(path=write(tmp_path, truth), photos=photos), tmp_path / "work", quiet)
    require_back(result, truth, place)
    scene = result.scene
    assert scene.frame.kind == kind and len(scene.cameras) == 12 and len(scene.points) > 300
    # Metres stay metres, but for the 4e-4 of a map's scale.
    assert abs(result.given_frame.given_from_scene.scale - 1) < 5e-4  # type: ignore[union-attr]
    if kind == "metric":
        assert np.allclose(scene.frame.origin_lat_lon_alt[:2], writers.LLA[:2], atol=0.01)
    # z is up by a degree: the hamlet's photographs look down.
    looks = scene.cameras.cam_from_world[:, 2, 2]
    assert np.abs(looks - truth.R[[truth.names.index(each) for each in scene.cameras.names], 2, 2]).max() < 0.02
    if name == "utm":
        map_frame = map_frame_of(scene.frame, parse_crs("EPSG:25832"), result.given_frame.given_from_scene)  # type: ignore[union-attr]
        places = writers.UTM + np.array([[0.0, 0, 0], [2000, -1500, 80]])
        # Rasters too: over the globe the second would lie 0.5 m too low.
        assert np.abs(map_frame.from_world(map_frame.to_world(places)) - places).max() < 1e-6
        assert np.abs(map_frame.from_world(scene.cameras.centers) - given_points(truth, place)[0]).max() < 1e-3
    assert result.warnings[0].startswith(("cameras.xml of", "p_calibrated_camera_parameters.txt of", "reconstruction.json of"))
    assert not any("not used" in warning and "xml" in warning for warning in result.warnings)


def test_a_lens_that_colmap_has_no_model_for_is_straightened(tmp_path: Path) -> None:
    truth = bent_hamlet(tmp_path, BROWN, k4=0.02, skew=1.5)
    for name in truth.names:
        save_mask(tmp_path / "masks" / f"{name}.png", np.arange(240 * 320).reshape(240, 320) % 320 > 20)
    path = writers.metashape(tmp_path, truth)
    result = scene_from_alignment(Alignment(path=path, photos=tmp_path / "images"), tmp_path / "work", quiet, tmp_path / "masks")
    assert result.undistorted_folder != tmp_path / "images" and result.masks_folder is not None
    # The true points project where a pinhole has them, and there the picture is the hamlet's own.
    from tests.colmap_projects import HAMLET

    cameras = result.scene.cameras
    for index in (0, 7):
        straight = cv2.imread(str(result.undistorted_folder / cameras.names[index]))
        own = cv2.imread(str(HAMLET / "images" / cameras.names[index]))
        assert straight is not None and own is not None
        K = cameras.Ks[index]
        columns, rows = np.meshgrid(np.arange(320) + 0.5, np.arange(240) + 0.5)
        x, y = (columns - K[0, 2]) / K[0, 0], (rows - K[1, 2]) / K[1, 1]
        maps = [(213.3333333 * x + 160 - 0.5).astype(np.float32), (213.3333333 * y + 120 - 0.5).astype(np.float32)]
        expected = cv2.remap(own, maps[0], maps[1], cv2.INTER_LINEAR)
        middle = (slice(40, 200), slice(50, 270))
        off = np.abs(expected[middle].astype(float) - straight[middle])
        shifted = np.abs(np.roll(expected, 1, axis=1)[middle].astype(float) - straight[middle])
        # Three interpolations and two JPEGs; one pixel to the side is twice as far off.
        assert off.mean() < 0.6 * shifted.mean()


def test_what_the_file_says_of_its_frame_is_not_said_otherwise(tmp_path: Path, bent) -> None:
    photos, truth = bent
    given = Alignment(path=writers.metashape(tmp_path, truth), photos=photos)
    with pytest.raises(BadInput, match="used as it is: leave out --up"):
        scene_from_alignment(given, tmp_path / "work", quiet, None, Placement(height_m=30.0))


def test_photographs_of_another_size_scale_the_lens_and_turned_ones_are_refused(tmp_path: Path, bent) -> None:
    photos, truth = bent
    for name in truth.names:
        pixels = cv2.imread(str(photos / name))
        assert pixels is not None
        for folder, changed in (("half", cv2.resize(pixels, (160, 120), interpolation=cv2.INTER_AREA)), ("turned", np.rot90(pixels))):
            (tmp_path / folder).mkdir(exist_ok=True)
            cv2.imwrite(str(tmp_path / folder / name), changed)
    path = writers.openmvg(tmp_path, truth)
    result = scene_from_alignment(Alignment(path=path, photos=tmp_path / "half"), tmp_path / "work", quiet)
    assert len(result.scene.points) > 300 and result.scene.cameras.sizes_wh.max() < 170
    with pytest.raises(BadInput, match="EXIF orientation"):
        scene_from_alignment(Alignment(path=path, photos=tmp_path / "turned"), tmp_path / "work", quiet)


@pytest.mark.parametrize("where", ["together", "by device", "own"])
def test_devices_are_given_the_poses_of_an_alignment(where: Where, tmp_path: Path, bent) -> None:
    photos, truth = bent
    path = writers.opensfm(tmp_path, truth)
    for number, name in enumerate(truth.names):
        folder = tmp_path / "photos" / (("north", "south")[number % 2] if where == "by device" else "")
        folder.mkdir(parents=True, exist_ok=True)
        if where != "own" or number % 2:
            (folder / name).write_bytes((photos / name).read_bytes())
    poses = read_given_poses(tmp_path / "photos", path, where)
    numbers = [truth.names.index(name) for name in poses.cameras.names]
    assert len(numbers) == (6 if where == "own" else 12)
    assert np.abs(poses.cameras.centers - truth.C[numbers]).max() < 1e-9
    assert poses.frame.is_same and poses.frame.is_default
    assert poses.deal(poses.cameras.names[:3], tmp_path) and len(read_model(tmp_path / "poses").images) == 3


def test_devices_get_a_frame_that_all_share_and_lenses_that_they_can_undistort(tmp_path: Path, bent) -> None:
    photos, truth = bent
    path = writers.pix4d(tmp_path, truth, prj="EPSG:25832")
    poses = read_given_poses(photos, path, "together")
    numbers = [truth.names.index(name) for name in poses.cameras.names]
    assert poses.frame.crs == "EPSG:25832"
    assert np.abs(poses.frame.given_from_scene.apply(poses.cameras.centers) - truth.C[numbers] - writers.UTM).max() < 1e-6
    with pytest.raises(BadInput, match="take the same whole numbers off"):
        read_given_poses(photos, path, "own")
    bending = bent_hamlet(tmp_path, BROWN, k4=0.02, skew=1.5)
    with pytest.raises(BadInput, match="k4 or skew, which devices cannot undistort"):
        read_given_poses(tmp_path / "images", writers.metashape(tmp_path, bending), "together")


def test_rough_poses_are_refused_and_adjusted_where_asked_in_the_same_frame(tmp_path: Path, bent) -> None:
    photos, truth = bent
    rng = np.random.default_rng(0)
    turns = np.array([cv2.Rodrigues(rng.normal(0, np.radians(0.8), 3))[0] for _ in truth.names])
    centers = truth.C + rng.normal(0, 0.25, truth.C.shape)
    R = turns @ truth.R
    rough = replace(truth, R=R, t=-np.einsum("cij,cj->ci", R, centers))
    path = writers.pix4d(tmp_path, rough, prj="EPSG:25832")
    with pytest.raises(BadInput, match=r"expected at most 2.0 px: .* let --refine-poses adjust"):
        scene_from_alignment(Alignment(path=path, photos=photos), tmp_path / "work", quiet)
    result = scene_from_alignment(Alignment(path=path, photos=photos, refine_poses=True), tmp_path / "work", quiet)
    cameras = result.scene.cameras
    numbers = [truth.names.index(name) for name in cameras.names]
    assert result.given_frame is not None
    adjusted = result.given_frame.given_from_scene.apply(cameras.centers) - writers.UTM
    # Relative to each other within what 320 px tell from 32 m, 0.43 m before; the frame is that of all rough centres.
    fit = fit_sim3(adjusted, truth.C[numbers])
    off_m = np.linalg.norm(fit.apply(adjusted) - truth.C[numbers], axis=1)
    assert np.median(off_m) < 0.05 and off_m.max() < 0.2
    assert np.linalg.norm((adjusted - centers[numbers]).mean(axis=0)) < 1e-6
    assert abs(fit.scale - 1) < 0.02
    decision = next(decision for decision in result.decisions if decision.topic == "refined poses")
    assert decision.figure is not None and 0.1 < decision.figure < 1
