"""Slack: the least Σ distance² of all plans within the makespan, by exhaustion; and its curve."""

from __future__ import annotations

from itertools import pairwise, product

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.plan.borders.borders import shared_borders
from radiant_core.plan.counts import slack as slack_module
from radiant_core.plan.counts.deadline import edge_tables
from radiant_core.plan.counts.slack import capacities_within
from radiant_core.plan.counts.slack_curve import border_length_m, slack_curve
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.regions.power_diagram import rectangle
from radiant_core.plan.regions.region_plan import PlanInfeasible, plan_regions

from .instances import LAYOUTS, linear_system, random_system


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("slack", [1.0, 1.3])
def test_no_plan_within_the_makespan_has_a_smaller_sum(layout: str, slack: float) -> None:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        positions, system = LAYOUTS[layout](rng, 6), random_system(rng, 3)
        plan = plan_regions(positions, system, slack=slack)
        assert isinstance(plan, CloudPlan) and plan.certified and plan.slack == slack
        cost = np.sum((positions[:, None] - plan.sites) ** 2, axis=-1)
        tables = edge_tables(system, 6)
        allowed_s = slack * plan.lower_bound_s
        least = min(
            float(cost[np.arange(6), list(owners)].sum())
            for owners in product(range(3), repeat=6)
            if all(t.edge_time_s[n] <= allowed_s for t, n in zip(tables, np.bincount(owners, minlength=3), strict=True))
        )
        assert plan.makespan_s <= allowed_s
        assert float(cost[np.arange(6), plan.edge_of_camera].sum()) == pytest.approx(least, rel=1e-9, abs=1e-9)
        assert plan.status == ("optimal" if plan.makespan_s <= plan.lower_bound_s else "slack")


def test_the_curve_falls_in_distance_and_never_exceeds_its_slack() -> None:
    rng = np.random.default_rng(0)
    positions, system = LAYOUTS["clustered"](rng, 300), random_system(rng, 5)
    heard: list[float] = []
    points = slack_curve(positions, system, progress=heard.append)
    plan = plan_regions(positions, system)
    assert isinstance(plan, CloudPlan)
    assert heard == sorted(heard) and len(heard) == len(points)
    assert all(point.certified and point.makespan_s <= point.slack * plan.lower_bound_s * (1 + 1e-12) for point in points)
    distances = [point.rms_distance_m for point in points]
    assert all(later <= earlier + 1e-9 for earlier, later in pairwise(distances))
    counted = np.sqrt(np.mean(np.sum((positions - plan.sites[plan.edge_of_camera]) ** 2, axis=1)))
    assert distances[0] <= counted + 1e-9  # same makespan, freer counts


def test_capacities_of_large_systems_are_those_of_the_tables() -> None:
    rng = np.random.default_rng(1)
    system = random_system(rng, 3, limits=(20_000, 40_000))
    tables = edge_tables(system, 70_000)
    deadline_s = float(np.median(tables[0].edge_time_s))
    expected = [int((table.edge_time_s <= deadline_s).sum()) - 1 for table in tables]
    np.testing.assert_array_equal(capacities_within(system, 70_000, deadline_s), expected)


def test_borders_are_counted_once() -> None:
    halves = (
        rectangle(np.array([0.0, 0.0]), np.array([3.0, 5.0])),
        rectangle(np.array([3.0, 0.0]), np.array([9.0, 5.0])),
        np.zeros((0, 2)),
    )
    assert border_length_m(halves) == pytest.approx(5.0)
    assert border_length_m(halves[:1]) == 0.0


def test_slack_that_cannot_be_meant_is_refused() -> None:
    positions, system = np.zeros((3, 2)), linear_system(np.array([[0.0, 0.0], [5.0, 0.0]]), np.ones(2), max_cameras=1)
    for slack in (0.99, np.nan, np.inf):
        with pytest.raises(BadInput, match="slack is"):
            plan_regions(positions, system, slack=slack)
    with pytest.raises(BadInput, match="tolerance and slack"):
        plan_regions(positions, system, slack=1.1, tolerance=0.1)
    with pytest.raises(BadInput, match="slack is for method exact"):
        plan_regions(positions, system, slack=1.1, method="even")
    assert isinstance(plan_regions(positions, system, slack=2.0), PlanInfeasible)
    with pytest.raises(BadInput, match="no slack curve"):
        slack_curve(positions, system)


def test_every_figure_of_the_curve_is_that_of_its_plan() -> None:
    rng = np.random.default_rng(4)
    positions, system = LAYOUTS["uniform"](rng, 80), random_system(rng, 3)
    heard: list[float] = []
    for point in slack_curve(positions, system, (1.0, 1.5), progress=heard.append):
        plan = plan_regions(positions, system, slack=point.slack)
        assert isinstance(plan, CloudPlan)
        away_m = np.hypot(*(positions - plan.sites[plan.edge_of_camera]).T)
        assert (point.makespan_s, point.certified) == (plan.makespan_s, True)
        assert point.mean_distance_m == pytest.approx(away_m.mean(), rel=1e-12)
        assert point.rms_distance_m == pytest.approx(np.sqrt(np.mean(away_m**2)), rel=1e-12)
        assert point.border_m == pytest.approx(sum(border.length_m for border in shared_borders(plan)), rel=1e-6)
    assert heard == [0.0, 0.5]
    with pytest.raises(BadInput, match="there is no slack curve: the devices can hold 4 of 80 cameras"):
        slack_curve(positions, linear_system(np.eye(2), np.ones(2), 2))


@pytest.mark.parametrize("entries", [0, 59, 60])
def test_capacities_are_the_same_by_halving_and_by_table(entries: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """By counting: how many cameras an edge finishes in time, to the last bit of the deadline."""
    monkeypatch.setattr(slack_module, "SMALL_TABLE_ENTRIES", entries)
    for seed in range(6):
        system = random_system(np.random.default_rng(seed), 4, (5, 40) if seed % 2 else None)
        tables = edge_tables(system, 60)
        for deadline_s in (float(tables[0].edge_time_s[3]), float(np.nextafter(tables[1].edge_time_s[2], 0)), 0.0, 1e9):
            expected = [max(c for c in range(len(t.edge_time_s)) if t.edge_time_s[c] <= deadline_s) for t in tables]
            np.testing.assert_array_equal(capacities_within(system, 60, deadline_s), expected)
