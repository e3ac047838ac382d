"""Masks as other programs lay them: names of each form, the colour that is left out, what fits nothing."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.io.photos.mask_folders import find_mask_folder, match_masks, unmatched_warning
from radiant_core.io.photos.masks import find_masks, load_mask, require_black_ignored
from radiant_core.sfm.masks_in_use import masks_in_use

NAMES = ["a.jpg", "flight/b.JPG", "c.png"]
SIDE = 8


def picture(path: Path, white: float = 1.0, channels: int = 1) -> Path:
    """A mask whose first rows, a share `white` of all, are white."""
    image = np.zeros((SIDE, SIDE), np.uint8)
    image[: round(white * SIDE)] = 255
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image if channels == 1 else np.repeat(image[..., None], channels, axis=2))
    return path


@pytest.mark.parametrize(
    ("first", "second", "third"),
    [
        ("a.jpg.png", "flight/b.JPG.png", "c.png.png"),
        ("a.png", "flight/b.png", "c.png"),
        ("a.jpg", "flight/b.jpg", "c.jpeg"),
        ("A.PNG", "FLIGHT/B.png", "C.png"),
        ("a.mask.png", "flight/b.mask.png", "c.mask.png"),
        ("a_mask.png", "flight/b_mask.png", "c_mask.tif"),
        ("a.jpg.mask.png", "flight/b.JPG.mask.png", "c.png.mask.png"),
    ],
    ids=["colmap", "nerfstudio", "postshot", "case", "brush", "metashape", "realityscan"],
)
def test_names_of_each_program_are_those_of_their_photographs(first: str, second: str, third: str, tmp_path: Path) -> None:
    for name in (first, second, third):
        picture(tmp_path / name)
    matched = match_masks(tmp_path, NAMES)
    assert {name: path.relative_to(tmp_path).as_posix() for name, path in matched.files.items()} == dict(
        zip(NAMES, (first, second, third), strict=True)
    )
    assert matched.unmatched == ()


def test_a_mask_of_the_whole_name_goes_before_one_of_its_stem(tmp_path: Path) -> None:
    for name in ("a.jpg.png", "a.png", "b_mask.png"):
        picture(tmp_path / name)
    matched = match_masks(tmp_path, ["a.jpg", "a.png", "b.jpg", "b_mask.jpg"])
    # a.png is the whole stem of both pictures called a; the first has its own by name.
    assert {name: path.name for name, path in matched.files.items()} == {"a.jpg": "a.jpg.png", "a.png": "a.png", "b_mask.jpg": "b_mask.png"}


def test_a_mask_that_fits_two_photographs_is_refused(tmp_path: Path) -> None:
    picture(tmp_path / "a.png")
    with pytest.raises(BadInput, match=r"a\.png could be that of a\.jpg or of a\.tif"):
        match_masks(tmp_path, ["a.jpg", "a.tif"])


def test_transforms_json_names_the_masks_that_no_form_does(tmp_path: Path) -> None:
    masks = tmp_path / "masks"
    for name in ("one.png", "two.png", "other.png"):
        picture(masks / name)
    frames = [
        {"file_path": "./images/a.jpg", "mask_path": "masks/one.png"},
        {"file_path": "images/flight/b.JPG", "mask_path": "masks/two.png"},
        {"file_path": "images/c.png", "mask_path": "../elsewhere.png"},
        {"file_path": "images/d.png"},
    ]
    (tmp_path / "transforms.json").write_text(json.dumps({"frames": frames}))
    matched = match_masks(masks, NAMES)
    assert {name: path.name for name, path in matched.files.items()} == {"a.jpg": "one.png", "flight/b.JPG": "two.png"}
    assert matched.unmatched == ("other.png",)
    for broken in ("", "[]", '{"frames": 1}', '{"frames": [{"mask_path": 1}]}', "{" * 100_000):
        (tmp_path / "transforms.json").write_text(broken)
        assert match_masks(masks, NAMES).files == {}


def test_names_that_fit_nothing_are_named(tmp_path: Path) -> None:
    for name in ("a.png", "A1.png", "deep/a.png"):
        picture(tmp_path / "masks" / name)
    (tmp_path / "masks" / "notes.txt").touch()
    matched = match_masks(tmp_path / "masks", NAMES)
    (told,) = unmatched_warning(matched, tmp_path / "masks", NAMES)
    assert told == (
        "2 pictures in masks/ are named after no photograph and are not used (A1.png, deep/a.png): expected a.jpg.png or a.png."
    )
    (counted,) = unmatched_warning(matched, tmp_path / "masks", NAMES, named=False)
    assert "A1" not in counted and counted.startswith("2 pictures")


@pytest.mark.parametrize("place", ["photos/masks", "photos/Mask", "images/masks", "masks"])
def test_masks_lie_in_the_folder_of_photographs_or_beside_images(place: str, tmp_path: Path) -> None:
    photos = tmp_path / ("photos" if place.startswith("photos") else "images")
    photos.mkdir()
    assert find_mask_folder(photos, NAMES) == (None, ())
    picture(tmp_path / place / "odd.png")
    folder, (told,) = find_mask_folder(photos, NAMES)
    assert folder is None and told.startswith(f"no picture in {Path(place).name}/ is named after a photograph (odd.png)")
    picture(tmp_path / place / "a.png")
    assert find_mask_folder(photos, NAMES) == (tmp_path / place, ())
    picture(photos / "MASKS" / "a.png")
    with pytest.raises(BadInput, match="name the one to use with --masks"):
        find_mask_folder(photos, NAMES)


def test_which_colour_is_meant_is_asked_where_black_leaves_less_than_half(tmp_path: Path) -> None:
    for index, name in enumerate(NAMES):
        picture(tmp_path / "mostly" / f"{name}.png", white=0.75)
        picture(tmp_path / "hardly" / f"{name}.png", white=(0.25, 0.5, 0.25)[index])
    assert require_black_ignored(tmp_path / "mostly", find_masks(tmp_path / "mostly", NAMES)) == 0.75
    with pytest.raises(BadInput, match=r"black leaves 33 % of the pixels of 3 masks .* --mask-ignores white"):
        require_black_ignored(tmp_path / "hardly", find_masks(tmp_path / "hardly", NAMES))


@pytest.mark.parametrize(("ignores", "used"), [("black", 0.25), ("white", 0.75)])
def test_the_colour_that_is_named_is_left_out(ignores: str, used: float, tmp_path: Path) -> None:
    picture(tmp_path / "masks" / "a.png", white=0.25, channels=3)
    with masks_in_use(tmp_path / "masks", ignores, tmp_path, NAMES, tmp_path / "work") as masks:  # pyright: ignore[reportArgumentType]
        assert masks.folder is not None
        assert load_mask(find_masks(masks.folder, NAMES)["a.jpg"], (SIDE, SIDE)).mean() == used
        (decision,) = masks.decisions
        assert decision.forced and decision.choice == f"{ignores} is left out, in masks/" and decision.figure == 1
    assert not (tmp_path / "work" / "masks.turned").exists()


def test_a_jpeg_counts_from_half_of_white_and_opacity_where_colour_says_nothing(tmp_path: Path) -> None:
    rows = np.repeat([[20], [235]], SIDE // 2, axis=0).astype(np.uint8).repeat(SIDE, axis=1)
    cv2.imwrite(str(tmp_path / "a.jpg"), rows, [cv2.IMWRITE_JPEG_QUALITY, 30])
    np.testing.assert_array_equal(load_mask(tmp_path / "a.jpg", (SIDE, SIDE)), rows > 127)
    clear = np.dstack([np.full((SIDE, SIDE, 3), 255, np.uint8), np.where(rows > 127, 255, 0).astype(np.uint8)])
    cv2.imwrite(str(tmp_path / "b.png"), clear)
    np.testing.assert_array_equal(load_mask(tmp_path / "b.png", (SIDE, SIDE)), rows > 127)
