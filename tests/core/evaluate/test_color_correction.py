"""Colour correction: what it removes, what it must not, and that no render becomes worse."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.evaluate.color_correction import correct_colors
from radiant_core.evaluate.image_error import image_errors, psnr_db

RNG = np.random.default_rng(2)
PHOTO = np.clip(0.25 + 0.4 * RNG.random((30, 40, 1)) + 0.1 * RNG.random((30, 40, 3)), 0, 1)
NOISY = np.clip(PHOTO + RNG.normal(scale=0.05, size=PHOTO.shape), 0, 1)

EXTREMES = {
    "black": np.zeros_like(PHOTO),
    "white": np.ones_like(PHOTO),
    "one colour": np.broadcast_to([0.2, 0.5, 0.7], PHOTO.shape),
    "nearly one colour": 0.5 + 1e-9 * RNG.random(PHOTO.shape),
    "grey": np.repeat(PHOTO[..., :1], 3, axis=2),
    "one pixel lit": np.eye(1, 1200, 7).reshape(30, 40, 1) * np.ones(3),
    "noise": RNG.random(PHOTO.shape),
    "inverse": 1 - PHOTO,
    "noisy": NOISY,
    "photo": PHOTO,
}


def test_an_affine_change_of_colours_is_taken_away() -> None:
    matrix = np.array([[0.8, 0.1, 0.0], [0.05, 0.7, 0.1], [0.0, -0.1, 0.9]])
    render = PHOTO @ matrix.T + [0.02, -0.01, 0.03]
    assert render.min() >= 0 and render.max() <= 1 and psnr_db(render, PHOTO) < 25
    # λ bends the fit by about 1e-8 over the smallest colour variance here, 1e-3.
    np.testing.assert_allclose(correct_colors(render, PHOTO), PHOTO, atol=1e-4)


def test_it_is_the_least_squares_fit_before_clipping() -> None:
    x = np.c_[NOISY.reshape(-1, 3), np.ones(NOISY[..., 0].size)]
    fitted = x @ np.linalg.lstsq(x, PHOTO.reshape(-1, 3))[0]
    np.testing.assert_allclose(correct_colors(NOISY, PHOTO).reshape(-1, 3), np.clip(fitted, 0, 1), atol=1e-5)


@pytest.mark.parametrize("photo", EXTREMES)
@pytest.mark.parametrize("render", EXTREMES)
def test_it_never_makes_the_error_larger(render: str, photo: str) -> None:
    corrected = correct_colors(EXTREMES[render], EXTREMES[photo])
    assert corrected.min() >= 0 and corrected.max() <= 1
    errors = [np.mean((image - EXTREMES[photo]) ** 2) for image in (EXTREMES[render], corrected)]
    assert errors[1] <= errors[0] * (1 + 1e-9) + 1e-20  # rounding of float64


def test_the_corrected_figures_stand_beside_the_plain_ones() -> None:
    dark = image_errors("dark", 0.6 * NOISY, PHOTO)
    plain = image_errors("plain", NOISY, PHOTO)
    assert dark.psnr_db < plain.psnr_db - 5
    assert dark.psnr_cc_db == pytest.approx(plain.psnr_cc_db, abs=0.01) and dark.psnr_cc_db > plain.psnr_db
    assert dark.ssim_cc == pytest.approx(plain.ssim_cc, abs=0.01) and dark.ssim_cc > dark.ssim


@pytest.mark.parametrize("poison", [PHOTO[:20], PHOTO * 255, PHOTO * np.nan, PHOTO[..., :1], np.zeros((0, 40, 3))])
def test_poison_is_bad_input(poison: np.ndarray) -> None:
    with pytest.raises(BadInput):
        correct_colors(poison, PHOTO)


def test_one_pixel_is_corrected_to_its_photograph() -> None:
    np.testing.assert_allclose(correct_colors(np.full((1, 1, 3), 0.2), np.full((1, 1, 3), 0.7)), 0.7, atol=1e-12)
