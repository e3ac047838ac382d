"""Curves from samples: what generated them comes back, and what is no cost is refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import nnls

from radiant_core.errors import BadInput
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.profiles.curve_fit import FittedCurve, falls, fit_curve
from tests.seeds import for_seeds

COUNTS = np.array([10, 20, 50, 100, 200, 400])


@pytest.mark.parametrize(
    "curve",
    [
        CostCurve(constant=20, linear=1),
        CostCurve(linear=0.5),
        CostCurve(constant=7),
        CostCurve(constant=5, linear=0.1, power_coefficient=0.02, exponent=1.5),
        CostCurve(power_coefficient=3, exponent=0.5),
    ],
)
def test_the_generating_curve_is_found_again(curve: CostCurve) -> None:
    fitted = fit_curve(COUNTS, curve(COUNTS))
    assert fitted.worst_error is not None and fitted.worst_error < 1e-6
    np.testing.assert_allclose(fitted.curve([15, 300]), curve([15, 300]), rtol=1e-6)
    assert (fitted.smallest_count, fitted.largest_count) == (10, 400)


@for_seeds(20)
def test_noise_of_five_percent_moves_predictions_by_little_more(seed: int) -> None:
    rng = np.random.default_rng(seed)
    curve = CostCurve(constant=rng.uniform(1, 50), linear=rng.uniform(0.1, 2))
    fitted = fit_curve(COUNTS, curve(COUNTS) * rng.normal(1, 0.05, len(COUNTS)))
    assert (np.abs(fitted.curve(COUNTS) / curve(COUNTS) - 1) < 0.2).all()
    assert (np.diff(fitted.curve(np.arange(1, 1000))) >= 0).all()


def test_one_sample_is_taken_in_proportion() -> None:
    assert float(fit_curve([50], [100.0]).curve(25)) == pytest.approx(50.0)


@pytest.mark.parametrize(
    ("counts", "values", "message"),
    [
        ([], [], "at least one sample"),
        ([0, 1], [1.0, 2.0], "at least one sample"),
        ([1, 2], [1.0, 0.0], "positive values"),
        ([1, 2], [1.0, np.nan], "not finite"),
        ([10, 20, 40], [9.0, 5.0, 1.0], "does not fall"),
    ],
)
def test_what_is_no_cost_is_refused(counts: list, values: list, message: str) -> None:
    with pytest.raises(BadInput, match=message):
        fit_curve(counts, values)


@pytest.mark.parametrize("scale", [1e-12, 1e12])
def test_tiny_and_huge_values_are_fitted_as_well(scale: float) -> None:
    curve = CostCurve(constant=5 * scale, linear=0.1 * scale)
    fitted = fit_curve([1, 10**3, 10**6, 10**9], curve([1, 10**3, 10**6, 10**9]))
    np.testing.assert_allclose(fitted.curve([30, 10**8]), curve([30, 10**8]), rtol=1e-6)


def test_one_count_measured_often_and_equal_values_are_no_trouble() -> None:
    often = fit_curve([20, 20, 20], [9.0, 10.0, 11.0])
    assert float(often.curve(20)) == pytest.approx(10, abs=0.2) and often.rmse == pytest.approx(0.08, abs=0.01)
    assert float(fit_curve([5, 10, 20], [3.0, 3.0, 3.0]).curve(1000)) == pytest.approx(3.0)


def test_falling_values_of_a_busy_machine_give_a_flat_curve_and_their_error() -> None:
    fitted = fit_curve([10, 20, 40], [9.0, 5.0, 4.0], may_fall=True)
    assert falls([10, 20, 40], [9.0, 5.0, 4.0]) and not falls([10, 20, 40], [9.0, 9.0, 8.9]) and not falls([5], [1.0])
    assert float(fitted.curve(10)) == pytest.approx(float(fitted.curve(1000))) and fitted.rmse is not None and fitted.rmse > 0.2


def test_the_errors_are_those_of_the_samples() -> None:
    fitted = fit_curve([10, 20, 40], [11.0, 19.0, 42.0])
    errors = fitted.curve([10, 20, 40]) / [11.0, 19.0, 42.0] - 1
    assert fitted.rmse == pytest.approx(np.sqrt(np.mean(errors**2)), rel=1e-12) and np.abs(errors).max() > 0.01
    assert fitted.worst_error == pytest.approx(np.abs(errors).max(), rel=1e-12)
    assert fitted.samples == ((10, 11.0), (20, 19.0), (40, 42.0))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"smallest_count": 0}, "on 0 to 40 cameras"),
        ({"largest_count": 9}, "on 10 to 9 cameras"),
        ({"largest_count": 50}, "do not span 10 to 50 cameras"),
        ({"rmse": float("nan")}, "rmse is nan"),
        ({"worst_error": -0.1}, "worst_error is -0.1"),
        ({"rmse": 0.5}, "states rmse 0.5"),
        ({"rmse": None}, "states rmse None"),
        ({"samples": ((10, 10.0), (40, float("inf")))}, "positive values"),
        ({"samples": ((10, 0.0), (40, 40.0))}, "positive values"),
        ({"samples": ((10, 40.0), (40, 10.0))}, "its samples give"),
    ],
)
def test_a_curve_that_its_samples_belie_is_refused(fields: dict, message: str) -> None:
    right = {"curve": CostCurve(linear=1), "smallest_count": 10, "largest_count": 40, "samples": ((10, 10.0), (40, 40.0))}
    with pytest.raises(BadInput, match=message):
        FittedCurve(**{**right, "rmse": 0.0, "worst_error": 0.0, **fields})


def test_a_power_term_is_taken_only_where_it_is_worth_it() -> None:
    """Against the fit without one: it is never worse, and with one better by a hundredth."""
    with_power = 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        values = (10 + 0.5 * COUNTS) * rng.normal(1, 0.05, len(COUNTS))
        fitted = fit_curve(COUNTS, values)
        plain, _ = nnls(np.stack([np.ones(len(COUNTS)), COUNTS], axis=1) / values[:, None], np.ones(len(COUNTS)))
        plain_rmse = float(np.sqrt(np.mean(((plain[0] + plain[1] * COUNTS) / values - 1) ** 2)))
        assert fitted.rmse is not None and fitted.rmse <= plain_rmse * (1 + 1e-9)
        if fitted.curve.power_coefficient:
            with_power += 1
            assert fitted.rmse < 0.99 * plain_rmse, seed
    assert with_power > 0


@pytest.mark.parametrize(("last", "is_falling"), [(9.0, False), (7.37, False), (7.36, True)])
def test_values_fall_where_they_lose_more_than_a_fifth_over_their_range(last: float, is_falling: bool) -> None:
    """Two values define a line: from 9 to 8.1 / 1.1 it falls by a fifth of their mean."""
    assert falls([10, 20], [9.0, last]) is is_falling and falls([20, 10], [last, 9.0]) is is_falling


def test_a_refusal_says_from_where_to_where_values_fall() -> None:
    with pytest.raises(BadInput, match="the values fall from 9 at 10 cameras to 1 at 40: a cost does not fall with cameras"):
        fit_curve([40, 10, 20], [1.0, 9.0, 5.0])


@pytest.mark.parametrize("count", [3, 4])
def test_a_power_term_needs_four_counts(count: int) -> None:
    counts = np.array([1, 4, 9, 100])[:count]
    fitted = fit_curve(counts, 3 * np.sqrt(counts))
    assert (fitted.curve.power_coefficient > 0) is (count == 4)
    if count == 4:
        assert fitted.curve.exponent == 0.5 and fitted.worst_error == pytest.approx(0, abs=1e-9)
    repeated = fit_curve([1, 4, 9, 9], 3 * np.sqrt([1, 4, 9, 9]))
    assert repeated.curve.power_coefficient == 0


@pytest.mark.parametrize("exponent", [0.25, 2.125, 3.0])
def test_exponents_from_a_quarter_to_three_are_found(exponent: float) -> None:
    counts = np.array([1, 3, 10, 30, 100])
    fitted = fit_curve(counts, 2.0 + 0.5 * counts**exponent)
    assert fitted.curve.exponent == exponent and fitted.curve.power_coefficient == pytest.approx(0.5, rel=1e-6)


def test_errors_may_be_off_by_a_millionth() -> None:
    right = {"curve": CostCurve(linear=1), "smallest_count": 10, "largest_count": 40, "samples": ((10, 10.0), (40, 40.0))}
    FittedCurve(**right, rmse=1e-6, worst_error=0.0)
    with pytest.raises(BadInput, match=r"a curve states rmse 0\.0 and worst_error 2e-06, its samples give 0 and 0: profile again"):
        FittedCurve(**right, rmse=0.0, worst_error=2e-6)
    FittedCurve(curve=CostCurve(), smallest_count=1, largest_count=1, rmse=0.0, worst_error=0.0)
