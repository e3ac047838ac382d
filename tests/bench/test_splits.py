"""Splits that no run makes: each does what its name says, and stands beside the methods of runs."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.splits import ALL_METHODS, compare_all, plan_by, split
from radiant_core.plan.counts.deadline import edge_tables
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.regions.region_plan import PlanInfeasible, is_certified
from tests.core.plan.instances import LAYOUTS, linear_system


@pytest.mark.parametrize("seed", range(4))
def test_plans_are_those_of_the_split_and_never_beat_the_bound(seed: int) -> None:
    rng = np.random.default_rng(seed)
    positions = np.add(LAYOUTS["uniform"](rng, 150), [1000.0, -300.0])
    sites = rng.random((4, 2)) * [500.0, 250.0] + [1000.0, -300.0]
    system = linear_system(sites, rng.uniform(1, 4, 4))
    exact = plan_by("exact", positions, system)
    assert isinstance(exact, CloudPlan)
    tables = edge_tables(system, 150)
    for method in ("voronoi", "kd"):
        plan = plan_by(method, positions, system)
        assert isinstance(plan, CloudPlan) and plan.method == method
        np.testing.assert_array_equal(plan.edge_of_camera, split(method, positions, system))
        np.testing.assert_array_equal(plan.edge_time_s, [table.edge_time_s[n] for table, n in zip(tables, plan.counts, strict=True)])
        assert plan.lower_bound_s == exact.lower_bound_s <= plan.makespan_s
        if method == "voronoi":
            assert is_certified(positions, plan.sites, plan.weights, plan.edge_of_camera) and plan.num_outside == 0
    nearest = np.sum((positions[:, None] - sites) ** 2, axis=2).argmin(axis=1)
    np.testing.assert_array_equal(split("voronoi", positions, system), nearest)
    assert np.ptp(np.bincount(split("kd", positions, system), minlength=4)) <= 2


def test_a_split_beyond_the_memory_of_an_edge_is_infeasible() -> None:
    positions = np.random.default_rng(9).random((50, 2))
    system = linear_system(np.array([[0.5, 0.5], [90.0, 0.5]]), np.ones(2), 30)
    refused = plan_by("voronoi", positions, system)
    assert isinstance(refused, PlanInfeasible)
    assert refused.reason == "method voronoi gives edge 'e0' 50 cameras, it can hold 30: use method exact."
    halved = plan_by("kd", positions, system)
    assert isinstance(halved, CloudPlan) and halved.counts.tolist() == [25, 25]


def test_the_comparison_has_a_row_of_every_method() -> None:
    rng = np.random.default_rng(7)
    positions = rng.random((90, 2)) * [500.0, 250.0]
    system = linear_system(rng.random((3, 2)) * [500.0, 250.0], np.array([1.0, 2.0, 3.0]))
    rows = {row.method: row for row in compare_all(positions, system)}
    assert {*ALL_METHODS, "paper-halved"} == set(rows)
    for method in ("voronoi", "kd"):
        plan, row = plan_by(method, positions, system), rows[method]
        assert isinstance(plan, CloudPlan)
        assert row.makespan_s == plan.makespan_s and row.over_bound == pytest.approx(plan.makespan_s / plan.lower_bound_s)
        mean_s = row.edge_time_s.mean()
        assert row.history == (pytest.approx(np.abs(row.edge_time_s - mean_s).max() / mean_s),)
