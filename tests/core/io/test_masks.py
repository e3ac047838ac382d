"""Masks of photographs: both conventions of names, refusals, and how they weigh pixels."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.io.photos.masks import find_masks, load_mask, mask_name, pixel_weights, save_mask, used_pixels
from tests.core.scenes import cameras_above

USED = np.tile([[False, True, True, True]], (3, 1))


def written(path: Path, image: np.ndarray) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image)
    return path


def test_both_conventions_are_found_also_in_subfolders_and_the_rest_is_used_whole(tmp_path: Path) -> None:
    for name in ("a/b.jpg.png", "a/c.png", "d.png", "else.png"):
        written(tmp_path / name, np.zeros((2, 2), np.uint8))
    found = find_masks(tmp_path, ["a/b.jpg", "a/c.JPG", "d.jpeg", "whole.jpg"])
    assert {name: path.relative_to(tmp_path).as_posix() for name, path in found.items()} == {
        "a/b.jpg": "a/b.jpg.png",
        "a/c.JPG": "a/c.png",
        "d.jpeg": "d.png",
    }


@pytest.mark.parametrize("image", [USED * np.uint8(255), USED * np.uint8(1), np.repeat((USED * np.uint8(9))[..., None], 3, axis=2)])
def test_whatever_is_not_0_is_used(tmp_path: Path, image: np.ndarray) -> None:
    np.testing.assert_array_equal(load_mask(written(tmp_path / "m.png", image), (4, 3)), USED)


def test_a_mask_reads_back_as_it_was_saved(tmp_path: Path) -> None:
    save_mask(tmp_path / "deep" / "m.png", USED)
    np.testing.assert_array_equal(load_mask(tmp_path / "deep" / "m.png", (4, 3)), USED)


@pytest.mark.parametrize(
    ("image", "told"),
    [
        (np.full((3, 5), 255, np.uint8), "5 × 3 px and its photograph 4 × 3"),
        (np.full((4, 3), 255, np.uint8), "without the EXIF rotation"),
        (np.zeros((3, 4), np.uint8), "leaves nothing"),
        (np.full((3, 4), 65535, np.uint16), "1 channel.* of uint16"),
        (np.arange(36, dtype=np.uint8).reshape(3, 4, 3), "3 channel"),
        (np.arange(48, dtype=np.uint8).reshape(3, 4, 4), "4 channel"),
    ],
)
def test_what_is_no_mask_of_the_photograph_is_refused(tmp_path: Path, image: np.ndarray, told: str) -> None:
    with pytest.raises(BadInput, match=told):
        load_mask(written(tmp_path / "m.png", image), (4, 3))


@pytest.mark.parametrize("content", [b"", b"\x89PNG\r\n\x1a\n", b"no picture"])
def test_a_file_that_cannot_be_decoded_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "m.png").write_bytes(content)
    with pytest.raises(BadInput, match="cannot be decoded"):
        load_mask(tmp_path / "m.png", (4, 3))


def test_a_missing_folder_and_one_in_which_no_name_fits_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="does not exist"):
        find_masks(tmp_path / "none", ["a.jpg"])
    with pytest.raises(BadInput, match=r"for example a\.jpg\.png"):
        find_masks(tmp_path, ["a.jpg"])
    with pytest.raises(BadInput, match="named after a photograph"):
        find_masks(tmp_path, [])


def test_weights_are_the_used_shares_of_the_reduced_pixels(tmp_path: Path) -> None:
    cameras = cameras_above([(0.0, 0.0), (1.0, 0.0)], size_wh=(4, 2))
    assert pixel_weights(None, cameras) is None
    assert pixel_weights(tmp_path, cameras) is None
    used = np.random.default_rng(0).uniform(size=(6, 12)) < 0.6
    save_mask(tmp_path / mask_name(cameras.names[0]), used)
    weights = pixel_weights(tmp_path, cameras)
    assert weights is not None
    shares = used.reshape(2, 3, 4, 3).mean(axis=(1, 3))
    # One rounding to 8 bits.
    np.testing.assert_allclose(weights[0] / 255, shares, atol=0.51 / 255)
    np.testing.assert_array_equal(used_pixels(weights[0]), shares >= 0.5)
    assert (weights[1] == 255).all() and used_pixels(weights[1]).all()
    (tmp_path / mask_name(cameras.names[1])).write_bytes(b"torn")
    with pytest.raises(BadInput, match="cannot be decoded"):
        pixel_weights(tmp_path, cameras)
