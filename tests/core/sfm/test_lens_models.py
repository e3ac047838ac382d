"""Every lens that COLMAP writes: read, undistorted to the pinhole that pycolmap itself projects with,
or refused by its name."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.io.colmap.model import read_model
from radiant_core.io.colmap.records import PARAM_COUNTS, ColmapCamera
from radiant_core.io.colmap.text import write_model
from radiant_core.sfm.colmap.calls import pycolmap
from radiant_core.sfm.colmap.plain_fisheyes import bend_plain_fisheyes
from radiant_core.sfm.colmap.undistort import undistort
from radiant_core.sfm.masks import undistort_masks
from radiant_core.sfm.world_frame.world import cameras_of

MIDDLE = [163.0, 117.0]
FISHEYE_MODELS = [name for name in PARAM_COUNTS if "FISHEYE" in name]
LENSES: dict[str, tuple[str, list[float]]] = {
    "SIMPLE_DIVISION": ("SIMPLE_DIVISION", [260.0, *MIDDLE, -0.08]),
    "DIVISION": ("DIVISION", [260.0, 255.0, *MIDDLE, -0.08]),
    "SIMPLE_FISHEYE": ("SIMPLE_FISHEYE", [190.0, *MIDDLE]),
    "FISHEYE": ("FISHEYE", [190.0, 186.0, *MIDDLE]),
    "EUCM": ("EUCM", [230.0, 228.0, *MIDDLE, 0.6, 1.1]),
    "OPENCV_FISHEYE": ("OPENCV_FISHEYE", [190.0, 186.0, *MIDDLE, 0.02, -0.01, 0.0, 0.0]),
    "OPENCV_FISHEYE of zeros": ("OPENCV_FISHEYE", [190.0, 186.0, *MIDDLE, 0.0, 0.0, 0.0, 0.0]),
    "SIMPLE_RADIAL_FISHEYE of zeros": ("SIMPLE_RADIAL_FISHEYE", [190.0, *MIDDLE, 0.0]),
    "RADIAL_FISHEYE of zeros": ("RADIAL_FISHEYE", [190.0, *MIDDLE, 0.0, 0.0]),
    "THIN_PRISM_FISHEYE of zeros": ("THIN_PRISM_FISHEYE", [190.0, 186.0, *MIDDLE, *[0.0] * 8]),
    "RAD_TAN_THIN_PRISM_FISHEYE of zeros": ("RAD_TAN_THIN_PRISM_FISHEYE", [190.0, 186.0, *MIDDLE, *[0.0] * 12]),
    "FOV": ("FOV", [260.0, 255.0, *MIDDLE, 0.5]),
    "SIMPLE_RADIAL of zeros": ("SIMPLE_RADIAL", [260.0, *MIDDLE, 0.0]),
    "RADIAL of zeros": ("RADIAL", [260.0, *MIDDLE, 0.0, 0.0]),
    "OPENCV of zeros": ("OPENCV", [260.0, 255.0, *MIDDLE, *[0.0] * 4]),
    "FULL_OPENCV of zeros": ("FULL_OPENCV", [260.0, 255.0, *MIDDLE, *[0.0] * 8]),
    "SIMPLE_DIVISION of zeros": ("SIMPLE_DIVISION", [260.0, *MIDDLE, 0.0]),
}
"""Models 12 to 16 of COLMAP 4, and every lens whose coefficients may all be 0."""
SPOTS = np.array([[0.0, 0.0], [0.35, 0.2], [-0.4, 0.25], [0.3, -0.3], [-0.25, -0.3]])
"""Directions x / z, y / z of bright spots."""


def camera_of(lens: str) -> pycolmap.Camera:
    model, params = LENSES[lens]
    return pycolmap.Camera(model=model, width=320, height=240, params=params, camera_id=1)


def picture_of(camera: pycolmap.Camera) -> np.ndarray:
    """Spots where pycolmap's own `img_from_cam` puts the directions, with the middle of the first
    pixel at (0.5, 0.5)."""
    rows, columns = np.mgrid[0:240, 0:320] + 0.5
    picture = np.zeros((240, 320))
    for x, y in np.asarray(camera.img_from_cam(np.column_stack([SPOTS, np.ones(len(SPOTS))]))):
        picture += 250 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * 2.0**2))
    return np.repeat(np.clip(picture, 0, 255).astype(np.uint8)[:, :, None], 3, axis=2)


def written_model(lens: str, folder: Path, suffix: str, form: str) -> Path:
    """A model of three photographs behind a lens, as pycolmap writes it, binary or text, with or
    without rigs and frames."""
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(camera_of(lens))
    (folder / "images").mkdir(parents=True)
    for number in (1, 2, 3):
        name = f"{number}{suffix}"
        model.add_image_with_trivial_frame(pycolmap.Image(name=name, camera_id=1, image_id=number), pycolmap.Rigid3d())
        cv2.imwrite(str(folder / "images" / name), picture_of(camera_of(lens)))
    (folder / "sparse").mkdir()
    (model.write_text if form.startswith("text") else model.write_binary)(folder / "sparse")
    for path in (folder / "sparse").iterdir():
        if "alone" in form and path.stem in ("rigs", "frames"):
            path.unlink()
    return folder / "sparse"


def spot_near(picture: np.ndarray, x: float, y: float) -> tuple[float, float]:
    """Where the bright spot by (x, y) lies, by its centre of mass."""
    left, top = round(x) - 12, round(y) - 12
    window = picture[max(top, 0) : top + 25, max(left, 0) : left + 25].astype(np.float64)
    rows, columns = np.mgrid[0 : window.shape[0], 0 : window.shape[1]] + 0.5
    return float((window * columns).sum() / window.sum()) + max(left, 0), float((window * rows).sum() / window.sum()) + max(top, 0)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
@pytest.mark.parametrize("lens", LENSES)
def test_a_direction_is_seen_after_undistortion_where_the_pinhole_projects_it(lens: str, suffix: str, tmp_path: Path) -> None:
    """The right place is K (x, y, 1); the spots were drawn by pycolmap 4.2.1's img_from_cam."""
    model_folder = written_model(lens, tmp_path, suffix, "binary")
    if all(camera.is_pinhole for camera in read_model(model_folder).cameras.values()):
        cameras, images = cameras_of(read_model(model_folder)), tmp_path / "images"
    else:
        made = undistort(model_folder, tmp_path / "images", tmp_path / "work", 1, lambda progress: None)
        cameras, images = cameras_of(read_model(made.model_folder)), made.image_folder
    picture = cv2.imread(str(images / f"2{suffix}"), cv2.IMREAD_GRAYSCALE)
    assert picture is not None and picture.shape == tuple(cameras.sizes_wh[1][::-1])
    for x, y in SPOTS:
        u, v, _ = cameras.Ks[1] @ [x, y, 1.0]
        # 0.3 px: a spot of 2 px is stretched unevenly at 24° from the middle; taken for straight it
        # would be off by 2 to 20 px, by half a pixel where a convention is mixed up.
        assert np.hypot(*np.subtract(spot_near(picture, u, v), (u, v))) < 0.3, (x, y)


@pytest.mark.parametrize("form", ["binary", "binary alone", "text", "text alone"])
@pytest.mark.parametrize("lens", LENSES)
def test_a_lens_is_read_in_every_form_that_colmap_writes(lens: str, form: str, tmp_path: Path) -> None:
    camera = read_model(written_model(lens, tmp_path, ".png", form)).cameras[1]
    assert (camera.model, list(camera.params)) == LENSES[lens] and camera.size_wh == (320, 240)


@pytest.mark.parametrize("form", ["binary", "text"])
def test_a_panorama_is_refused_by_its_name(form: str, tmp_path: Path) -> None:
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(pycolmap.Camera(model="EQUIRECTANGULAR", width=320, height=160, params=[320, 160], camera_id=1))
    model.add_image_with_trivial_frame(pycolmap.Image(name="a.png", camera_id=1, image_id=1), pycolmap.Rigid3d())
    (model.write_text if form == "text" else model.write_binary)(tmp_path)
    with pytest.raises(BadInput, match=r"EQUIRECTANGULAR, a panorama of 360°, .* or give the model of faces that COLMAP's panorama_sfm"):
        read_model(tmp_path)


def test_a_camera_model_that_is_not_known_is_named(hamlet: Path, tmp_path: Path) -> None:
    shutil.copytree(hamlet / "known", tmp_path / "known")
    path = tmp_path / "known" / "cameras.txt"
    path.write_text(path.read_text().replace("PINHOLE", "HOLOGRAM"))
    with pytest.raises(BadInput, match=r"'HOLOGRAM' is none of the models SIMPLE_PINHOLE, .*, EQUIRECTANGULAR\."):
        read_model(tmp_path / "known")


def test_the_mask_of_a_plain_fisheye_is_undistorted_too(tmp_path: Path) -> None:
    model_folder = written_model("FISHEYE", tmp_path, ".png", "binary")
    given = tmp_path / "given"
    given.mkdir()
    mask = np.where(picture_of(camera_of("FISHEYE"))[:, :, 0] > 60, 255, 0).astype(np.uint8)
    cv2.imwrite(str(given / "2.png.png"), mask)
    masks = undistort_masks(given, model_folder, tmp_path / "work", 1)
    assert masks is not None
    undistorted = cv2.imread(str(masks / "2.png.png"), cv2.IMREAD_GRAYSCALE)
    straight = pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(), camera_of("FISHEYE"))
    assert undistorted is not None and undistorted.shape == (straight.height, straight.width)
    u, v = np.asarray(straight.img_from_cam(np.array([[0.35, 0.2, 1.0]])))[0]
    assert undistorted[int(v), int(u)] == 255 and undistorted[int(117 + 0.2 * 186), int(163 + 0.35 * 190)] == 0


def test_what_is_written_is_the_camera_that_pycolmap_reads(hamlet: Path, tmp_path: Path) -> None:
    """Half a pixel: our K projects as pycolmap's `img_from_cam` of the files that we write."""
    model = read_model(hamlet / "known")
    write_model(tmp_path, replace(model, cameras={n: replace(c, params=(250.0, 251.0, 163.5, 117.25)) for n, c in model.cameras.items()}))
    theirs, ours = pycolmap.Reconstruction(tmp_path), read_model(tmp_path)
    cameras = cameras_of(ours)
    for index, image in enumerate(ours.images):
        in_camera = ours.points.xyz @ cameras.cam_from_world[index][:3, :3].T + cameras.cam_from_world[index][:3, 3]
        in_camera = in_camera[in_camera[:, 2] > 0]
        expected = theirs.cameras[image.camera_id].img_from_cam(in_camera)
        projected = in_camera @ cameras.Ks[index].T
        # 1e-9 px: float64 in another order.
        assert np.allclose(projected[:, :2] / projected[:, 2:], expected, atol=1e-9)


@pytest.mark.parametrize("lens", [name for name in LENSES if name.endswith("of zeros")])
@pytest.mark.parametrize("coefficient", [0.0, 9e-9, -9e-9, 1.1e-8, -1.1e-8])
def test_what_counts_as_straight_is_as_in_colmap(lens: str, coefficient: float) -> None:
    """What COLMAP would copy is a pinhole to us, or a fisheye that gets a coefficient."""
    theirs = camera_of(lens)
    theirs.params = [*theirs.params[:-1], coefficient]
    width, height = theirs.width, theirs.height
    ours = ColmapCamera(camera_id=1, model=theirs.model.name, size_wh=(width, height), params=tuple(map(float, theirs.params)))
    assert ours.is_pinhole == (theirs.is_undistorted() and theirs.model.name not in FISHEYE_MODELS)
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(theirs)
    assert bend_plain_fisheyes(model) == (theirs.is_undistorted() and not ours.is_pinhole)
    assert ours.is_pinhole or not model.cameras[1].is_undistorted()
