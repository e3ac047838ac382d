"""Cost curves from measurements: a + b·c + d·c^p with a, b, d ≥ 0, and the range they hold for.

For each exponent of a grid the non-negative least squares of the relative error (Lawson, Hanson,
1974); the best exponent wins, or the simpler curve where the power term gains less than 1 %. Once
per profile.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array
from radiant_core.plan.profiles.cost_curves import CostCurve

EXTRAPOLATION = 2.0
"""A curve is trusted up to this many times the largest measured count."""
_EXPONENTS = np.arange(0.25, 3.01, 0.125)
_WORTH_A_TERM = 0.99
_SAME_ERROR = 1e-6
"""How far errors that a file states may be off its samples': rounding of numbers as text."""


@dataclass(frozen=True, kw_only=True)
class FittedCurve:
    """A curve and what it rests on. Raises BadInput for an empty range, for samples that do not
    span it, and for errors they belie."""

    curve: CostCurve
    smallest_count: int
    largest_count: int
    samples: tuple[tuple[int, float], ...] = ()
    """Camera count and measured value; none for an estimate."""
    rmse: float | None = None
    """Root mean square of relative errors at the samples; of an estimate, its source's scatter."""
    worst_error: float | None = None
    """Largest relative error at the samples."""

    def __post_init__(self) -> None:
        if not 1 <= self.smallest_count <= self.largest_count:
            raise BadInput(f"a curve was fitted on {self.smallest_count} to {self.largest_count} cameras, expected 1 or more, rising.")
        for name in ("rmse", "worst_error"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value >= 0):
                raise BadInput(f"a curve's {name} is {value}, expected a finite share of at least 0.")
        if not self.samples:
            return
        counts, values = np.array(self.samples, dtype=np.float64).T
        _require_costs(counts, values)
        if (counts.min(), counts.max()) != (self.smallest_count, self.largest_count):
            raise BadInput(
                f"a curve's samples do not span {self.smallest_count} to {self.largest_count} cameras, its range: profile again."
            )
        rmse, worst = _errors(self.curve, counts, values)
        if self.rmse is None or self.worst_error is None or max(abs(self.rmse - rmse), abs(self.worst_error - worst)) > _SAME_ERROR:
            stated = f"rmse {self.rmse} and worst_error {self.worst_error}"
            raise BadInput(f"a curve states {stated}, its samples give {rmse:.6g} and {worst:.6g}: profile again.")


def fit_curve(counts: ArrayLike, values: ArrayLike, *, may_fall: bool = False) -> FittedCurve:
    """The curve nearest to values (S,) at camera counts (S,), in relative error. BadInput without
    samples, for counts below 1, values that are not positive, and values that fall with the count
    unless they `may_fall`: what a busy machine measured gives a flat curve and a large error."""
    counts = check_array("counts", counts, (None,))
    values = check_array("values", values, (len(counts),))
    _require_costs(counts, values)
    if not may_fall and falls(counts, values):
        raise BadInput(
            f"the values fall from {values[counts.argmin()]:.4g} at {counts.min():.0f} cameras to {values[counts.argmax()]:.4g} at "
            f"{counts.max():.0f}: a cost does not fall with cameras, check the measurement."
        )
    plain = np.stack([np.ones_like(counts), counts], axis=1)
    if len(np.unique(counts)) == 1:
        plain[:, 0] = 0  # One count says nothing about a constant: in proportion.
    coefficients, error = _fit_terms(plain, values)
    curve = CostCurve(constant=coefficients[0], linear=coefficients[1])
    if len(np.unique(counts)) >= 4:
        for exponent in _EXPONENTS[_EXPONENTS != 1]:
            more, new_error = _fit_terms(np.column_stack([plain, counts**exponent]), values)
            if new_error < _WORTH_A_TERM * error:
                error = new_error
                curve = CostCurve(constant=more[0], linear=more[1], power_coefficient=more[2], exponent=float(exponent))
    rmse, worst = _errors(curve, counts, values)
    return FittedCurve(
        curve=curve,
        smallest_count=int(counts.min()),
        largest_count=int(counts.max()),
        samples=tuple((int(count), float(value)) for count, value in zip(counts, values, strict=True)),
        rmse=rmse,
        worst_error=worst,
    )


def _require_costs(counts: FloatArray, values: FloatArray) -> None:
    if not len(counts) or counts.min() < 1 or not (np.isfinite(values).all() and values.min() > 0):
        raise BadInput("a cost curve needs at least one sample, counts of at least 1 and positive values: measure again.")


def falls(counts: ArrayLike, values: ArrayLike) -> bool:
    """Whether values (S,) fall with the counts by more than a fifth over their range."""
    counts, values = np.asarray(counts, np.float64), np.asarray(values, np.float64)
    slope = float(np.polyfit(counts, values, 1)[0]) if np.ptp(counts) else 0.0
    return slope * float(np.ptp(counts)) < -0.2 * float(values.mean())


def _errors(curve: CostCurve, counts: FloatArray, values: FloatArray) -> tuple[float, float]:
    """Root mean square and largest relative error at the samples (S,)."""
    errors = curve(counts) / values - 1
    return float(np.sqrt(np.mean(errors**2))), float(np.abs(errors).max())


def _fit_terms(terms: FloatArray, values: FloatArray) -> tuple[list[float], float]:
    """Coefficients ≥ 0 of the terms (S,K) with the least relative error, and that error."""
    from scipy import optimize  # pyright: ignore[reportMissingTypeStubs]

    scale = np.abs(terms).max(axis=0)
    scale[scale == 0] = 1.0
    solver: Any = optimize
    solution: FloatArray
    solution, error = solver.nnls(terms / scale / values[:, None], np.ones(len(values)))
    coefficients: list[float] = (solution / scale).tolist()
    return coefficients, float(error)
