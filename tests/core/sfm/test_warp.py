"""Photographs without distortion: the pixels and the folder are those of COLMAP, EXIF goes along."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.io.photos.jpeg import kept_segments, read_jpeg_facts
from radiant_core.sfm.colmap.calls import pycolmap
from radiant_core.sfm.colmap.undistort import undistort
from radiant_core.sfm.colmap.warp import can_warp, warp, warp_jpeg
from radiant_core.sfm.config import SfmProgress

LENSES = {
    "SIMPLE_RADIAL": [300.0, 161.0, 117.5, -0.15],
    "RADIAL": [310.0, 158.0, 121.0, 0.12, -0.05],
    "OPENCV": [305.0, 299.0, 160.0, 120.0, -0.1, 0.02, 0.003, -0.002],
    "OPENCV_FISHEYE": [220.0, 219.0, 160.0, 120.0, 0.05, -0.02, 0.01, -0.003],
}


def camera_of(model: str, width: int = 320, height: int = 240) -> pycolmap.Camera:
    return pycolmap.Camera(model=model, width=width, height=height, params=LENSES[model])


def drawn(channels: int) -> NDArray[np.uint8]:
    """A picture with smooth and with sharp parts."""
    rng = np.random.default_rng(3)
    coarse = rng.integers(0, 256, (24, 32, channels), dtype=np.uint8)
    pixels = np.asarray(cv2.resize(coarse, (320, 240), interpolation=cv2.INTER_CUBIC), np.uint8).reshape(240, 320, channels)
    pixels[100:140, 120:200] = rng.integers(0, 256, (40, 80, channels), dtype=np.uint8)
    return pixels


@pytest.mark.parametrize("model", LENSES)
def test_pixels_are_those_of_colmap(model: str, tmp_path: Path) -> None:
    pixels, camera = drawn(3), camera_of(model)
    cv2.imwrite(str(tmp_path / "a.png"), pixels)
    options = pycolmap.UndistortCameraOptions()
    expected, pinhole = pycolmap.undistort_image(options, pycolmap.Bitmap.read(tmp_path / "a.png", True), camera)
    difference = np.abs(warp(pixels, camera, pinhole).astype(int) - np.asarray(expected.to_array())[:, :, ::-1])
    # OpenCV places pixels to 1/32: of noise with steps of 255 that is up to 255 (1/64 + 1/64). At
    # the border COLMAP shows black where OpenCV mixes with black.
    assert difference[2:-2, 2:-2].max() <= 9 and np.mean(difference[2:-2, 2:-2] > 1) < 0.05


@pytest.mark.parametrize("num_channels", [1, 3])
def test_a_jpeg_keeps_its_channels_its_exif_and_its_orientation(num_channels: int, tmp_path: Path, hamlet: Path) -> None:
    source = next(iter(sorted((hamlet / "images").iterdir()))).read_bytes()
    segments = kept_segments(source)
    assert segments and read_jpeg_facts(source).exif.lat_lon_alt is not None
    _, encoded = cv2.imencode(".jpg", drawn(num_channels), [cv2.IMWRITE_JPEG_QUALITY, 95])
    path = tmp_path / "a.jpg"
    path.write_bytes(b"\xff\xd8" + segments + encoded.tobytes()[2:])
    camera = camera_of("SIMPLE_RADIAL")
    pinhole = pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(), camera)
    made = warp_jpeg(path, camera, pinhole, 95)
    assert read_jpeg_facts(made).exif == read_jpeg_facts(source).exif
    back = cv2.imdecode(np.frombuffer(made, np.uint8), cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION)
    assert back is not None and back.shape[:2] == (pinhole.height, pinhole.width) and back.ndim == (2 if num_channels == 1 else 3)


def model_of(images: Path, names: list[str], folder: Path) -> Path:
    """A COLMAP model with these photographs behind one lens, every pose the same."""
    model = pycolmap.Reconstruction()
    camera = camera_of("SIMPLE_RADIAL")
    camera.camera_id = 1
    model.add_camera_with_trivial_rig(camera)
    for number, name in enumerate(names, 1):
        model.add_image_with_trivial_frame(pycolmap.Image(name=name, camera_id=1, image_id=number), pycolmap.Rigid3d())
        (images / name).parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(images / name), drawn(3))
    folder.mkdir()
    model.write_binary(folder)
    return folder


@pytest.mark.parametrize("names", [["a.jpg", "b.png", "c/d.JPG"], ["a.jpg", "z.jpg"], ["b.png"]])
def test_the_folder_is_that_of_colmap_whatever_the_formats(names: list[str], tmp_path: Path) -> None:
    model = model_of(tmp_path / "images", names, tmp_path / "model")
    expected = tmp_path / "expected"
    pycolmap.undistort_images(expected, model, tmp_path / "images", jpeg_quality=95)
    seen: list[SfmProgress] = []
    made = undistort(model, tmp_path / "images", tmp_path, 2, seen.append).image_folder.parent

    def files(folder: Path) -> set[str]:
        return {str(path.relative_to(folder)) for path in folder.rglob("*")}

    assert files(made) == files(expected)
    for name in ("sparse/images.bin", "sparse/cameras.bin", "sparse/points3D.bin", "stereo/fusion.cfg", "stereo/patch-match.cfg"):
        assert (made / name).read_bytes() == (expected / name).read_bytes()
    for name in names:
        ours, theirs = (cv2.imread(str(folder / "images" / name)) for folder in (made, expected))
        assert ours is not None and theirs is not None and ours.shape == theirs.shape
        # Both are JPEG of quality 95: of the noise in them that leaves some 30 dB.
        assert np.median(np.abs(ours.astype(int) - theirs)) <= 2
    assert (seen[0].done, seen[-1].done, seen[-1].total) == (0, len(names), len(names))


def test_what_colmap_averages_what_is_too_wide_and_what_does_not_distort_is_left_to_it() -> None:
    lens = camera_of("SIMPLE_RADIAL")
    small, wide = camera_of("SIMPLE_RADIAL", 100, 100), camera_of("SIMPLE_RADIAL", 40_000, 100)
    straight = pycolmap.Camera(model="PINHOLE", width=320, height=240, params=[300, 300, 160, 120])
    assert can_warp("a.JPEG", lens, lens) and not can_warp("a.tif", lens, lens)
    assert not can_warp("a.jpg", lens, small) and not can_warp("a.jpg", wide, wide) and not can_warp("a.jpg", straight, straight)


def test_a_damaged_photograph_and_one_of_another_size_are_named_and_nothing_is_left(tmp_path: Path) -> None:
    model = model_of(tmp_path / "images", ["a.jpg", "b.jpg"], tmp_path / "model")
    path = tmp_path / "images" / "b.jpg"
    whole = path.read_bytes()
    cv2.imwrite(str(path), drawn(3)[:100])
    for damaged in (path.read_bytes(), whole[: len(whole) // 2], b"", b"\xff\xd8\xff\xe1\xff\xff"):
        path.write_bytes(damaged)
        with pytest.raises(BadInput, match=r"b\.jpg cannot be decoded in the size of its camera"):
            undistort(model, tmp_path / "images", tmp_path / "work", 1, lambda _: None)
        assert not (tmp_path / "work" / "undistorted").exists()
    path.write_bytes(whole)
    assert len(list(undistort(model, tmp_path / "images", tmp_path / "work", 1, lambda _: None).image_folder.iterdir())) == 2
