"""Image errors against slow, plain twins and against what is known of them."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.evaluate.color_correction import correct_colors
from radiant_core.evaluate.image_error import FIGURES, ImageErrors, flip, image_errors, mean_errors, median_errors, psnr_db, ssim

RNG = np.random.default_rng(11)
PHOTO = np.clip(np.cumsum(RNG.normal(scale=0.1, size=(40, 33, 3)), axis=1) + 0.5, 0, 1)
RENDER = np.clip(PHOTO + RNG.normal(scale=0.05, size=PHOTO.shape), 0, 1)


def plain_ssim(a: np.ndarray, b: np.ndarray) -> float:
    """Every 11×11 window on its own, with weighted means, variances, covariance by definition."""
    offsets = np.arange(11) - 5
    weights = np.exp(-(offsets[:, None] ** 2 + offsets**2) / (2 * 1.5**2))
    weights /= weights.sum()
    values = []
    for channel in range(3):
        for row in range(a.shape[0] - 10):
            for column in range(a.shape[1] - 10):
                x, y = (image[row : row + 11, column : column + 11, channel] for image in (a, b))
                mx, my = (weights * x).sum(), (weights * y).sum()
                vx, vy = (weights * (x - mx) ** 2).sum(), (weights * (y - my) ** 2).sum()
                vxy = (weights * (x - mx) * (y - my)).sum()
                values.append((2 * mx * my + 1e-4) * (2 * vxy + 9e-4) / ((mx**2 + my**2 + 1e-4) * (vx + vy + 9e-4)))
    return float(np.mean(values))


def test_ssim_is_the_mean_over_windows_as_defined() -> None:
    # float64 on both sides; E[x²] − E[x]² loses some 1e-16 of values up to 1 against C2 = 9e-4.
    assert ssim(RENDER, PHOTO) == pytest.approx(plain_ssim(RENDER, PHOTO), abs=1e-11)


def test_ssim_is_symmetric_one_for_equal_images_and_falls_with_noise() -> None:
    assert ssim(PHOTO, PHOTO) == pytest.approx(1.0, abs=1e-12)
    assert ssim(RENDER, PHOTO) == pytest.approx(ssim(PHOTO, RENDER), abs=1e-14)
    worse = np.clip(RENDER + RNG.normal(scale=0.2, size=PHOTO.shape), 0, 1)
    assert ssim(worse, PHOTO) < ssim(RENDER, PHOTO) < 1


@pytest.mark.parametrize(("offset", "expected_db"), [(0.1, 20.0), (0.01, 40.0), (1.0, 0.0), (0.0, 100.0)])
def test_psnr_of_a_constant_offset(offset: float, expected_db: float) -> None:
    image = np.zeros((4, 5, 3))
    assert psnr_db(image + offset, image) == pytest.approx(expected_db, abs=1e-9)


def test_float32_images_give_the_same_figures_as_float64() -> None:
    single = [image.astype(np.float32) for image in (RENDER, PHOTO)]
    # Values rounded to 6e-8 of themselves; dB and SSIM move by about as much.
    assert psnr_db(*single) == pytest.approx(psnr_db(RENDER, PHOTO), abs=1e-4)
    assert ssim(*single) == pytest.approx(ssim(RENDER, PHOTO), abs=1e-5)


def test_flip_is_zero_for_equal_images_repeats_exactly_and_grows_with_the_error() -> None:
    assert flip(PHOTO, PHOTO) == 0.0
    assert flip(RENDER, PHOTO) == flip(RENDER, PHOTO)
    small, large = flip(np.clip(PHOTO + 0.02, 0, 1), PHOTO), flip(np.clip(PHOTO + 0.3, 0, 1), PHOTO)
    assert small is not None
    assert large is not None
    assert 0 < small < large <= 1


def test_flip_of_black_against_white_is_near_its_maximum() -> None:
    value = flip(np.zeros((64, 64, 3)), np.ones((64, 64, 3)))
    assert value is not None
    # FLIP scales by the green–blue pair, its largest colour difference. 0.967 is what version 1.7
    # of the package gave here: a later one that differs changes every figure in a report and must
    # be noticed.
    assert value == pytest.approx(0.967, abs=0.001)


def test_without_the_package_flip_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    assert image_errors("a", RENDER, PHOTO).flip is None


def test_means_are_means_and_flip_needs_every_image() -> None:
    a = ImageErrors(name="a", psnr_db=20, ssim=0.5, psnr_cc_db=22, ssim_cc=0.6, flip=0.1)
    b = ImageErrors(name="b", psnr_db=30, ssim=0.7, psnr_cc_db=32, ssim_cc=0.8, flip=0.3)
    assert mean_errors([a, b]).figures() == pytest.approx(
        {"psnr_db": 25, "ssim": 0.6, "psnr_cc_db": 27, "ssim_cc": 0.7, "flip": 0.2, "lpips": None}
    )
    assert mean_errors([a, replace(b, flip=None)]).flip is None
    with pytest.raises(BadInput, match="no images"):
        mean_errors([])


def mean_difference(render, photograph) -> float:
    return float(np.abs(render - photograph).mean())


def test_means_and_medians_are_of_every_figure() -> None:
    errors = [image_errors(str(step), np.clip(PHOTO + step, 0, 1), PHOTO, mean_difference) for step in (0, 0.1, 0.5)]
    plainly: list[tuple[Any, Any]] = [(mean_errors, np.mean), (median_errors, np.median)]
    for over, plain in plainly:
        found = over(errors).figures()
        assert tuple(found) == FIGURES and None not in found.values()
        assert found == {figure: pytest.approx(plain([error.figures()[figure] for error in errors])) for figure in FIGURES}
    assert median_errors(errors).name == "median" and median_errors(errors).psnr_db < mean_errors(errors).psnr_db
    with pytest.raises(BadInput, match="no images"):
        median_errors([])


def test_lpips_is_measured_only_where_it_is_given() -> None:
    assert image_errors("a", RENDER, PHOTO).lpips is None
    assert image_errors("a", RENDER, PHOTO, lambda render, photograph: 0.25).lpips == 0.25


@pytest.mark.parametrize("figure", [psnr_db, ssim, flip])
@pytest.mark.parametrize(
    "poison",
    [PHOTO[:20], PHOTO[:, :, :2], PHOTO[0], PHOTO * 255, PHOTO - 1, PHOTO * np.nan, np.zeros((0, 5, 3))],
    ids=["size", "channels", "flat", "0 to 255", "negative", "nan", "empty"],
)
def test_poison_is_bad_input(figure, poison: np.ndarray) -> None:
    with pytest.raises(BadInput):
        figure(poison, PHOTO)


def test_images_smaller_than_a_window_have_no_ssim() -> None:
    with pytest.raises(BadInput, match="too small for SSIM"):
        ssim(PHOTO[:10], PHOTO[:10])


USED = np.ones(PHOTO.shape[:2], bool)
USED[10:25, 5:20] = False


def test_a_mask_of_everything_changes_no_figure() -> None:
    whole, masked = image_errors("a", RENDER, PHOTO), image_errors("a", RENDER, PHOTO, used=np.ones_like(USED))
    for figure in set(FIGURES) - {"lpips"}:
        assert getattr(masked, figure) == pytest.approx(getattr(whole, figure), rel=1e-6)


def test_what_a_mask_ignores_changes_no_figure_and_the_rest_is_scored_alone() -> None:
    wild = np.where(USED[..., None], RENDER, RNG.uniform(size=PHOTO.shape))
    calm, odd = (image_errors("a", render, PHOTO, used=USED) for render in (RENDER, wild))
    assert odd == calm
    assert calm.psnr_db == pytest.approx(-10 * np.log10(((RENDER - PHOTO)[USED] ** 2).mean()), abs=1e-9)
    assert calm.psnr_cc_db >= calm.psnr_db - 1e-9
    equal = np.where(USED[..., None], PHOTO, 1 - PHOTO)
    assert psnr_db(equal, PHOTO, USED) == 100 and ssim(equal, PHOTO, USED) == pytest.approx(1, abs=1e-12)


def test_the_windows_of_ssim_stand_about_used_pixels() -> None:
    right = np.zeros_like(USED)
    right[:, 22:] = True
    agreeing = np.where(right[..., None], RENDER, PHOTO)
    # From column 17 on the whole windows of a crop are those about columns 22 and more.
    assert ssim(RENDER, PHOTO, right) == pytest.approx(plain_ssim(agreeing[:, 17:], PHOTO[:, 17:]), abs=1e-11)


@pytest.mark.parametrize("figure", [psnr_db, ssim, flip, correct_colors])
@pytest.mark.parametrize("used", [np.zeros_like(USED), USED[1:], USED.T])
def test_a_mask_that_leaves_nothing_or_has_another_size_is_refused(figure: Any, used: np.ndarray) -> None:
    with pytest.raises(BadInput):
        figure(RENDER, PHOTO, used)
