"""Whether gains explain whole pictures. Once per solution.

    evenness = spread of log gains / rms over parts of pictures of the mean log that they leave

An exposure is the same in all nine parts of a picture. Brightness that differs because a side
turns away from a lamp, or because a cloud's shadow lies on half of the ground, is not: a gain per
photograph then is a mean over what happens to be seen. Noise of single places and wrong matches
hardly count, since parts are means of `MIN_OBSERVATIONS` and more. Measured at 384 px: 3.8 to 10.9
where exposures differ (lewis, caliterra, brighton), 2.6 and 3.2 where they were planted with a
spread of 7 % on a generated orbit and street, 0.5 of a house on a turntable
(docs/experiments/light.md).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radiant_core.numerics import FloatArray

PARTS_ACROSS = 3
MIN_OBSERVATIONS = 10
"""A part with fewer says nothing."""


def parts_of(pixels: NDArray[np.integer], sizes_wh: NDArray[np.integer]) -> NDArray[np.int64]:
    """Which of the nine parts of their pictures, of sizes (T,2) px, pixels (T,2) lie in, (T,)."""
    column, row = np.minimum(np.asarray(pixels, np.int64) * PARTS_ACROSS // sizes_wh, PARTS_ACROSS - 1).T
    return row * PARTS_ACROSS + column


def evenness(spread: float, residuals: FloatArray, view: NDArray[np.int64], part: NDArray[np.int64]) -> float:
    """How many times as large as what they leave gains are.

    Args:
        spread: standard deviation of the log gains.
        residuals: what they and the vignettings leave of log brightnesses (T,); NaN says nothing.
        view: the photograph of each (T,).
        part: the part of its picture (T,), by `parts_of`.

    Returns:
        The ratio; infinite where no part has enough observations to tell.
    """
    tells = np.isfinite(residuals)
    cells = view[tells] * PARTS_ACROSS**2 + part[tells]
    counts = np.bincount(cells)
    enough = counts >= MIN_OBSERVATIONS
    if not enough.any():
        return np.inf
    counts, sums = counts[enough], np.bincount(cells, residuals[tells])[enough]
    rms = float(np.sqrt(np.average((sums / counts) ** 2, weights=counts)))
    return spread / rms if rms > 0 else np.inf
