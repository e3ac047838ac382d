"""Metrics: strict values, a lossless list, and a comparison that fails on every worsening only."""

from __future__ import annotations

from typing import Any

import pytest

from benchmarks.metric import Metric, metrics_from_json, metrics_to_json, regressions
from radiant_core.errors import BadInput


def psnr(value: float, tolerance: float = 0.0) -> Metric:
    return Metric(key="a.psnr_db", value=value, unit="dB", direction="higher", tolerance=tolerance)


def seconds(value: float, tolerance: float = 0.0) -> Metric:
    return Metric(key="a.cpu_s", value=value, unit="s", direction="lower", tolerance=tolerance)


def test_a_list_of_metrics_comes_back_without_tolerances() -> None:
    rows = metrics_to_json([psnr(24.5, 0.1), seconds(3)])
    assert rows[0] == {"key": "a.psnr_db", "value": 24.5, "unit": "dB", "direction": "higher"}
    assert metrics_from_json(rows) == (psnr(24.5), seconds(3.0))


@pytest.mark.parametrize("value", [float("nan"), float("inf"), "3", None, True, 10**400, [1]])
def test_a_value_that_is_no_finite_number_is_refused(value: Any) -> None:
    with pytest.raises(BadInput, match=r"metric a\.psnr_db has the value"):
        psnr(value)


@pytest.mark.parametrize("wrong", [{"key": ""}, {"direction": "up"}, {"unit": None}, {"tolerance": -1.0}, {"tolerance": float("nan")}])
def test_a_wrong_field_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(BadInput):
        Metric(**{"key": "k", "value": 1.0, "unit": "s", "direction": "lower", **wrong})


@pytest.mark.parametrize("rows", [None, {}, [1], [{"key": "k"}], [{"key": "k", "value": 1, "unit": "s", "direction": "lower", "x": 1}]])
def test_json_that_is_no_list_of_metrics_is_refused(rows: Any) -> None:
    with pytest.raises(BadInput):
        metrics_from_json(rows)


def test_a_key_twice_is_refused_everywhere() -> None:
    twice = [seconds(1), seconds(2)]
    for call in (lambda: metrics_to_json(twice), lambda: regressions(twice, []), lambda: regressions([], twice)):
        with pytest.raises(BadInput, match=r"a\.cpu_s comes twice"):
            call()


@pytest.mark.parametrize(
    ("new", "old", "worse"),
    [
        (psnr(24.0), psnr(24.5), True),
        (psnr(25.0), psnr(24.5), False),
        (psnr(24.5), psnr(24.5), False),
        (psnr(24.0, 0.5), psnr(24.5), False),
        (psnr(23.75, 0.5), psnr(24.5), True),
        (seconds(2.0), seconds(1.0), True),
        (seconds(0.5), seconds(1.0), False),
        (seconds(2.0, 1.0), seconds(1.0), False),
    ],
)
def test_a_regression_is_worse_by_more_than_the_tolerance(new: Metric, old: Metric, worse: bool) -> None:
    assert bool(regressions([new], [old])) == worse


def test_info_is_never_compared_and_new_keys_are_welcome() -> None:
    info = Metric(key="n", value=5, unit="1", direction="info")
    assert regressions([psnr(1)], [info]) == ()
    assert regressions([Metric(key="n", value=-5, unit="1", direction="info")], [info]) == ()


def test_a_blessed_figure_that_vanished_is_a_regression() -> None:
    assert "not measured any more" in regressions([], [psnr(20)])[0]


def test_a_changed_unit_or_direction_is_bad_input() -> None:
    with pytest.raises(BadInput, match="bless it anew"):
        regressions([Metric(key="a.cpu_s", value=1000, unit="ms", direction="lower")], [seconds(1)])
