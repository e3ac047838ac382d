"""Similarities between point sets: least squares, robust, and as a yardstick for models.

Least squares (once per fit), weights w that sum to 1, centred X, Y, the SVD Yᵀ diag(w) X = U D Vᵀ:
    R = U S Vᵀ,  s = tr(D S) / Σ wᵢ ‖xᵢ‖²,  t = ȳ − s R x̄,   S = diag(1, 1, det(U Vᵀ)).
Robust (once per scene): of 500 fits to three random pairs the one with the smallest median
residual, then the least sum of distances Σ ‖s R xᵢ + t − yᵢ‖ over the pairs within 2.5 robust
standard deviations, by reweighting with 1 / distance. Sources: Umeyama, PAMI 13 (1991); Rousseeuw,
least median of squares (1984); Weiszfeld (1937) for the reweighting.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core.errors import BadInput
from radiant_core.frames import Sim3
from radiant_core.numerics import FloatArray, check_array

NUM_TRIALS = 500
PAIRS_AT_ONCE = 100_000
"""Residuals that are computed together."""
NUM_REFITS = 30
INLIER_SIGMAS = 2.5
SIGMA_FROM_MEDIAN = 1 / 1.538
"""Standard deviation per axis from the median length of a 3D Gaussian error (chi, 3 axes)."""
MAX_SCALE_ERROR = 0.2
MAX_TILT_ERROR_RAD = np.radians(5.0)

AlignStatus = Literal["ok", "too few", "inconsistent", "collinear"]
"""ok; too few: under three pairs; inconsistent: the scale is not known to 20 %; collinear: the
rotation about the line through the positions is not known to 5°."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Alignment:
    """What a robust fit found; never an exception for positions that cannot be aligned."""

    status: AlignStatus
    target_from_source: Sim3 | None
    """None exactly when the status is "too few"."""
    residuals: FloatArray
    """Distances (N,) in the target's unit; empty without a fit."""
    inliers: NDArray[np.bool_]
    """Which pairs (N,) the fit used."""
    scale_error: float
    """Predicted relative standard deviation of the scale; infinite without a fit."""
    tilt_error_rad: float
    """Predicted standard deviation of the rotation about the line that fits the positions best;
    infinite without a fit."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CenterErrors:
    """Camera centres against a reference after the least-squares similarity, in its unit."""

    reference_from_scene: Sim3
    errors: FloatArray
    """Distances (N,)."""
    extent: float
    """Largest distance between two reference centres."""

    @property
    def max_percent(self) -> float:
        """Largest error in percent of the extent."""
        return 100 * float(self.errors.max()) / self.extent


def fit_sim3(source: ArrayLike, target: ArrayLike, weights: ArrayLike | None = None) -> Sim3:
    """Least-squares similarity of pairs source (N,3) → target (N,3), N ≥ 2, with weights (N,) of
    any positive sum. Raises BadInput when all of one side coincide."""
    source, target = _check_pairs(source, target)
    if len(source) < 2:
        raise BadInput(f"{len(source)} pair of positions cannot fix a similarity: at least 2 are needed, 3 for the rotation.")
    shares = np.ones(len(source)) if weights is None else check_array("weights", weights, (len(source),))
    shares = shares / shares.sum()
    source_mean, target_mean = shares @ source, shares @ target
    from_source, from_target = source - source_mean, target - target_mean
    variance = float(shares @ np.square(from_source).sum(axis=1))
    U, D, Vt = np.linalg.svd((from_target * shares[:, None]).T @ from_source)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    scale = float(D @ signs / variance) if variance > 0 else 0.0
    if not scale > 0:
        raise BadInput("all positions on one side of a similarity coincide: it has no scale; give positions that differ.")
    rotation = (U * signs) @ Vt
    return Sim3(scale=scale, rotation=rotation, translation=target_mean - scale * rotation @ source_mean)


def robust_sim3(source: ArrayLike, target: ArrayLike, seed: int = 0) -> Alignment:
    """Similarity of pairs source (N,3) → target (N,3), up to half of which may be wrong. Errors are
    predicted from the residual's standard deviation σ and the inliers' spread along their axes:
    scale_error = σ / (s · |first axis|), tilt_error = σ / (s · |second axis|), large for a line."""
    source, target = _check_pairs(source, target)
    start = _least_median_fit(source, target, seed)
    if start is None:
        return Alignment(
            status="too few",
            target_from_source=None,
            residuals=np.zeros(0),
            inliers=np.zeros(len(source), bool),
            scale_error=np.inf,
            tilt_error_rad=np.inf,
        )
    fit, residuals, inliers = _refit(source, target, start)
    sigma = SIGMA_FROM_MEDIAN * float(np.median(residuals[inliers]))
    spread = fit.scale * np.linalg.svd(source[inliers] - source[inliers].mean(axis=0), compute_uv=False)
    sigma = max(sigma, 1e-9 * spread[0])
    scale_error, tilt_error = sigma / spread[0], sigma / max(spread[1], 1e-9 * spread[0])
    status: AlignStatus = "ok"
    if scale_error > MAX_SCALE_ERROR:
        status = "inconsistent"
    elif tilt_error > MAX_TILT_ERROR_RAD:
        status = "collinear"
    return Alignment(
        status=status, target_from_source=fit, residuals=residuals, inliers=inliers, scale_error=scale_error, tilt_error_rad=tilt_error
    )


def compare_centers(scene_centers: ArrayLike, reference_centers: ArrayLike) -> CenterErrors:
    """Distances of camera centres (N,3) from references (N,3) after the plain least-squares
    similarity, in which no outlier is left out, so that a single lost camera shows in the maximum.
    Raises BadInput for fewer than three cameras."""
    source, target = _check_pairs(scene_centers, reference_centers)
    if len(source) < 3:
        raise BadInput(f"{len(source)} cameras cannot be compared with a reference: a similarity needs at least 3.")
    fit = fit_sim3(source, target)
    distances = np.linalg.norm(target[:, None] - target[None], axis=2)
    return CenterErrors(reference_from_scene=fit, errors=np.linalg.norm(fit.apply(source) - target, axis=1), extent=float(distances.max()))


def _check_pairs(source: ArrayLike, target: ArrayLike) -> tuple[FloatArray, FloatArray]:
    source = check_array("source", source, (None, 3))
    return source, check_array("target", target, (len(source), 3))


def _least_median_fit(source: FloatArray, target: FloatArray, seed: int) -> Sim3 | None:
    """The similarity of three random pairs with the smallest median residual; None if none fits."""
    if len(source) < 3:
        return None
    rng = np.random.default_rng(seed)
    picked = np.array([rng.choice(len(source), 3, replace=False) for _ in range(NUM_TRIALS)])
    scales, rotations, translations = _fit_triples(source[picked], target[picked])
    medians = np.full(NUM_TRIALS, np.inf)
    for rows in np.array_split(np.flatnonzero(scales > 0), -(-NUM_TRIALS * len(source) // PAIRS_AT_ONCE)):
        moved = scales[rows, None, None] * (source @ rotations[rows].transpose(0, 2, 1)) + translations[rows, None]
        # A shrunken scene always lies near the middle of the target; compare in the source's unit
        # so that it cannot win.
        medians[rows] = np.median(np.linalg.norm(moved - target, axis=2), axis=1) / scales[rows]
    best = int(np.argmin(medians))
    return fit_sim3(source[picked[best]], target[picked[best]]) if np.isfinite(medians[best]) else None


def _fit_triples(source: FloatArray, target: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """`fit_sim3` of T times three pairs (T,3,3): scales (T,), rotations (T,3,3), translations
    (T,3). No scale is above 0 where all of one side coincide."""
    from_source, from_target = (side - side.mean(axis=1, keepdims=True) for side in (source, target))
    variances = np.square(from_source).sum(axis=(1, 2))
    U, D, Vt = np.linalg.svd(from_target.transpose(0, 2, 1) @ from_source)
    signs = np.stack([np.ones(len(D)), np.ones(len(D)), np.sign(np.linalg.det(U @ Vt))], axis=1)
    scales = (D * signs).sum(axis=1) / np.where(variances > 0, variances, np.inf)
    rotations = (U * signs[:, None]) @ Vt
    translations = target.mean(axis=1) - scales[:, None] * np.einsum("tij,tj->ti", rotations, source.mean(axis=1))
    return scales, rotations, translations


def _refit(source: FloatArray, target: FloatArray, fit: Sim3) -> tuple[Sim3, FloatArray, NDArray[np.bool_]]:
    """Least sum of distances over the inliers, which are chosen anew in each round."""
    # The floor keeps pairs that agree to rounding from being outliers or taking all the weight.
    floor = 1e-9 * float(np.ptp(target, axis=0).max())
    residuals = np.linalg.norm(fit.apply(source) - target, axis=1)
    inliers = np.ones(len(source), bool)
    for _ in range(NUM_REFITS):
        median = float(np.median(residuals))
        inliers = residuals <= max(INLIER_SIGMAS * np.sqrt(3) * SIGMA_FROM_MEDIAN * median, floor)
        fit = fit_sim3(source, target, inliers / np.maximum(residuals, max(0.01 * median, floor)))
        residuals = np.linalg.norm(fit.apply(source) - target, axis=1)
    return fit, residuals, inliers
