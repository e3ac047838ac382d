"""The planner's second benchmark: systems that differ stay systems, and a sample helps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import radiant_app
from radiant_app.bench.plan_scale import regret, simulated_systems, slacks, varied, weight_dragged
from radiant_app.files.system_file import load_system

FOLDER = Path(radiant_app.__file__).parent / "systems"


@pytest.mark.parametrize(("number", "num_edges", "num_devices"), [(1, 3, 5), (2, 4, 7)])
def test_the_papers_systems_have_a_device_per_gpu_that_a_region_lists(number: int, num_edges: int, num_devices: int) -> None:
    system = load_system(FOLDER / f"paper_{number}.toml")
    assert (len(system.edges), len(system.devices)) == (num_edges, num_devices)


def test_variation_stays_within_thirty_percent() -> None:
    system = load_system(FOLDER / "paper_1.toml")
    other = varied(system, np.random.default_rng(0))
    ratios = [b.train_s.linear / a.train_s.linear for a, b in zip(system.devices, other.devices, strict=True)]
    assert all(0.7 <= ratio <= 1.3 for ratio in ratios)
    assert len(set(ratios)) == len(ratios)


def test_exact_is_never_slower_than_what_it_is_compared_with() -> None:
    metrics = {metric.key: metric.value for metric in simulated_systems(3)}
    for number in (1, 2):
        for scene in ("rubble", "building"):
            times_s = {
                name: metrics[f"plan.system{number}.{scene}.{name}.simulated_s"]
                for name in ("exact", "paper", "even_per_device", "fed3dgs")
            }
            assert min(times_s.values()) == times_s["exact"]


def test_one_sample_lowers_the_regret() -> None:
    metrics = {metric.key: metric.value for metric in regret(10)}
    assert 0 <= metrics["plan.regret.corrected_p50_percent"] < metrics["plan.regret.profiled_p50_percent"]


def test_slack_brings_cameras_nearer_within_its_makespan_and_a_dragged_weight_is_planned_around() -> None:
    found = {metric.key: metric.value for metric in slacks(1)}
    distances_m = [found[f"plan.1600x16.slack_{slack}_rms_distance_m"] for slack in ("1", "1.1", "1.5")]
    assert distances_m == sorted(distances_m, reverse=True) and distances_m[0] > distances_m[-1]
    for slack in (1.0, 1.1, 1.5):
        assert found[f"plan.1600x16.slack_{slack:g}_makespan_over_bound"] <= slack * (1 + 1e-12)
        assert found[f"plan.1600x16.slack_{slack:g}_certified"] == 1.0
    drag = {metric.key: metric.value for metric in weight_dragged(3)}
    assert 0 < drag["plan.2000x64.weight_drag_median_ms"] <= drag["plan.2000x64.weight_drag_p95_ms"]
    assert 0 <= drag["plan.2000x64.weight_drag_outside"] <= 40
