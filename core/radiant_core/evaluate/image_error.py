"""How far a render is from its photograph: PSNR, SSIM, FLIP. Runs once per held-out image.

PSNR = −10 log10(mean squared error), peak 1. SSIM (Wang et al. 2004, Eqn. 13) per channel with an 11×11 Gaussian
window, σ 1.5 px, K1 0.01, K2 0.03, averaged over the windows that lie wholly inside the image: no border is made up. FLIP
(Andersson et al. 2020) by the authors' package at its default 67 pixels per degree, images taken as sRGB.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import correlate1d

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, checked_array

SSIM_WINDOW_PX = 11
SSIM_SIGMA_PX = 1.5
SSIM_C1 = 0.01**2
SSIM_C2 = 0.03**2

MIN_SQUARED_ERROR = 1e-10
"""Equal images count as 100 dB, so that every figure stays finite; 8-bit photographs cannot show more than 59 dB."""

NO_LPIPS_REASON = "LPIPS needs trained network weights, which are not part of the package: it was not measured."
NO_FLIP_REASON = "the package flip-evaluator is not installed: FLIP was not measured; install it to get the figure."


@dataclass(frozen=True, kw_only=True)
class ImageErrors:
    """Figures of one image, or their means over several."""

    name: str
    psnr_db: float
    """Peak signal-to-noise ratio, higher is better, at most 100."""
    ssim: float
    """Structural similarity, 1 is equal."""
    flip: float | None
    """Mean FLIP, 0 is equal; None with `NO_FLIP_REASON` where the package is missing."""


def psnr_db(render: ArrayLike, photograph: ArrayLike) -> float:
    """PSNR in dB of two images (H,W,3) in 0..1; BadInput on other shapes or values."""
    render, photograph = _image_pair(render, photograph)
    return psnr_db_of_mse(float(np.mean((render - photograph) ** 2)))


def psnr_db_of_mse(mean_squared_error: float) -> float:
    """PSNR in dB of a mean squared error of values in 0..1: 0.01 gives 20 dB."""
    return float(-10 * np.log10(max(mean_squared_error, MIN_SQUARED_ERROR)))


def ssim(render: ArrayLike, photograph: ArrayLike) -> float:
    """SSIM of two images (H,W,3) in 0..1, float64; BadInput on other shapes or values, or a side under 11 px."""
    render, photograph = _image_pair(render, photograph)
    if min(render.shape[:2]) < SSIM_WINDOW_PX:
        raise BadInput(f"images of {render.shape[1]}×{render.shape[0]} px are too small for SSIM: give at least 11 px a side.")
    mean_a, mean_b = _window_mean(render), _window_mean(photograph)
    variance_a = _window_mean(render * render) - mean_a * mean_a
    variance_b = _window_mean(photograph * photograph) - mean_b * mean_b
    covariance = _window_mean(render * photograph) - mean_a * mean_b
    likeness = (2 * mean_a * mean_b + SSIM_C1) * (2 * covariance + SSIM_C2)
    return float(np.mean(likeness / ((mean_a**2 + mean_b**2 + SSIM_C1) * (variance_a + variance_b + SSIM_C2))))


def flip(render: ArrayLike, photograph: ArrayLike) -> float | None:
    """Mean FLIP of two sRGB images (H,W,3) in 0..1, or None without the package; BadInput on other shapes or values."""
    render, photograph = _image_pair(render, photograph)
    if importlib.util.find_spec("flip_evaluator") is None:
        return None
    import flip_evaluator

    _, mean, _ = flip_evaluator.evaluate(photograph.astype(np.float32), render.astype(np.float32), "LDR", applyMagma=False)
    return float(mean)


def image_errors(name: str, render: ArrayLike, photograph: ArrayLike) -> ImageErrors:
    """All figures of one image (H,W,3) in 0..1 against its photograph; BadInput on other shapes or values."""
    return ImageErrors(name=name, psnr_db=psnr_db(render, photograph), ssim=ssim(render, photograph), flip=flip(render, photograph))


def mean_errors(errors: Sequence[ImageErrors], name: str = "mean") -> ImageErrors:
    """Mean of each figure over the images; FLIP is None when any image lacks it. BadInput without images."""
    if not errors:
        raise BadInput("there are no images to average over: hold at least one photograph out.")
    flips = [error.flip for error in errors if error.flip is not None]
    return ImageErrors(
        name=name,
        psnr_db=float(np.mean([error.psnr_db for error in errors])),
        ssim=float(np.mean([error.ssim for error in errors])),
        flip=float(np.mean(flips)) if len(flips) == len(errors) else None,
    )


def _image_pair(render: ArrayLike, photograph: ArrayLike) -> tuple[FloatArray, FloatArray]:
    pair = [checked_array(name, image, (None, None, 3)) for name, image in (("render", render), ("photograph", photograph))]
    if pair[0].shape != pair[1].shape:
        raise BadInput(f"a render {pair[0].shape} is compared with a photograph {pair[1].shape}: give them the same size.")
    if pair[0].size == 0:
        raise BadInput("an image without pixels cannot be compared.")
    for name, image in zip(("render", "photograph"), pair, strict=True):
        if image.min() < 0 or image.max() > 1:
            raise BadInput(f"the {name} has values {image.min():.3g} to {image.max():.3g}, expected 0 to 1: clamp it first.")
    return pair[0], pair[1]


def _window_mean(image: FloatArray) -> NDArray[np.float64]:
    """Gaussian-weighted mean of the 11×11 windows inside the image, (H-10,W-10,3)."""
    radius = SSIM_WINDOW_PX // 2
    weights = np.exp(-0.5 * (np.arange(-radius, radius + 1) / SSIM_SIGMA_PX) ** 2)
    weights /= weights.sum()
    rows = correlate1d(image, weights, axis=0)[radius:-radius]
    return correlate1d(rows, weights, axis=1)[:, radius:-radius]
