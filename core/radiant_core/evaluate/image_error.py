"""How far a render is from its photograph: PSNR, SSIM, FLIP, LPIPS. Once per held-out image.

PSNR = −10 log10(mean squared error), peak 1. SSIM (Wang et al. 2004, Eqn. 13) per channel with an
11×11 Gaussian window, σ 1.5 px, K1 0.01, K2 0.03, averaged over the windows that lie wholly inside
the image: no border is made up. FLIP (Andersson et al. 2020) by the authors' package at its default
67 pixels per degree, images taken as sRGB. LPIPS as in `lpips.py`, where its weights are given.
`_cc` figures take the render as `color_correction.py` corrects it; they stand beside the plain
ones, never for them.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core.choices import LpipsNetwork
from radiant_core.errors import BadInput
from radiant_core.evaluate.color_correction import correct_colors
from radiant_core.evaluate.image_pair import Used, check_image_pair, check_used, replace_unused
from radiant_core.numerics import FloatArray

SSIM_WINDOW_PX = 11
SSIM_SIGMA_PX = 1.5
SSIM_C1 = 0.01**2
SSIM_C2 = 0.03**2
LPIPS_SIDE_PX: dict[LpipsNetwork, int] = {"vgg": 16, "alex": 31}
"""A shorter image would vanish before the last tap."""

MIN_SQUARED_ERROR = 1e-10
"""Equal images count as 100 dB, so that every figure stays finite; 8-bit photographs cannot show
more than 59 dB."""

NO_LPIPS_REASON = "LPIPS needs trained network weights, which are not part of the package: it was not measured; give --lpips-weights."
NO_FLIP_REASON = "FLIP was not measured: the extra `flip` is not installed; `radiant machine check` gives the command."

ImageFigure = Literal["psnr_db", "ssim", "psnr_cc_db", "ssim_cc", "flip", "lpips"]
FIGURES: tuple[ImageFigure, ...] = get_args(ImageFigure)
"""Names of all figures, the headline first."""
Distance = Callable[[ArrayLike, ArrayLike], float]
"""A figure of a render and its photograph, both (H,W,3) in 0..1."""


@dataclass(frozen=True, kw_only=True)
class ImageErrors:
    """The figures of one image, or their means or medians over several; None where one lacks it."""

    name: str
    psnr_db: float
    """Peak signal-to-noise ratio, higher is better, at most 100."""
    ssim: float
    """Structural similarity, 1 is equal."""
    psnr_cc_db: float
    """PSNR after colour correction, never below `psnr_db` but for rounding."""
    ssim_cc: float
    """SSIM after colour correction."""
    flip: float | None
    """Mean FLIP, 0 is equal; None with `NO_FLIP_REASON` where the package is missing."""
    lpips: float | None = None
    """LPIPS, 0 is equal; None with `NO_LPIPS_REASON` where no weights were given."""

    def figures(self) -> dict[ImageFigure, float | None]:
        """Figure by name, in the order of `FIGURES`."""
        return {figure: getattr(self, figure) for figure in FIGURES}


def psnr_db(render: ArrayLike, photograph: ArrayLike, used: Used = None) -> float:
    """PSNR in dB of two images (H,W,3) in 0..1, of the pixels that are `used`; BadInput on other
    shapes or values."""
    render, photograph = check_image_pair(render, photograph)
    squared = (render - photograph) ** 2
    return psnr_db_of_mse(float(np.mean(squared if used is None else squared[check_used(used, render)])))


def psnr_db_of_mse(mean_squared_error: float) -> float:
    """PSNR in dB of a mean squared error of values in 0..1: 0.01 gives 20 dB."""
    return float(-10 * np.log10(max(mean_squared_error, MIN_SQUARED_ERROR)))


def ssim(render: ArrayLike, photograph: ArrayLike, used: Used = None) -> float:
    """SSIM of two images (H,W,3) in 0..1, float64, of the windows about `used` pixels.

    The other pixels are taken as equal. Raises BadInput on other shapes or values, a side under 11
    px, or where no such window is left.
    """
    return ssim_of_each([render], photograph, used)[0]


def ssim_of_each(renders: Sequence[ArrayLike], photograph: ArrayLike, used: Used = None) -> list[float]:
    """The same of several renders of one photograph, whose windows are taken once."""
    pairs = [check_image_pair(render, photograph) for render in renders]
    whole = pairs[0][1]
    if min(whole.shape[:2]) < SSIM_WINDOW_PX:
        raise BadInput(f"images of {whole.shape[1]}×{whole.shape[0]} px are too small for SSIM: give at least 11 px a side.")
    mean_b = _window_mean(whole)
    variance_b = _window_mean(whole * whole) - mean_b * mean_b
    figures = []
    for given, _ in pairs:
        render = replace_unused(given, whole, used)
        mean_a = _window_mean(render)
        variance_a = _window_mean(render * render) - mean_a * mean_a
        covariance = _window_mean(render * whole) - mean_a * mean_b
        likeness = (2 * mean_a * mean_b + SSIM_C1) * (2 * covariance + SSIM_C2)
        windows = likeness / ((mean_a**2 + mean_b**2 + SSIM_C1) * (variance_a + variance_b + SSIM_C2))
        figures.append(float(np.mean(windows if used is None else windows[check_used(inner_pixels(used), windows)])))
    return figures


def flip(render: ArrayLike, photograph: ArrayLike, used: Used = None) -> float | None:
    """Mean FLIP of two sRGB images (H,W,3) in 0..1 at their `used` pixels, the others being taken
    as equal; None without the package. Raises BadInput on other shapes or values."""
    render, photograph = check_image_pair(render, photograph)
    render = replace_unused(render, photograph, used)
    if importlib.util.find_spec("flip_evaluator") is None:
        return None
    import flip_evaluator

    errors, mean, _ = flip_evaluator.evaluate(photograph.astype(np.float32), render.astype(np.float32), "LDR", applyMagma=False)
    return float(mean if used is None else np.asarray(errors)[check_used(used, render)].mean())


def image_errors(name: str, render: ArrayLike, photograph: ArrayLike, lpips: Distance | None = None, used: Used = None) -> ImageErrors:
    """All figures of an image (H,W,3) in 0..1 against its photograph.

    `lpips` is an `evaluate.lpips.Lpips`, where weights are at hand; it is a mean over the whole
    image, in which pixels outside `used` (H,W) are equal. The other figures leave those out. Raises
    BadInput on other shapes or values.
    """
    corrected = correct_colors(render, photograph, used)
    plain_ssim, corrected_ssim = ssim_of_each([render, corrected], photograph, used)
    return ImageErrors(
        name=name,
        psnr_db=psnr_db(render, photograph, used),
        ssim=plain_ssim,
        flip=flip(render, photograph, used),
        lpips=None if lpips is None else lpips(replace_unused(render, photograph, used), photograph),
        psnr_cc_db=psnr_db(corrected, photograph, used),
        ssim_cc=corrected_ssim,
    )


def mean_errors(errors: Sequence[ImageErrors], name: str = "mean") -> ImageErrors:
    """Mean of each figure over the images; None when one lacks it. BadInput without images."""
    return _over_images(errors, name, np.mean)


def median_errors(errors: Sequence[ImageErrors], name: str = "median") -> ImageErrors:
    """Median of each figure over the images; None when one lacks it. BadInput without images."""
    return _over_images(errors, name, np.median)


def _over_images(errors: Sequence[ImageErrors], name: str, over: Callable[[Any], Any]) -> ImageErrors:
    if not errors:
        raise BadInput("there are no images to average over: hold at least one photograph out.")
    columns = {figure: [getattr(error, figure) for error in errors] for figure in FIGURES}
    values: dict[str, Any] = {figure: None if None in column else float(over(column)) for figure, column in columns.items()}
    return ImageErrors(name=name, **values)


def inner_pixels(used: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The pixels (H-10,W-10) about which a window of SSIM lies wholly inside the image."""
    radius = SSIM_WINDOW_PX // 2
    return used[radius:-radius, radius:-radius]


def _window_mean(image: FloatArray) -> NDArray[np.float64]:
    """Gaussian-weighted mean of the 11×11 windows inside the image, (H-10,W-10,3)."""
    radius = SSIM_WINDOW_PX // 2
    weights = np.exp(-0.5 * (np.arange(-radius, radius + 1) / SSIM_SIGMA_PX) ** 2)
    weights /= weights.sum()
    # OpenCV takes a sixth of scipy's time, to the last digit but one.
    return np.asarray(cv2.sepFilter2D(image, cv2.CV_64F, weights, weights)[radius:-radius, radius:-radius], np.float64)
