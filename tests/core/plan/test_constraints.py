"""Fixed weights, locked regions, pinned cameras: what is given stays, the rest is optimal."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.plan.counts.deadline import edge_tables
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.regions.constraints import PlanConstraints, counts_at_least
from radiant_core.plan.regions.power_diagram import assign
from radiant_core.plan.regions.region_plan import PlanInfeasible, plan_regions
from radiant_core.plan.system import System

from .instances import LAYOUTS, linear_system, random_system


def planned(*args, **kwargs) -> CloudPlan:
    plan = plan_regions(*args, **kwargs)
    assert isinstance(plan, CloudPlan)
    return plan


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("seed", range(4))
def test_everything_given_stays_and_nobody_else_joins(layout: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    positions, system = LAYOUTS[layout](rng, 60), random_system(rng, 5)
    start = planned(positions, system)
    pins = {int(camera): "e3" for camera in np.flatnonzero(start.edge_of_camera != 0)[:3]}
    constraints = PlanConstraints(locked=("e0",), fixed_weights_m2={"e1": float(start.weights[1]) + 300.0}, pinned=pins)
    plan = planned(positions, system, constraints=constraints, start=start)
    np.testing.assert_array_equal(plan.edge_of_camera == 0, start.edge_of_camera == 0)
    assert all(plan.edge_of_camera[camera] == 3 for camera in pins)
    reference = start.weights.copy()
    reference[1] += 300.0
    centre = (positions.min(axis=0) + positions.max(axis=0)) / 2
    cell = assign(positions - centre, start.sites - centre, reference) == 1
    cell &= start.edge_of_camera != 0
    cell[list(pins)] = False
    np.testing.assert_array_equal(plan.edge_of_camera == 1, cell)
    assert plan.makespan_s >= plan.lower_bound_s * (1 - 1e-12)
    assert plan.status in ("constrained", "optimal") and plan.certified == (plan.num_outside == 0)
    assert any("hold among the cameras" in sentence for sentence in plan.constrained)
    assert len(plan.constrained) == 4


@pytest.mark.parametrize("seed", range(8))
def test_counts_and_distance_of_the_rest_are_the_best_of_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    positions, system = LAYOUTS["uniform"](rng, 7), random_system(rng, 3)
    pins = {0: "e0", 1: "e0", 2: "e1"}
    plan = planned(positions, system, constraints=PlanConstraints(pinned=pins))
    tables = edge_tables(system, 7)
    cost = np.sum((positions[:, None] - plan.sites) ** 2, axis=-1)
    best: dict[tuple[int, ...], float] = {}
    for rest in product(range(3), repeat=4):
        owners = [0, 0, 1, *rest]
        counts = tuple(np.bincount(owners, minlength=3).tolist())
        best[counts] = min(best.get(counts, np.inf), float(cost[np.arange(7), owners].sum()))
    makespan_s = {counts: max(t.edge_time_s[n] for t, n in zip(tables, counts, strict=True)) for counts in best}
    assert plan.makespan_s == pytest.approx(min(makespan_s.values()), rel=1e-12)
    own = float(cost[np.arange(7), plan.edge_of_camera].sum())
    assert own == pytest.approx(best[tuple(plan.counts.tolist())], rel=1e-12)


def test_counts_at_least_are_the_fastest_of_all_that_keep_the_least() -> None:
    for seed in range(30):
        rng = np.random.default_rng(seed)
        system, least = random_system(rng, 3), rng.integers(0, 4, 3)
        found = counts_at_least(system, 10, least).counts
        assert found.sum() == 10 and (found >= least).all()
        tables = edge_tables(system, 10)
        times = [
            max(t.edge_time_s[n] for t, n in zip(tables, (a, b, 10 - a - b), strict=True))
            for a in range(least[0], 11)
            for b in range(least[1], 11 - a)
            if 10 - a - b >= least[2]
        ]
        assert max(t.edge_time_s[n] for t, n in zip(tables, found, strict=True)) == pytest.approx(min(times), rel=1e-12)


def test_a_weight_fixed_where_it_was_changes_nothing() -> None:
    rng = np.random.default_rng(0)
    positions, system = LAYOUTS["uniform"](rng, 200), random_system(rng, 6)
    start = planned(positions, system)
    plan = planned(positions, system, constraints=PlanConstraints(fixed_weights_m2={"e2": float(start.weights[2])}), start=start)
    np.testing.assert_array_equal(plan.edge_of_camera, start.edge_of_camera)
    assert plan.certified and plan.status == "optimal"
    assert plan.weights[2] == start.weights[2]


def test_what_memory_forbids_is_infeasible_with_its_reason() -> None:
    positions = np.stack([np.arange(6.0), np.zeros(6)], axis=1)
    system = linear_system(np.array([[0.0, 0.0], [5.0, 0.0]]), np.ones(2), max_cameras=3)
    start = planned(positions, system)
    for constraints, reason in (
        (PlanConstraints(pinned={0: "e0", 1: "e0", 2: "e0", 3: "e0"}), "gives? edge 'e0' 4 cameras, it can hold 3"),
        (PlanConstraints(fixed_weights_m2={"e1": -1e6}), "can hold 3 of the 6"),
        (PlanConstraints(fixed_weights_m2={"e1": -1e6}, locked=("e0",)), "all edges are locked or fixed and 3 cameras"),
    ):
        plan = plan_regions(positions, system, constraints=constraints, start=start)
        assert isinstance(plan, PlanInfeasible)
        with pytest.raises(AssertionError, match=reason):
            raise AssertionError(plan.reason)


def test_what_cannot_be_meant_is_refused() -> None:
    positions, system = np.arange(8.0).reshape(4, 2), linear_system(np.array([[0.0, 0.0], [5.0, 0.0]]), np.ones(2))
    start = planned(positions, system)
    for build, message in (
        (lambda: PlanConstraints(fixed_weights_m2={"e0": np.nan}), "fixed at nan"),
        (lambda: PlanConstraints(locked=("e0", "e0")), "locked twice"),
        (lambda: PlanConstraints(locked=("e0",), fixed_weights_m2={"e0": 1.0}), "locked and has a fixed weight"),
        (lambda: PlanConstraints(pinned={-1: "e0"}), "camera -1 is pinned"),
        (lambda: plan_regions(positions, system, constraints=PlanConstraints(locked=("e0",))), "none was given"),
        (lambda: plan_regions(positions[:3], system, constraints=PlanConstraints(locked=("e0",)), start=start), "one of 4 was given"),
        (lambda: plan_regions(positions, system, constraints=PlanConstraints(pinned={9: "e0"})), "camera 9 is pinned, there are 4"),
        (lambda: plan_regions(positions, system, constraints=PlanConstraints(pinned={0: "x"})), "edge 'x' is constrained"),
        (lambda: plan_regions(positions, system, constraints=PlanConstraints(pinned={0: "e0"}), slack=1.1), "slack and constraints"),
        (
            lambda: plan_regions(positions, system, constraints=PlanConstraints(locked=("e0",), pinned={0: "e1"}), start=start),
            "lies in the locked region of 'e0'",
        ),
    ):
        with pytest.raises(BadInput, match=message):
            build()


@pytest.mark.parametrize("seed", range(6))
def test_locked_where_nothing_changed_the_weights_still_prove_every_cell(seed: int) -> None:
    """The start itself has such weights; those found anew, edge by edge, are others and as good."""
    rng = np.random.default_rng(seed)
    positions, system = LAYOUTS["uniform"](rng, 200), random_system(rng, 6)
    start = planned(positions, system)
    for locked in (("e0",), ("e1", "e4")):
        plan = planned(positions, system, constraints=PlanConstraints(locked=locked), start=start)
        centre = (positions.min(axis=0) + positions.max(axis=0)) / 2
        cells = assign(positions - centre, plan.sites - centre, plan.weights)
        assert (cells != plan.edge_of_camera).sum() == plan.num_outside
        for name in locked:
            edge = int(name[1:])
            np.testing.assert_array_equal(plan.edge_of_camera == edge, start.edge_of_camera == edge)
        if (plan.edge_of_camera == start.edge_of_camera).all():
            assert plan.num_outside == 0 and plan.certified, locked


def in_a_row(speeds: list[float], count: int = 60) -> tuple[np.ndarray, System]:
    """Cameras on a line and three edges along it: whatever intervals the edges have, there are
    weights that prove them."""
    positions = np.stack([np.linspace(0.0, 590.0, count), np.zeros(count)], axis=1)
    return positions, linear_system(np.array([[95.0, 0.0], [295.0, 0.0], [495.0, 0.0]]), np.array(speeds))


@pytest.mark.parametrize("edge", range(3))
@pytest.mark.parametrize("raise_m2", [-4000.0, 4000.0])
def test_free_regions_are_shifted_to_where_they_fit_beside_fixed_ones(edge: int, raise_m2: float) -> None:
    positions, system = in_a_row([1.0, 1.0, 1.0])
    start = planned(positions, system)
    fixed = float(start.weights[edge]) + raise_m2
    plan = planned(positions, system, constraints=PlanConstraints(fixed_weights_m2={f"e{edge}": fixed}), start=start)
    assert plan.counts[edge] != 20 and (np.diff(plan.edge_of_camera) >= 0).all()
    others = [other for other in range(3) if other != edge]
    assert np.ptp(plan.counts[others]) <= 1 and plan.num_outside == 0 and plan.certified and plan.weights[edge] == fixed
    if edge != 1:
        # Midway: as far from the last camera on one side as from the first on the other, up to a
        # quarter of their spacing.
        squared = (positions[:, :1] - [95.0, 295.0, 495.0]) ** 2 - plan.weights
        free_border = np.flatnonzero(np.diff(plan.edge_of_camera))[0 if edge == 2 else 1]
        here, there = plan.edge_of_camera[free_border : free_border + 2]
        slack = [squared[free_border, there] - squared[free_border, here], squared[free_border + 1, here] - squared[free_border + 1, there]]
        assert min(slack) > 0


@pytest.mark.parametrize("edge", range(3))
def test_locked_regions_fit_between_those_planned_anew(edge: int) -> None:
    positions, system = in_a_row([1.0, 1.0, 1.0])
    start = planned(positions, system)
    _, other = in_a_row([1.0, 2.0, 4.0])
    plan = planned(positions, other, constraints=PlanConstraints(locked=(f"e{edge}",)), start=start)
    np.testing.assert_array_equal(plan.edge_of_camera == edge, start.edge_of_camera == edge)
    rest = [index for index in range(3) if index != edge]
    assert plan.counts[rest[0]] == pytest.approx(40 * [2 / 3, 0.8, 2 / 3][edge], abs=1)
    if edge != 1:
        assert plan.num_outside == 0 and plan.certified
    two = planned(positions, other, constraints=PlanConstraints(locked=("e0", "e2")), start=start)
    np.testing.assert_array_equal(two.edge_of_camera, start.edge_of_camera)
    assert two.num_outside == 0 and two.certified


def test_an_edge_with_pinned_cameras_alone_takes_no_free_one_away() -> None:
    positions, system = in_a_row([1.0, 50.0, 1.0])
    plan = planned(positions, system, constraints=PlanConstraints(pinned={29: "e1", 30: "e1"}))
    assert plan.counts.tolist() == [29, 2, 29] and (plan.edge_of_camera[[29, 30]] == 1).all()
    assert plan.num_outside == 0 and plan.certified


def test_what_was_decided_is_told_in_words() -> None:
    positions, system = in_a_row([1.0, 1.0, 1.0])
    start = planned(positions, system)
    decided = PlanConstraints(fixed_weights_m2={"e2": float(start.weights[2])}, locked=("e0",), pinned={25: "e1"})
    told = planned(positions, system, constraints=decided, start=start).constrained
    assert told == (
        f"weight of edge 'e2' fixed at {start.weights[2]:g} m²: 20 cameras",
        "region of edge 'e0' locked: 20 cameras",
        "cameras pinned: 1",
        "the certificate's conditions hold among the cameras and edges that are free",
    )
    assert not PlanConstraints() and all((decided, PlanConstraints(pinned={0: "e0"}), PlanConstraints(locked=("e0",))))


@pytest.mark.parametrize(
    ("fields", "told"),
    [
        ({"fixed_weights_m2": {"e0": 1.1e17}}, r"edge 'e0' is fixed at 1.1e\+17 m², expected a finite number up to 1e\+17"),
        ({"fixed_weights_m2": {"e0": -np.inf}}, "fixed at -inf"),
        ({"locked": ("e0", "e1", "e0")}, "locked twice among e0, e1, e0: name each edge once"),
        ({"pinned": {0.5: "e0"}}, "camera 0.5 is pinned, expected an index of at least 0"),
        ({"pinned": {True: "e0"}}, "camera True is pinned"),
        ({"fixed_weights_m2": {"e0": 1e17, "e1": -1e17}, "locked": ("e2",), "pinned": {0: "e0"}}, None),
    ],
)
def test_limits_of_what_may_be_decided(fields: dict, told: str | None) -> None:
    if told is None:
        assert PlanConstraints(**fields)
    else:
        with pytest.raises(BadInput, match=told):
            PlanConstraints(**fields)


def test_times_of_given_and_free_edges_are_their_own() -> None:
    positions, system = in_a_row([1.0, 2.0, 4.0])
    plan = planned(positions, system, constraints=PlanConstraints(pinned=dict.fromkeys(range(30), "e0")))
    np.testing.assert_allclose(plan.edge_time_s, plan.counts * [1.0, 2.0, 4.0])
    assert (plan.counts.tolist() == [34, 17, 9] and plan.status == "constrained") or plan.status == "optimal"
    found = counts_at_least(system, 60, np.array([5, 30, 0]))
    assert found.counts.tolist() == [24, 30, 6] and found.edge_time_s.tolist() == [24.0, 60.0, 24.0]
