"""Which pixels of a render are haze: nothing solid, or something that hangs before or behind the
true surface. Once per image.

    haze(p) = true depth D(p) is finite  and  (α(p) < 1/2  or  |d(p) − D(p)| > D(p) / 10)

for the render's cover α and expected depth d = Σ w z / Σ w. A pixel of true sky is never counted: a
model's sky may be at any depth. At outlines d mixes two surfaces, so that a perfect model has a few
such pixels as well.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray

MIN_ALPHA = 0.5
MAX_DEPTH_ERROR = 0.1
"""Largest error of depth as a share of the true one."""


def haze_mask(alpha: ArrayLike, depth: ArrayLike, true_depth: ArrayLike) -> NDArray[np.bool_]:
    """Pixels (H,W) that are haze, of cover (H,W) in 0..1, depth and true depth (H,W) in one unit,
    the true one infinite in the sky.

    A depth that is not finite is wrong. Raises BadInput for shapes that differ, or a true depth
    that is NaN or not positive.
    """
    alpha, depth, true_depth = (np.asarray(array, np.float64) for array in (alpha, depth, true_depth))
    _check(true_depth, alpha.shape, depth.shape)
    surface = np.isfinite(true_depth)
    true = np.where(surface, true_depth, 1.0)
    # Not (≤), so that NaN counts as wrong.
    with np.errstate(invalid="ignore"):
        right = (alpha >= MIN_ALPHA) & (np.abs(depth - true) <= MAX_DEPTH_ERROR * true)
    return surface & ~right


def haze_share(haze: NDArray[np.bool_], true_depth: FloatArray, used: NDArray[np.bool_] | None = None) -> float | None:
    """The share of haze (H,W) in the pixels that show a surface, of those `used`; None where there
    are none. Raises BadInput for shapes that differ."""
    if haze.shape != true_depth.shape or (used is not None and used.shape != haze.shape):
        raise BadInput(f"haze has the shape {haze.shape}, depth {true_depth.shape}: give pictures of one size.")
    counted = np.isfinite(true_depth) if used is None else np.isfinite(true_depth) & used
    return float(haze[counted].mean()) if counted.any() else None


def _check(true_depth: FloatArray, *shapes: tuple[int, ...]) -> None:
    if true_depth.ndim != 2 or any(shape != true_depth.shape for shape in shapes):
        raise BadInput(f"cover and depth have the shapes {shapes}, the true depth {true_depth.shape}: give pictures (H,W) of one size.")
    if np.isnan(true_depth).any() or (true_depth <= 0).any():
        raise BadInput("a true depth is NaN or not positive: depth is a distance along the viewing axis, infinite in the sky.")
