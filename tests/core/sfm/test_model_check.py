"""A COLMAP model that is given is held against its photographs, as alignments of other programs are."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from radiant_core.errors import BadInput
from radiant_core.io.colmap.records import PARAM_COUNTS, ColmapCamera, ColmapModel
from radiant_core.io.colmap.text import write_model
from radiant_core.io.poses.lens import lens_of
from radiant_core.sfm.given_poses import Where, read_given_poses
from radiant_core.sfm.known_poses import NO_POINTS
from radiant_core.sfm.model_check import check_model_poses
from radiant_core.sfm.reconstruct import scene_from_colmap
from tests.colmap_projects import HAMLET, hamlet_model, quiet, write_project
from tests.core.io.poses.bent_hamlet import Truth, bent_hamlet
from tests.stress.pose_formats import true_model

IMAGES = HAMLET / "images"


@pytest.fixture(scope="module")
def bent(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Truth]:
    folder = tmp_path_factory.mktemp("bent")
    return folder / "images", bent_hamlet(folder)


def turned(model: ColmapModel) -> ColmapModel:
    """Poses that lead from the camera to the world."""
    images = []
    for image in model.images:
        R = image.cam_from_world[:3, :3]
        x, y, z, w = Rotation.from_matrix(R.T).as_quat()
        images.append(replace(image, quat_wxyz=np.array([w, x, y, z]), translation=-R.T @ image.translation))
    return replace(model, images=tuple(images))


def flipped(model: ColmapModel) -> ColmapModel:
    """Camera axes with y up and z back."""
    F = np.diag([1.0, -1.0, -1.0])
    images = []
    for image in model.images:
        x, y, z, w = Rotation.from_matrix(F @ image.cam_from_world[:3, :3]).as_quat()
        images.append(replace(image, quat_wxyz=np.array([w, x, y, z]), translation=F @ image.translation))
    return replace(model, images=tuple(images))


def other_sign(model: ColmapModel) -> ColmapModel:
    """Radial coefficients of the other sign."""
    (camera,) = model.cameras.values()
    params = [*camera.params]
    for at in (4, 5, 8):
        params[at] = -params[at]
    return replace(model, cameras={camera.camera_id: replace(camera, params=tuple(params))})


def bare(model: ColmapModel) -> ColmapModel:
    """Without points and observations, as imported poses are."""
    images = [replace(image, points2d=np.zeros((0, 2)), point3d_ids=np.zeros(0, np.int64)) for image in model.images]
    return replace(model, images=tuple(images), points=NO_POINTS)


def test_a_model_that_fits_is_taken_by_its_figure(bent: tuple[Path, Truth]) -> None:
    photos, truth = bent
    seen = check_model_poses(hamlet_model(), Path("sparse"), IMAGES)
    # The hamlet's observations are its points' projections; matches of JPEGs are a tenth of a pixel off.
    assert seen.unit == "px" and seen.figure is not None and seen.figure < 0.01 and "observed points" in seen.reason
    matched = check_model_poses(bare(true_model(truth)), Path("sparse"), photos)
    assert matched.unit == "px" and matched.figure is not None and matched.figure < 0.5 and "matches in" in matched.reason


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (turned, "poses that lead from the camera to the world"),
        (flipped, "camera axes with y up and z back"),
        (other_sign, "radial coefficients of the other sign"),
    ],
)
def test_a_model_of_another_convention_is_refused_by_its_figure(bent: tuple[Path, Truth], wrong, said: str) -> None:
    photos, truth = bent
    with pytest.raises(BadInput) as refused:
        check_model_poses(bare(wrong(true_model(truth))), Path("sparse"), photos)
    assert "sparse of COLMAP does not fit its photographs: matched points lie" in str(refused.value) and said in str(refused.value)
    if wrong is other_sign:
        return
    # Poses that are to be adjusted are rough, not of another convention; and points may contradict them too.
    with pytest.raises(BadInput, match="does not fit"):
        check_model_poses(bare(wrong(true_model(truth))), Path("sparse"), photos, rough=True)
    with pytest.raises(BadInput, match="does not fit"):
        check_model_poses(wrong(hamlet_model()), Path("sparse"), IMAGES)


def test_a_project_of_another_convention_makes_no_scene(bent: tuple[Path, Truth], tmp_path: Path) -> None:
    photos, truth = bent
    project = write_project(tmp_path / "project", bare(turned(true_model(truth))))
    with pytest.raises(BadInput, match=r"of COLMAP does not fit its photographs: matched points lie"):
        scene_from_colmap(project / "sparse" / "0", photos, tmp_path / "work", quiet)


def test_the_equations_are_colmaps(tmp_path: Path) -> None:
    import pycolmap

    del tmp_path
    rays = np.random.default_rng(0).uniform((-0.6, -0.5, 1), (0.6, 0.5, 1), (50, 3))
    for name, count in PARAM_COUNTS.items():
        if name == "EQUIRECTANGULAR":
            continue
        num_focals = ColmapCamera(camera_id=1, model=name, size_wh=(640, 480), params=(1.0,) * count).num_focals
        params = [*[500.0, 510.0][:num_focals], 321.0, 239.0]
        params += [0.04, -0.02, 0.003, -0.002, 0.01][: count - len(params)]
        params += [0.0] * (count - len(params))
        lens = lens_of(ColmapCamera(camera_id=1, model=name, size_wh=(640, 480), params=tuple(params)))
        if lens is None:
            assert name in ("FOV", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE", "SIMPLE_DIVISION", "DIVISION", "EUCM"), name
            continue
        camera = pycolmap.Camera(model=name, width=640, height=480, params=params)
        assert lens.img_from_cam(rays) == pytest.approx(np.array([camera.img_from_cam(ray) for ray in rays]).reshape(-1, 2), abs=1e-6), name
    rational = ColmapCamera(camera_id=1, model="FULL_OPENCV", size_wh=(640, 480), params=(500.0, 500, 320, 240, 0, 0, 0, 0, 0, 0.1, 0, 0))
    assert lens_of(rational) is None


def test_a_lens_without_equations_here_says_that_it_is_not_checked(bent: tuple[Path, Truth]) -> None:
    photos, truth = bent
    model = true_model(truth)
    (camera,) = model.cameras.values()
    odd = replace(camera, model="EUCM", params=(*camera.params[:4], 0.5, 1.0))
    decision = check_model_poses(replace(model, cameras={camera.camera_id: odd}), Path("sparse"), photos)
    assert decision.reason == "the poses are not checked: no equations of EUCM here"


def test_a_model_of_some_photographs_is_held_against_what_these_see() -> None:
    whole = hamlet_model()
    part = replace(whole, images=[whole.images[0], whole.images[3]])
    seen = check_model_poses(part, Path("sparse"), IMAGES)
    assert seen.unit == "px" and seen.figure is not None and seen.figure < 0.01


def test_known_poses_of_devices_are_held_against_their_photographs_too(tmp_path: Path) -> None:
    shutil.copytree(IMAGES, tmp_path / "images")
    write_model(tmp_path / "right", hamlet_model())
    poses = read_given_poses(tmp_path / "images", tmp_path / "right")
    assert poses.check is not None and poses.check.figure is not None and poses.check.figure < 0.01
    write_model(tmp_path / "wrong", flipped(hamlet_model()))
    where: Where
    for where in ("together", "own"):
        with pytest.raises(BadInput, match=r"wrong of COLMAP does not fit itself: 0% of its points fall into two or more photographs"):
            read_given_poses(tmp_path / "images", tmp_path / "wrong", where)
