"""The planner's benchmark: the layouts have their cameras inside the land, and the figures are what the keys say."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import numpy as np
import pytest

import benchmarks
from benchmarks import plan as bench
from benchmarks.plan import LayoutKind, bench_plan, camera_layout, drag_metrics, system_metrics
from radiant_app.files.system_file import load_system


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
    monkeypatch.setattr(bench, "_QUICK_SCALES", ())
    metrics = {metric.key: metric.value for metric in bench_plan(quick=True) if ".60x3." in metric.key}
    assert len(metrics) == 4 * 6 * 2
    ratios = {key: value for key, value in metrics.items() if key.endswith("makespan_over_bound")}
    assert all(value == 1.0 for key, value in ratios.items() if ".exact." in key)
    assert all(value >= 1.0 for value in ratios.values())
    assert all(value > 0 for key, value in metrics.items() if key.endswith("time_ms"))
    assert "plan.60x3.street.paper.makespan_over_bound" in metrics


@pytest.mark.parametrize(("number", "num_edges", "num_devices"), [(1, 3, 5), (2, 4, 7)])
def test_the_papers_systems_have_a_device_per_gpu_that_a_region_lists(number: int, num_edges: int, num_devices: int) -> None:
    system = load_system(Path(benchmarks.__file__).parent / "systems" / f"paper_{number}.toml")
    assert (len(system.edges), len(system.devices)) == (num_edges, num_devices)


def test_exact_is_never_slower_than_what_it_is_compared_with() -> None:
    seconds = {metric.key: metric.value for metric in system_metrics()}
    assert len(seconds) == 12
    for key, value in seconds.items():
        system, scene = key.split(".")[1:3]
        assert seconds[f"plan.{system}.{scene}.exact.simulated_s"] <= value


def test_a_dragged_edge_keeps_the_bound_and_a_dragged_weight_is_planned_around() -> None:
    figures = {metric.key: metric.value for metric in drag_metrics(3)}
    assert figures["plan.2000x64.drag_makespan_over_bound"] == 1.0
    assert 0 < figures["plan.2000x64.weight_drag_median_ms"] <= figures["plan.2000x64.weight_drag_p95_ms"]
    assert 0 <= figures["plan.2000x64.weight_drag_outside"] <= 40
