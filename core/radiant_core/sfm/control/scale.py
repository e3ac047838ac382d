"""How well a survey fixes the scale of a scene. Once per scene.

    σ_scale = σ / √Σ ‖x − x̄‖²

x: the control points that count, or the positions of known accuracy where there are none; σ: per
axis what they, and check points, are off by, and no less than what the survey was said to be.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from radiant_core.numerics import FloatArray
from radiant_core.sfm.control.quality import PointQuality

MIN_POINTS = 2
"""Any length lies between two."""


def scale_by_points(points: Sequence[PointQuality], places_m: FloatArray, sigmas_m: FloatArray) -> float | None:
    """Relative standard deviation of a scale by control points at places (G,3), the first of
    `points`, with the survey's deviations (3,); None where too few of them count."""
    control = [point for point in points if not point.is_check]
    counts = np.array([point.counts for point in control], np.bool_)
    off_m = [point.residual_m for point in points if point.counts]
    return _scale_sigma(places_m[counts], off_m, sigmas_m) if counts.any() else None


def scale_by_positions(positions_m: FloatArray, misses_m: FloatArray, sigmas_m: FloatArray) -> float | None:
    """The same by positions (N,3) of known accuracy (N,3) that miss their cameras by (N,3)."""
    return _scale_sigma(positions_m, misses_m.tolist(), np.sqrt(np.mean(np.square(sigmas_m), axis=0))) if len(positions_m) else None


def _scale_sigma(places_m: FloatArray, off_m: Sequence[Sequence[float]], sigmas_m: FloatArray) -> float | None:
    spread_m = float(np.linalg.norm(places_m - places_m.mean(axis=0)))
    if len(places_m) < MIN_POINTS or not spread_m > 0:
        return None
    return max(_rms(np.array(off_m)), _rms(sigmas_m)) / spread_m


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
