"""Photographs and COLMAP projects as they come: strips, TIFF, files that nobody reads, names with
spaces or without a suffix."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile

from radiant_core.errors import BadInput
from radiant_core.io.colmap.model import read_model
from radiant_core.io.colmap.text import write_model
from radiant_core.io.photos.listing import list_photographs, load_photograph, photograph_positions
from radiant_core.io.photos.masks import alpha_mask, pixel_weights
from radiant_core.sfm.colmap.workspace import warn_of_unused
from radiant_core.sfm.reconstruct import scene_from_colmap
from radiant_core.waypoints.reader import exif_waypoints


def test_a_strip_is_skipped_by_name(hamlet: Path, tmp_path: Path) -> None:
    for path in sorted((hamlet / "images").iterdir())[:2]:
        shutil.copy(path, tmp_path)
    cv2.imwrite(str(tmp_path / "strip.jpg"), np.zeros((1, 65_500, 3), np.uint8))
    cv2.imwrite(str(tmp_path / "panorama.jpg"), np.zeros((100, 1_000, 3), np.uint8))
    listing = list_photographs(tmp_path)
    assert [skipped.name for skipped in listing.skipped] == ["strip.jpg"] and len(listing.photographs) == 3
    assert "is a strip of 65500 × 1 pixels" in listing.skipped[0].reason


def test_files_that_cannot_be_read_are_counted_by_their_kind(hamlet: Path, tmp_path: Path) -> None:
    for name in ("1.HEIC", "2.heic", "3.dng", "4.MP4"):
        (tmp_path / name).write_bytes(b"x")
    (tmp_path / "notes.txt").write_text("no photograph")
    with pytest.raises(BadInput, match=r"no photographs .* but 1 \.dng, 2 \.heic, 1 \.mp4 files, which cannot be read"):
        list_photographs(tmp_path)
    for path in sorted((hamlet / "images").iterdir())[:2]:
        shutil.copy(path, tmp_path)
    (told,) = warn_of_unused(list_photographs(tmp_path))
    assert told.startswith("1 .dng, 2 .heic, 1 .mp4 files are not read: save photographs as JPEG, PNG or TIFF")


def test_a_plan_names_files_that_cannot_be_read(hamlet: Path, tmp_path: Path) -> None:
    for path in (hamlet / "images").iterdir():
        shutil.copy(path, tmp_path)
    for name in ("a.HEIC", "b.dng", "c.mov"):
        (tmp_path / name).write_bytes(b"unread")
    (told,) = exif_waypoints(tmp_path).warnings
    assert told.startswith("1 .dng, 1 .heic, 1 .mov files are not read: save photographs as JPEG, PNG or TIFF")


@pytest.mark.parametrize("read", [list_photographs, exif_waypoints])
def test_a_folder_of_heic_alone_is_told_to_be_saved_as_jpeg(read: Callable[[Path], Any], tmp_path: Path) -> None:
    for name in ("a.heic", "b.HEIC"):
        (tmp_path / name).write_bytes(b"unread")
    with pytest.raises(BadInput, match=r"but 2 \.heic files, which cannot be read: save photographs as JPEG"):
        read(tmp_path)
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "c.heic").write_bytes(b"unread")
    with pytest.raises(BadInput, match=r"but 3 \.heic files, which cannot be read: save photographs as JPEG"):
        read(tmp_path)


def write_tiff(path: Path, image: np.ndarray) -> bytes:
    assert cv2.imwrite(str(path), image)
    return path.read_bytes()


@pytest.mark.parametrize("bits", [8, 16])
def test_a_tiff_is_read_and_a_truncated_one_skipped(bits: int, tmp_path: Path) -> None:
    coarse = np.random.default_rng(0).integers(0, 256, (8, 12, 3), np.uint8)
    image = np.asarray(cv2.resize(coarse, (96, 64), interpolation=cv2.INTER_CUBIC))
    stored = image if bits == 8 else image.astype(np.uint16) * 257
    for name in ("a.tif", "b.TIFF"):
        data = write_tiff(tmp_path / name.lower(), stored)
        (tmp_path / name).write_bytes(data)
        np.testing.assert_array_equal(np.round(load_photograph(tmp_path / name, (96, 64)) * 255), image[..., ::-1])
    (tmp_path / "cut.tif").write_bytes(data[: len(data) // 2])
    listing = list_photographs(tmp_path)
    assert {photo.size_wh for photo in listing.photographs} == {(96, 64)}
    assert [skipped.name for skipped in listing.skipped] == ["cut.tif"]
    assert set(photograph_positions(tmp_path).values()) == {None}


@pytest.mark.parametrize("bits", [8, 16])
def test_alpha_of_a_tiff_is_a_mask_as_of_a_png(bits: int, tmp_path: Path) -> None:
    image = np.random.default_rng(0).integers(0, 256, (64, 96, 4), np.uint8)
    image[..., 3] = 255
    image[:, :40, 3] = 0
    stored = image if bits == 8 else image.astype(np.uint16) * 257
    write_tiff(tmp_path / "a.tif", stored)
    assert cv2.imwrite(str(tmp_path / "a.png"), stored)
    tifffile.imwrite(tmp_path / "b.tif", stored, photometric="rgb", extrasamples=["unassalpha"])
    wanted = alpha_mask(tmp_path / "a.png")
    for name in ("a.tif", "b.tif"):
        np.testing.assert_array_equal(alpha_mask(tmp_path / name), wanted)
    # A fourth band, near infrared for one, is no alpha.
    tifffile.imwrite(tmp_path / "nir.tif", stored, photometric="rgb", extrasamples=["unspecified"])
    write_tiff(tmp_path / "rgb.tif", stored[..., :3])
    assert wanted is not None and alpha_mask(tmp_path / "nir.tif") is None and alpha_mask(tmp_path / "rgb.tif") is None


def test_twelve_bits_in_a_tiff_of_sixteen_are_skipped_with_the_reason(tmp_path: Path) -> None:
    image = np.random.default_rng(0).integers(0, 4096, (64, 96, 3)).astype(np.uint16)
    write_tiff(tmp_path / "dark.tif", image)
    for name in ("a.tif", "b.tif"):
        write_tiff(tmp_path / name, image * 16)
    listing = list_photographs(tmp_path)
    assert [photo.name for photo in listing.photographs] == ["a.tif", "b.tif"]
    (skipped,) = listing.skipped
    assert skipped.name == "dark.tif" and "has 16 bits a channel and uses 12 or fewer" in skipped.reason


DISTORTED = "SIMPLE_RADIAL 320 240 {f} {cx} {cy} -0.05"


def project(hamlet: Path, folder: Path, renamed: dict[str, str], camera: str = DISTORTED) -> None:
    """The hamlet's known model, in text, with a lens that distorts and some images renamed."""
    model = read_model(hamlet / "known")
    (folder / "images").mkdir()
    for image in model.images:
        shutil.copy(hamlet / "images" / image.name, folder / "images" / renamed.get(image.name, image.name))
    images = tuple(replace(image, name=renamed.get(image.name, image.name)) for image in model.images)
    write_model(folder / "model", replace(model, images=images))
    f, _, cx, cy = model.cameras[min(model.cameras)].params
    lines = "".join(f"{number} {camera.format(f=f, cx=cx, cy=cy)}\n" for number in model.cameras)
    (folder / "model" / "cameras.txt").write_text(lines)
    path = folder / "model" / "images.txt"
    for name in renamed.values():
        path.write_text(path.read_text().replace(name.replace(" ", "_"), name))


def test_a_text_model_with_spaces_in_names_is_undistorted_under_them(hamlet: Path, tmp_path: Path) -> None:
    project(hamlet, tmp_path, {"drone_0003.jpg": "drone 0003 b.jpg"})
    result = scene_from_colmap(tmp_path / "model", tmp_path / "images", tmp_path / "work", lambda progress: None)
    assert "drone 0003 b.jpg" in result.scene.cameras.names and len(result.scene.cameras) == 12
    assert (result.undistorted_folder / "drone 0003 b.jpg").is_file() and len(result.scene.points) > 100


def test_an_image_without_suffix_is_skipped_by_name_where_it_would_be_undistorted(hamlet: Path, tmp_path: Path) -> None:
    project(hamlet, tmp_path, {"drone_0003.jpg": "frame3"})
    result = scene_from_colmap(tmp_path / "model", tmp_path / "images", tmp_path / "work", lambda progress: None)
    assert "frame3" not in result.scene.cameras.names and len(result.scene.cameras) == 11
    assert any(warning.startswith("frame3 has a name without .jpg") for warning in result.warnings)
    assert all((result.undistorted_folder / name).is_file() for name in result.scene.cameras.names)


def test_a_fisheye_that_colmap_alone_does_not_undistort_becomes_a_pinhole(hamlet: Path, tmp_path: Path) -> None:
    project(hamlet, tmp_path, {}, "THIN_PRISM_FISHEYE 320 240 {f} {f} {cx} {cy} 0 0 0 0 0 0 0 0")
    result = scene_from_colmap(tmp_path / "model", tmp_path / "images", tmp_path / "work", lambda progress: None)
    assert len(result.scene.cameras) == 12 and result.undistorted_folder == tmp_path / "work" / "undistorted" / "images"
    assert not (tmp_path / "work" / "undistorted" / "bent").exists()


LOAD_IN_LITTLE = """
import resource, pathlib, numpy
from radiant_core.errors import BadInput
mapped = int(pathlib.Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (mapped + 50_000_000, mapped + 50_000_000))
try:
    import radiant_core.sfm.colmap.calls
except BadInput as error:
    print(error)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc and a limit of addresses")
def test_too_little_memory_to_load_colmap_is_told_as_such() -> None:
    done = subprocess.run([sys.executable, "-c", LOAD_IN_LITTLE], capture_output=True, text=True, check=False)
    assert "allow more memory" in done.stdout and "pip install" not in done.stdout, done.stderr[-500:]


def with_alpha(hamlet: Path, folder: Path) -> Path:
    """The hamlet's photographs as PNG, the upper third transparent except in one."""
    folder.mkdir()
    for index, path in enumerate(sorted((hamlet / "images").iterdir())):
        image = cv2.imread(str(path))
        assert image is not None
        alpha = np.full(image.shape[:2], 255, np.uint8)
        alpha[: 80 if index else 0] = 0
        cv2.imwrite(str(folder / f"{path.stem}.png"), np.dstack([image, alpha]))
    return folder


def test_what_an_alpha_channel_makes_transparent_is_ignored(hamlet: Path, tmp_path: Path) -> None:
    images = with_alpha(hamlet, tmp_path / "images")
    model = read_model(hamlet / "known")
    renamed = tuple(replace(image, name=image.name.replace(".jpg", ".png")) for image in model.images)
    write_model(tmp_path / "model", replace(model, images=renamed))
    result = scene_from_colmap(tmp_path / "model", images, tmp_path / "work", lambda progress: None)
    (decision,) = [decision for decision in result.decisions if decision.topic == "masks"]
    assert decision.choice == "11 of 12 photographs are used in part" and result.masks_folder is not None
    assert decision.figure == pytest.approx(100 * 11 / 12 / 3, abs=0.1)
    weights = pixel_weights(result.masks_folder, result.scene.cameras)
    assert weights is not None and not weights[3][:80].any() and weights[3][80:].all() and weights[0].all()


def test_twelve_bits_in_sixteen_are_said_to_be_black(tmp_path: Path) -> None:
    coarse = np.random.default_rng(0).integers(0, 4096, (8, 12, 3), np.uint16)
    for name, factor in (("a.png", 16), ("b.png", 15), ("raw.png", 1)):
        cv2.imwrite(str(tmp_path / name), np.repeat(np.repeat(coarse, 8, axis=0), 8, axis=1) * factor)
    listing = list_photographs(tmp_path)
    assert [skipped.name for skipped in listing.skipped] == ["raw.png"]
    assert "uses 12 or fewer" in listing.skipped[0].reason
