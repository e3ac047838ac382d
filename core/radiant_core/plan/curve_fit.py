"""Cost curves from measurements: a + b·c + d·c^p with a, b, d ≥ 0, the range they were measured in, and corrections while a run goes on.

For each exponent of a grid the non-negative least squares of the relative error (Lawson, Hanson, 1974); the best exponent wins,
the simpler curve where the power term gains less than 1 %. Runs once per profile, a few samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize  # pyright: ignore[reportMissingTypeStubs]

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, checked_array
from radiant_core.plan.cost_curves import CostCurve

EXTRAPOLATION = 2.0
"""A curve is trusted up to this many times the largest measured count."""
_EXPONENTS = np.arange(0.25, 3.01, 0.125)
_WORTH_A_TERM = 0.99


@dataclass(frozen=True, kw_only=True)
class FittedCurve:
    """A curve and what it rests on."""

    curve: CostCurve
    smallest_count: int
    largest_count: int
    worst_error: float
    """Largest relative error at the samples."""
    key: str = ""
    """Preset and step policy it was measured with; curves of another key do not fit."""

    def extrapolates(self, num_cameras: int) -> bool:
        """Whether so many cameras lie beyond twice the measured range."""
        return num_cameras > EXTRAPOLATION * self.largest_count


def fit_curve(counts: ArrayLike, values: ArrayLike, *, key: str = "") -> FittedCurve:
    """The curve nearest to values (S,) at camera counts (S,), in relative error.

    Raises BadInput without samples, for counts below 1, for values that are not positive, and where values fall with the count.
    """
    counts = checked_array("counts", counts, (None,))
    values = checked_array("values", values, (len(counts),))
    if not len(counts) or counts.min() < 1 or values.min() <= 0:
        raise BadInput("a cost curve needs at least one sample, counts of at least 1 and positive values: measure again.")
    slope = float(np.polyfit(counts, values, 1)[0]) if np.ptp(counts) else 0.0
    if slope * float(np.ptp(counts)) < -0.2 * float(values.mean()):
        raise BadInput(
            f"the values fall from {values[counts.argmin()]:.4g} at {counts.min():.0f} cameras to {values[counts.argmax()]:.4g} at "
            f"{counts.max():.0f}: a cost does not fall with cameras, check the measurement."
        )
    plain = np.stack([np.ones_like(counts), counts], axis=1)
    if len(np.unique(counts)) == 1:
        plain[:, 0] = 0  # One count says nothing about a constant: in proportion.
    coefficients, error = _fitted(plain, values)
    curve = CostCurve(constant=coefficients[0], linear=coefficients[1])
    if len(np.unique(counts)) >= 4:
        for exponent in _EXPONENTS[_EXPONENTS != 1]:
            more, new_error = _fitted(np.column_stack([plain, counts**exponent]), values)
            if new_error < _WORTH_A_TERM * error:
                error = new_error
                curve = CostCurve(constant=more[0], linear=more[1], power_coefficient=more[2], exponent=float(exponent))
    worst = float(np.abs(curve(counts) / values - 1).max())
    return FittedCurve(curve=curve, smallest_count=int(counts.min()), largest_count=int(counts.max()), worst_error=worst, key=key)


def corrected(curve: CostCurve, num_cameras: int, measured: float) -> CostCurve:
    """The curve scaled through the first measured sample of a run; the curve itself where it predicts nothing to scale."""
    if not np.isfinite(measured) or measured <= 0 or num_cameras < 1:
        raise BadInput(f"{measured} was measured for {num_cameras} cameras: give a positive value and at least one camera.")
    predicted = float(curve(num_cameras))
    return curve.scaled(measured / predicted) if predicted > 0 else curve


def _fitted(terms: FloatArray, values: FloatArray) -> tuple[list[float], float]:
    """Non-negative coefficients of the terms (S,K) with the least relative error, and that error."""
    scale = np.abs(terms).max(axis=0)
    scale[scale == 0] = 1.0
    solver: Any = optimize
    solution: FloatArray
    solution, error = solver.nnls(terms / scale / values[:, None], np.ones(len(values)))
    coefficients: list[float] = (solution / scale).tolist()
    return coefficients, float(error)
