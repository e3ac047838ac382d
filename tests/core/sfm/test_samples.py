"""Photographs of more than 8 bits, in floating point, of many bands; and why no model came of some."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from radiant_core.errors import BadInput
from radiant_core.io.photos.listing import list_photographs
from radiant_core.io.photos.samples import SampleKind, SampleRange, Stretch, choose_stretches, sample_kind, stretched
from radiant_core.sfm.attempts import no_model
from radiant_core.sfm.colmap.database import extract_features, match_pairs
from radiant_core.sfm.colmap.workspace import list_usable, warn_of_unused
from radiant_core.sfm.config import SfmConfig
from radiant_core.sfm.readable import readable_folder
from radiant_core.sfm.reconstruct import reconstruct

GREY = cv2.resize(np.random.default_rng(0).integers(0, 256, (8, 12), np.uint8), (96, 64), interpolation=cv2.INTER_CUBIC)
RGB = np.dstack([GREY, 255 - GREY, GREY // 2])


def tiff(image: np.ndarray, **options: object) -> bytes:
    file = io.BytesIO()
    tifffile.imwrite(file, image, **options)  # pyright: ignore
    return file.getvalue()


def listed(folder: Path, *pictures: bytes) -> Path:
    for index, data in enumerate(pictures):
        (folder / f"{index}.tif").write_bytes(data)
    return folder


@pytest.mark.parametrize(
    ("picture", "low", "high"),
    [
        (lambda: 28_000 + GREY.astype(np.uint16) * 10, 28_000, 30_550),
        (lambda: GREY.astype(np.uint16) * 16, 0, 4_080),
        (lambda: GREY.astype(np.int16) - 100, -100, 155),
        (lambda: GREY.astype(np.float32) / 2 - 20, -20, 107.5),
        (lambda: GREY.astype(np.float64) / 255, 0, 1),
        (lambda: GREY.astype(np.uint32) * 1000, 0, 255_000),
    ],
    ids=["thermal", "12 of 16 bits", "signed", "degrees Celsius", "reflectance", "32 bits"],
)
def test_samples_are_stretched_alike_and_that_is_said(picture: Callable[[], np.ndarray], low: float, high: float, tmp_path: Path) -> None:
    # One is half of the range of the other: a stretch per picture would show both alike.
    whole = picture()
    half = (whole.min() + (whole - whole.min()) / 2).astype(whole.dtype)
    listing = list_usable(listed(tmp_path, tiff(whole), tiff(half)), lambda progress: None, stretch=True)
    (stretch,) = listing.stretches
    # 0.1 % of the values at each end may be cut.
    assert (stretch.low, stretch.high) == (pytest.approx(low, abs=0.02 * (high - low)), pytest.approx(high, abs=0.02 * (high - low)))
    assert any("2 photographs have" in told and "by one stretch for all of them" in told for told in warn_of_unused(listing))
    folder = readable_folder(listing, tmp_path, tmp_path / "work")
    shown = [np.asarray(cv2.imread(str(folder / name), cv2.IMREAD_UNCHANGED)) for name in ("0.tif", "1.tif")]
    assert all(image.dtype == np.uint8 for image in shown)
    # A step of rounding, and the ends that are cut.
    np.testing.assert_allclose(shown[0], GREY, atol=6)
    np.testing.assert_allclose(shown[1], GREY / 2, atol=6)
    with pytest.raises(BadInput, match="not stretched where poses are given"):
        list_usable(tmp_path, lambda progress: None, ("0.tif", "1.tif"))


@pytest.mark.parametrize(
    "data",
    [
        tiff(RGB, photometric="rgb"),
        tiff(RGB, photometric="rgb", bigtiff=True),
        tiff(RGB.astype(np.uint16) * 257, photometric="rgb"),
        tiff(np.dstack([RGB, GREY]), photometric="rgb", extrasamples=["unspecified"]),
        tiff(np.dstack([RGB, GREY]), photometric="separated"),
        tiff(GREY),
        tiff(GREY, photometric="palette", colormap=np.tile(np.arange(256, dtype=np.uint16) * 257, (3, 1))),
    ],
    ids=["RGB", "BigTIFF", "16 bits", "near infrared", "CMYK", "grey", "palette"],
)
def test_what_every_program_shows_alike_stays_as_it_is(data: bytes, tmp_path: Path) -> None:
    listing = list_photographs(listed(tmp_path, data, data))
    assert len(listing.photographs) == 2 and listing.stretches == ()
    assert readable_folder(listing, tmp_path, tmp_path / "work") == tmp_path


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (tiff(np.dstack([RGB, RGB[..., :2]]), photometric="minisblack", planarconfig="contig"), "holds 5 bands of 8-bit unsigned integers"),
        (tiff(GREY.astype(np.float16)), "holds 1 band of 16-bit floating point"),
        (tiff(GREY.astype(np.complex64)), "holds 1 band of 64-bit complex numbers"),
    ],
)
def test_samples_that_cannot_be_decoded_are_named(data: bytes, said: str, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=f"{said}.*, which cannot be decoded \\(save it with 1 or 3 bands of 8 or 16 bits\\)"):
        list_photographs(listed(tmp_path, data, data))


def test_a_stretch_cuts_what_lies_outside_and_shows_no_number_black() -> None:
    stretch = Stretch(kind=SampleKind(bits=32, format="floating point", bands=1), low=10.0, high=20.0, num_photographs=1)
    assert stretched(np.array([[np.nan, -np.inf, 10, 15, 20, 99]]), stretch).tolist() == [[0, 0, 0, 128, 255, 255]]
    same = Stretch(kind=stretch.kind, low=7.0, high=7.0, num_photographs=1)
    assert stretched(np.array([[7.0, 8.0]]), same).tolist() == [[0, 0]]


def test_each_kind_of_samples_has_a_stretch_of_its_own() -> None:
    wide, narrow = SampleKind(bits=16, bands=1), SampleKind(bits=32, format="floating point", bands=1)
    ranges = [SampleRange(kind=wide, low=0, high=60_000), SampleRange(kind=narrow, low=5, high=9), SampleRange(kind=wide, low=0, high=900)]
    assert [(stretch.low, stretch.high, stretch.num_photographs) for stretch in choose_stretches(ranges)] == [(5, 9, 1)]
    assert sample_kind(tiff(GREY.astype(np.uint16))) == wide


def test_one_picture_saved_again_is_said_to_be_one(hamlet: Path, tmp_path: Path) -> None:
    picture = cv2.imread(str(sorted((hamlet / "images").iterdir())[5]))
    assert picture is not None
    for quality in range(80, 84):
        cv2.imwrite(str(tmp_path / f"{quality}.jpg"), picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
    with pytest.raises(BadInput, match=r"the 4 photographs in .* are the same picture saved again \(1 different of 4\)"):
        reconstruct(tmp_path, tmp_path / "work", SfmConfig(num_threads=1), lambda progress: None)


def test_photographs_of_nothing_are_said_to_show_too_little(tmp_path: Path) -> None:
    for index in range(4):
        sky = np.full((240, 320, 3), 60 + 50 * index, np.uint8)
        cv2.imwrite(str(tmp_path / f"{index}.jpg"), sky)
    with pytest.raises(BadInput, match=r"4 of the 4 photographs in .* show too little"):
        reconstruct(tmp_path, tmp_path / "work", SfmConfig(num_threads=1), lambda progress: None)


def test_photographs_that_overlap_and_came_to_no_model_are_not_said_to_miss_overlap(hamlet: Path, tmp_path: Path) -> None:
    photographs = list_photographs(hamlet / "images").photographs[:4]
    config = SfmConfig(num_threads=1, max_image_size_px=320)
    database = tmp_path / "database.db"
    extract_features(database, hamlet / "images", photographs, config, lambda progress: None)
    before = str(no_model(photographs, tmp_path, hamlet / "images", database))
    assert "do not overlap enough" in before
    match_pairs(database, list(combinations([photo.name for photo in photographs], 2)), config, lambda progress: None)
    told = str(no_model(photographs, tmp_path, hamlet / "images", database))
    assert re.search(r"the 4 photographs in .* overlap \(\d pairs do\), but no two of them fix a place", told)
