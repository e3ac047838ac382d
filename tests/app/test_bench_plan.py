"""The planner's benchmark: the layouts have their cameras inside the land, and the figures are what the keys say."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from radiant_app.bench import plan as bench
from radiant_app.bench.plan import LayoutKind, bench_plan, camera_layout


@pytest.mark.parametrize("kind", get_args(LayoutKind))
@pytest.mark.parametrize("num_cameras", [1, 2, 97, 1600])
def test_layouts_repeat_and_lie_in_the_land(kind: LayoutKind, num_cameras: int) -> None:
    positions = camera_layout(kind, num_cameras, np.random.default_rng(0))
    assert positions.shape == (num_cameras, 2)
    np.testing.assert_array_equal(positions, camera_layout(kind, num_cameras, np.random.default_rng(0)))
    # Clusters and streets scatter by at most 15 m (one sigma) beyond the 500 × 250 m.
    assert (positions > -100).all()
    assert (positions < [600, 350]).all()


def test_a_lawnmower_flies_from_neighbour_to_neighbour() -> None:
    positions = camera_layout("lawnmower", 200, np.random.default_rng(0))
    assert np.hypot(*np.diff(positions, axis=0).T).max() < 50.0


def test_exact_is_at_the_bound_and_no_method_below(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "_QUICK_SIZES", ((60, 3),))
    metrics = {metric.key: metric.value for metric in bench_plan(quick=True)}
    assert len(metrics) == 4 * 4 * 2
    ratios = {key: value for key, value in metrics.items() if key.endswith("makespan_over_bound")}
    assert all(value == 1.0 for key, value in ratios.items() if ".exact." in key)
    assert all(value >= 1.0 for value in ratios.values())
    assert all(value > 0 for key, value in metrics.items() if key.endswith("time_ms"))
    assert "plan.60x3.street.paper.makespan_over_bound" in metrics
