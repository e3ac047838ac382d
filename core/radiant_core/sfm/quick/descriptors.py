"""Which features of two photographs are the same: mutual nearest descriptors. Once per pair.

    cos(i,j) = d_i · d_j / 512²        i, j match where each is the other's nearest and
    ∠(best) < 0.8 ∠(second best),      ∠(best) < 0.7 rad

as COLMAP tests them. All N M products of 128 bytes are made, in integers and exactly, and none of
them is written to memory (native/matching): 4,096 by 4,096 features are 2.1 G multiply-adds.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radiant_core._native import compare_descriptors
from radiant_core.errors import BadInput

NUM_BYTES = 128
NORM = 512.0
"""Length of a descriptor in bytes, that of COLMAP's."""
MAX_RATIO = 0.8
MAX_ANGLE_RAD = 0.7

Descriptors = NDArray[np.uint8]
Matches = NDArray[np.uint32]


def match_descriptors(first: Descriptors, second: Descriptors) -> Matches:
    """Pairs (K,2) of rows of first (N,128) and second (M,128) uint8 that match, by rising row of
    the first. Raises BadInput for arrays of another shape or type."""
    for array in (first, second):
        if array.dtype != np.uint8 or array.ndim != 2 or array.shape[1] != NUM_BYTES:
            raise BadInput(f"descriptors have shape {array.shape} and type {array.dtype}, expected (N, {NUM_BYTES}) of uint8.")
    if not len(first) or not len(second):
        return np.zeros((0, 2), np.uint32)
    index, best, second_best, column_best = compare_descriptors(np.ascontiguousarray(first), np.ascontiguousarray(second), "")
    near, next_rad = _angles_rad(best), _angles_rad(second_best)
    rows = np.flatnonzero((best == column_best[index]) & (near < MAX_RATIO * next_rad) & (near < MAX_ANGLE_RAD))
    return np.column_stack([rows, index[rows]]).astype(np.uint32)


def _angles_rad(products: NDArray[np.int32]) -> NDArray[np.float64]:
    """Angles (N,) whose cosines are products / 512²; rounding makes some of those exceed 1."""
    return np.arccos(np.minimum(products / NORM**2, 1.0))


def root_descriptors(histograms: NDArray[np.float32]) -> Descriptors:
    """RootSIFT (N,128) uint8 of SIFT's histograms (N,128), not negative: 512 √(h / Σh). A row of
    zeros, or with a number that is not finite, becomes zeros, which match nothing."""
    sums = histograms.sum(axis=1, keepdims=True)
    usable = np.isfinite(sums) & (sums > 0)
    shares = np.divide(histograms, sums, out=np.zeros_like(histograms), where=usable)
    return np.minimum(np.round(NORM * np.sqrt(np.maximum(shares, 0.0))), 255).astype(np.uint8)
