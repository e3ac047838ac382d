"""Counts from entries near the deadline alone against whole tables."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.plan import wide_deadline
from radiant_core.plan.cost_curves import CostCurve
from radiant_core.plan.deadline import edge_tables, fastest_counts
from radiant_core.plan.system import System
from radiant_core.plan.wide_deadline import fastest_edge_counts, system_capacity, times_of_counts

from .instances import linear_system, random_curve, random_device, random_edge, random_system


@pytest.fixture(autouse=True)
def _never_small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wide_deadline, "SMALL_TABLE_ENTRIES", 0)


@pytest.mark.parametrize("seed", range(120))
def test_the_makespan_is_that_of_whole_tables(seed: int) -> None:
    rng = np.random.default_rng(seed)
    num_cameras = int(np.exp(rng.uniform(0, np.log(3000))))
    limits = (num_cameras // 3 + 1, 2 * num_cameras) if seed % 3 == 0 else None
    system = random_system(rng, int(rng.integers(3, 12)), limits)
    if seed % 2:
        edges = [replace(edge, aggregate_alone_s=random_curve(rng, 0.1) if rng.random() < 0.7 else None) for edge in system.edges]
        system = System(edges=tuple(edges))
    tables = edge_tables(system, num_cameras)
    if sum(table.capacity for table in tables) < num_cameras:
        pytest.skip("memory cannot hold this instance, which the caller checks first")
    _, bound_s = fastest_counts(tables, num_cameras)
    found = fastest_edge_counts(system, num_cameras)
    assert found.counts.sum() == num_cameras
    assert found.edge_time_s.max() == pytest.approx(bound_s, rel=1e-12)  # bytes are added up from another start
    np.testing.assert_allclose(times_of_counts(system, found.counts), found.edge_time_s, rtol=1e-12)


def test_flat_curves_share_a_million_cameras_evenly() -> None:
    edge = random_edge(np.random.default_rng(0), "e", 1)
    flat = CostCurve(constant=3.0)
    free = CostCurve()
    device = random_device(np.random.default_rng(0), "d", None)
    edges = [
        replace(edge, id=f"e{i}", aggregate_s=free, devices=(replace(device, id=f"d{i}", init_s=free, train_s=flat, model_bytes=free),))
        for i in range(100)
    ]
    found = fastest_edge_counts(System(edges=tuple(edges)), 1_000_000)
    assert found.counts.sum() == 1_000_000
    assert np.ptp(found.counts) <= 1
    assert (found.edge_time_s == 3.0).all()


def test_a_million_cameras_follow_the_speeds() -> None:
    seconds = np.random.default_rng(1).uniform(0.5, 2, 256)
    found = fastest_edge_counts(linear_system(np.random.default_rng(2).random((256, 2)), seconds), 1_000_000)
    assert found.counts.sum() == 1_000_000
    # No edge could take one more camera within the makespan that another would have to give up.
    assert ((found.counts + 1) * seconds >= found.edge_time_s.max()).all()


def test_capacity_counts_each_device_up_to_the_scene() -> None:
    assert system_capacity(linear_system(np.eye(2), np.ones(2), 30), 1000) == 60
    assert system_capacity(linear_system(np.eye(2), np.ones(2), 30), 20) == 40


def test_curves_that_overflow_are_refused() -> None:
    system = linear_system(np.eye(2), np.array([1e308, 1.0]))
    with pytest.raises(BadInput, match="not finite"):
        fastest_edge_counts(system, 1000)


def test_the_guess_is_so_near_that_the_first_window_proves_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Any guess leads to the optimum, a bad one over windows three times as wide each."""
    windows: list[int] = []
    solved = wide_deadline._Fleet.solved

    def counted(fleet: Any, low: np.ndarray, high: np.ndarray) -> Any:
        windows[-1] += 1
        return solved(fleet, low, high)

    monkeypatch.setattr(wide_deadline._Fleet, "solved", counted)
    for seed in range(40):
        rng = np.random.default_rng(seed)
        system = random_system(rng, int(rng.integers(3, 12)))
        windows.append(0)
        fastest_edge_counts(system, int(np.exp(rng.uniform(np.log(500), np.log(20_000)))))
    assert windows.count(1) >= 35, windows  # where curves are flat a deadline says little


def test_devices_that_time_does_not_tell_apart_are_refused_before_memory_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    system = linear_system(np.random.default_rng(0).random((4, 2)), np.array([1.0, 1.5, 2.0, 3.0]))
    # Each window is 2 % of the quota and 4 cameras wide, rounded up.
    for entries, passes in ((70, True), (40, False)):
        monkeypatch.setattr(wide_deadline, "MAX_TABLE_ENTRIES", entries)
        if passes:
            assert fastest_edge_counts(system, 2000).counts.sum() == 2000
        else:
            with pytest.raises(BadInput, match="2000 cameras on 4 devices cannot be told apart by time: use fewer"):
                fastest_edge_counts(system, 2000)
