"""The planner as a whole: optimal, certified, a partition, precise about what is impossible."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import get_args

import numpy as np
import pytest

from radiant_core.choices import PlanMethod
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.plan.counts.deadline import device_time_s, edge_tables
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.devices.even_shares import even_edge_counts, even_quotas
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.regions import region_plan
from radiant_core.plan.regions.constraints import PlanConstraints
from radiant_core.plan.regions.paper_config import PaperConfig
from radiant_core.plan.regions.power_diagram import assign, polygon_area_m2
from radiant_core.plan.regions.region_plan import (
    MARGIN,
    PlanInfeasible,
    _largest_m2,
    _plane,
    is_certified,
    num_cameras_outside,
    plan_regions,
    regions_around,
    regions_with_counts,
)
from radiant_core.plan.system import Edge, System
from tests.seeds import for_seeds

from .instances import LAYOUTS, linear_system, random_system

METHODS = get_args(PlanMethod)
NEAREST = 1e12
"""A tolerance within which every camera stays at its nearest edge, where that can hold it."""


def planned(positions: FloatArray, system: System, method: PlanMethod = "exact") -> CloudPlan:
    plan = plan_regions(positions, system, method=method)
    assert isinstance(plan, CloudPlan)
    return plan


def squared_distance_sum(plan: CloudPlan, positions: FloatArray) -> float:
    return float(np.sum((positions - plan.sites[plan.edge_of_camera]) ** 2))


def outline_area_m2(positions: FloatArray) -> float:
    width, height = np.ptp(positions, axis=0)
    margin = 2 * MARGIN * (max(width, height) or 1.0)
    return (width + margin) * (height + margin)


@pytest.mark.parametrize("layout", LAYOUTS)
@for_seeds(25)
def test_exact_reaches_the_bound_with_a_certificate(layout: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    num_cameras, num_edges = int(rng.integers(1, 150)), int(rng.integers(1, 10))
    system = random_system(rng, num_edges, limits=(num_cameras, 2 * num_cameras) if seed % 2 else None)
    plan = planned(LAYOUTS[layout](rng, num_cameras), system)
    assert plan.makespan_s == plan.lower_bound_s
    assert plan.certified
    assert plan.status == "optimal"


@for_seeds(100)
def test_no_assignment_at_all_is_faster_or_of_these_counts_nearer(seed: int) -> None:
    rng = np.random.default_rng(seed)
    num_cameras, num_edges = int(rng.integers(1, 7)), int(rng.integers(1, 4))
    positions = LAYOUTS[list(LAYOUTS)[seed % len(LAYOUTS)]](rng, num_cameras)
    system = random_system(rng, num_edges)
    plan = planned(positions, system)
    assignments = np.array(list(product(range(num_edges), repeat=num_cameras)))
    counts = np.stack([(assignments == edge).sum(axis=1) for edge in range(num_edges)], axis=1)
    times_s = np.stack([t.edge_time_s[counts[:, m]] for m, t in enumerate(edge_tables(system, num_cameras))], axis=1)
    assert plan.makespan_s == times_s.max(axis=1).min()
    same = assignments[(counts == plan.counts).all(axis=1)]
    nearest = np.sum((positions - plan.sites[same]) ** 2, axis=(1, 2)).min()
    # m², the same sum reordered.
    assert squared_distance_sum(plan, positions) == pytest.approx(nearest, rel=1e-12, abs=1e-9)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_regions_partition_the_scene_and_belong_to_edges_with_cameras(layout: str, method: PlanMethod) -> None:
    rng = np.random.default_rng(5)
    positions = LAYOUTS[layout](rng, 80)
    plan = planned(positions, random_system(rng, 6), method)
    areas_m2 = np.array([polygon_area_m2(border) for border in plan.borders])
    assert areas_m2.sum() == pytest.approx(outline_area_m2(positions), rel=1e-9)
    assert (areas_m2[plan.counts == 0] == 0).all()
    assert plan.counts.sum() == 80
    assert plan.certified or method == "paper-literal", "its regions are no power cells"
    assert plan.certified == (plan.num_outside == 0)


def sending_alike(system: System) -> System:
    """The same with models whose bytes go by their cameras: shares that send fewer bytes by chance
    are not looked for by the bound."""

    def alike(edge: Edge) -> Edge:
        return replace(edge, devices=tuple(replace(device, model_bytes=CostCurve(linear=1e6)) for device in edge.devices))

    return System(edges=tuple(alike(edge) for edge in system.edges))


@pytest.mark.parametrize("method", METHODS)
@for_seeds(15)
def test_no_method_beats_the_bound_and_times_follow_from_the_counts(seed: int, method: PlanMethod) -> None:
    rng = np.random.default_rng(seed)
    system = random_system(rng, 5)
    if method == "even":
        system = sending_alike(system)
    plan = planned(LAYOUTS["clustered"](rng, 120), system, method)
    assert plan.makespan_s >= plan.lower_bound_s
    expected_s = [table.edge_time_s[count] for table, count in zip(edge_tables(system, 120), plan.counts, strict=True)]
    if method == "even":
        # Its devices do not share an edge's cameras so that the slowest is done first.
        assert (plan.edge_time_s >= np.array(expected_s) * (1 - 1e-12)).all()
    else:
        np.testing.assert_array_equal(plan.edge_time_s, expected_s)
    assert (plan.status == "optimal") == (plan.makespan_s == plan.lower_bound_s)


@for_seeds(15)
def test_moving_borders_never_ends_slower_than_it_started(seed: int) -> None:
    rng = np.random.default_rng(seed)
    system, positions = random_system(rng, 4), LAYOUTS["uniform"](rng, 200)
    exact, paper = (planned(positions, system, method) for method in ("exact", "paper"))
    nearest = plan_regions(positions, system, tolerance=NEAREST)
    assert isinstance(nearest, CloudPlan)
    assert exact.makespan_s <= paper.makespan_s <= nearest.makespan_s
    assert paper.history[0] == nearest.makespan_s


@pytest.mark.parametrize("seed", range(8))
def test_even_gives_every_device_as_many_cameras_give_or_take_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    positions, system = LAYOUTS["clustered"](rng, 103), random_system(rng, 5)
    plan = planned(positions, system, "even")
    num_devices = [len(edge.devices) for edge in system.edges]
    assert min(num_devices) < max(num_devices), "an edge's share goes by its devices"
    edges = split_edges(positions, plan, system)
    shares = [len(own.cameras_of(device)) for own in edges for device in own.device_ids]
    assert sorted({103 // len(shares), -(-103 // len(shares))}) == sorted(set(shares))
    for own, edge, edge_time_s in zip(edges, system.edges, plan.edge_time_s, strict=True):
        times_s = [float(device_time_s(device, len(own.cameras_of(device.id)))) for device in edge.devices]
        np.testing.assert_array_equal(own.device_time_s, times_s)
        sent_s = sum(float(device.model_bytes(len(own.cameras_of(device.id)))) for device in edge.devices) / edge.uplink_bytes_per_s
        assert edge_time_s == pytest.approx(max(times_s) + float(edge.aggregate_s(len(own.camera_indices))) + sent_s, rel=1e-12)


def test_even_is_what_the_paper_divides_equally_for_each_device() -> None:
    # Three devices here and one there: 30 and 10 of 40 cameras, where 20 and 20 would be even by
    # edge.
    edges = linear_system(np.array([[0.0, 0.0], [100.0, 0.0]]), np.array([1.0, 1.0])).edges
    slow = replace(edges[0].devices[0], id="slow", train_s=CostCurve(linear=4.0))
    system = System(edges=(replace(edges[0], devices=(edges[0].devices[0], slow, replace(slow, id="slow-2"))), edges[1]))
    positions = np.column_stack([np.linspace(0, 100, 40), np.zeros(40)])
    plan = planned(positions, system, "even")
    assert plan.counts.tolist() == [30, 10]
    # The slow ones decide: ten cameras of 4 s each. By quotas that fit, 30 cameras would take 20 s
    # there.
    assert plan.edge_time_s.tolist() == [40.0, 10.0] and plan.makespan_s > 1.9 * plan.lower_bound_s
    assert [own.device_time_s.tolist() for own in split_edges(positions, plan, system)] == [[10.0, 40.0, 40.0], [10.0]]
    with pytest.raises(BadInput, match="the devices can hold 2 of 3 cameras"):
        even_quotas(replace(edges[0], devices=(replace(slow, max_cameras=2),)), 3)


@for_seeds(10)
def test_stored_sites_and_weights_give_each_camera_its_edge(seed: int) -> None:
    rng = np.random.default_rng(seed)
    utm_m = np.array([500_000.0, 9_999_000.0])
    positions = LAYOUTS["uniform"](rng, 300) + utm_m
    plan = planned(positions, linear_system(rng.random((7, 2)) * 300.0 + utm_m, rng.uniform(1, 4, 7)))
    np.testing.assert_array_equal(assign(positions, plan.sites, plan.weights), plan.edge_of_camera)


@pytest.mark.parametrize("shift_m", [(1e6, 0.0), (500_000.0, 9_999_000.0), (-1e7, 1e7)])
def test_the_plan_does_not_depend_on_the_origin(shift_m: tuple[float, float]) -> None:
    rng = np.random.default_rng(2)
    # Multiples of 1/1024 m, so that the shifted scene is the same scene and not one rounded to
    # other places.
    positions, sites = rng.integers(0, 1 << 19, (300, 2)) / 1024, rng.integers(0, 1 << 19, (5, 2)) / 1024
    speeds = rng.uniform(1, 3, 5)
    here = planned(positions, linear_system(sites, speeds))
    there = planned(positions + shift_m, linear_system(sites + shift_m, speeds))
    np.testing.assert_array_equal(there.edge_of_camera, here.edge_of_camera)
    for moved, border in zip(there.borders, here.borders, strict=True):
        # In metres; 1e7 m in float64 has steps of 2e-9.
        np.testing.assert_allclose(moved - shift_m, border, atol=1e-6)


def test_the_order_of_cameras_and_edges_does_not_matter() -> None:
    rng = np.random.default_rng(3)
    positions, system = LAYOUTS["uniform"](rng, 250), random_system(rng, 6)
    cameras, edges = rng.permutation(250), rng.permutation(6)
    plan = planned(positions, system)
    shuffled = planned(positions[cameras], System(edges=tuple(system.edges[index] for index in edges)))
    np.testing.assert_array_equal(edges[shuffled.edge_of_camera], plan.edge_of_camera[cameras])
    assert shuffled.makespan_s == plan.makespan_s


def test_edges_at_one_spot_get_borders_between_them() -> None:
    rng = np.random.default_rng(4)
    positions = LAYOUTS["uniform"](rng, 90)
    plan = planned(positions, linear_system(np.full((3, 2), 120.0), np.ones(3)))
    assert plan.counts.tolist() == [30, 30, 30]
    assert all(len(border) for border in plan.borders)
    np.testing.assert_array_equal(assign(positions, plan.sites, plan.weights), plan.edge_of_camera)


def test_edges_a_thousand_kilometres_away_still_share_the_scene() -> None:
    rng = np.random.default_rng(5)
    positions = LAYOUTS["uniform"](rng, 100)
    plan = planned(positions, linear_system(np.array([[1e6, 0.0], [0.0, 1e6], [1e6, 1e6]]), np.array([1.0, 1.0, 2.0])))
    assert plan.counts.tolist() == [40, 40, 20]
    assert plan.status == "optimal"


def test_more_edges_than_cameras_leaves_the_others_without_land() -> None:
    rng = np.random.default_rng(6)
    plan = planned(LAYOUTS["uniform"](rng, 3), linear_system(rng.random((9, 2)) * 200.0, np.ones(9)))
    assert sorted(plan.counts) == [0] * 6 + [1] * 3
    assert [len(border) > 0 for border in plan.borders] == (plan.counts == 1).tolist()


@pytest.mark.parametrize("method", METHODS)
def test_one_camera_and_one_edge_make_a_plan(method: PlanMethod) -> None:
    plan = planned(np.array([[3.0, 4.0]]), linear_system(np.array([[0.0, 0.0]]), np.array([2.0])), method)
    assert plan.makespan_s == 2.0
    assert polygon_area_m2(plan.borders[0]) > 0


def test_memory_that_just_suffices_is_filled_to_the_last_camera() -> None:
    rng = np.random.default_rng(7)
    plan = planned(LAYOUTS["clustered"](rng, 60), linear_system(rng.random((4, 2)) * 500.0, np.array([1.0, 1.0, 1.0, 9.0]), 15))
    assert plan.counts.tolist() == [15, 15, 15, 15]
    assert plan.status == "optimal"


@pytest.mark.parametrize("method", METHODS)
def test_too_little_memory_is_a_result_that_names_the_capacity(method: PlanMethod) -> None:
    result = plan_regions(np.random.default_rng(8).random((61, 2)), linear_system(np.eye(2), np.ones(2), 30), method=method)
    assert isinstance(result, PlanInfeasible)
    assert (result.status, result.capacity, result.num_cameras) == ("infeasible", 60, 61)
    assert "60 of 61 cameras" in result.reason


def test_edges_that_overflow_are_a_result_that_names_the_edge() -> None:
    # Alg. 1 stops before its first move: every camera is at the nearest edge, far from the other.
    positions, paper = np.random.default_rng(9).random((50, 2)), PaperConfig(threshold=100.0)
    system = linear_system(np.array([[0.5, 0.5], [90.0, 0.5]]), np.ones(2), 30)
    result = plan_regions(positions, system, method="paper-literal", paper=paper)
    assert isinstance(result, PlanInfeasible)
    assert "'e0' 50 cameras" in result.reason


def test_moving_borders_prefers_what_fits_into_memory() -> None:
    positions = np.random.default_rng(10).random((50, 2)) * 100.0
    plan = planned(positions, linear_system(np.array([[30.0, 50.0], [95.0, 50.0]]), np.ones(2), 30), "paper")
    assert plan.counts.max() <= 30


def test_moving_borders_does_not_leave_what_fits_for_what_looks_faster() -> None:
    # The first edge is ten times faster but can hold 10: every move towards balance overfills it,
    # so the start must be kept.
    positions = np.stack([np.linspace(0.0, 100.0, 50), np.zeros(50)], axis=1)
    fast, slow = linear_system(np.array([[5.0, 0.0], [25.0, 0.0]]), np.array([1.0, 10.0]), 10).edges
    roomy = replace(slow, devices=(replace(slow.devices[0], max_cameras=None),))
    plan = planned(positions, System(edges=(fast, roomy)), "paper")
    assert plan.counts[0] <= 10
    assert min(plan.history) < plan.makespan_s


@pytest.mark.parametrize(
    ("positions", "message"),
    [
        (np.empty((0, 2)), "no camera"),
        (np.array([[np.nan, 0.0]]), "not finite"),
        (np.array([[0.0, np.inf]]), "not finite"),
        (np.zeros((4, 3)), "shape"),
        (np.array([[1e9, 0.0]]), "at most 1e\\+08 m"),
    ],
)
def test_poisoned_positions_are_refused(positions: FloatArray, message: str) -> None:
    with pytest.raises(BadInput, match=message):
        plan_regions(positions, linear_system(np.eye(2), np.ones(2)))


def test_denormal_distances_end_in_a_plan() -> None:
    positions = np.random.default_rng(11).random((20, 2)) * 1e-300
    assert planned(positions, linear_system(np.eye(2), np.ones(2))).counts.tolist() == [10, 10]


def test_an_edge_without_position_is_refused() -> None:
    system = linear_system(np.eye(2), np.ones(2))
    unplaced = System(edges=(system.edges[0], replace(system.edges[1], position=None)))
    with pytest.raises(BadInput, match="edge 'e1' has no position"):
        plan_regions(np.zeros((3, 2)), unplaced)


def test_an_unknown_method_is_refused() -> None:
    with pytest.raises(BadInput, match="use one of exact, paper, paper-literal, even"):
        plan_regions(np.zeros((3, 2)), linear_system(np.eye(2), np.ones(2)), method="magic")  # pyright: ignore[reportArgumentType]


def test_a_tolerance_leaves_nearest_edges_alone_where_they_are_good_enough() -> None:
    rng = np.random.default_rng(12)
    positions, system = LAYOUTS["uniform"](rng, 400), linear_system(np.array([[120.0, 125.0], [380.0, 125.0]]), np.array([1.0, 1.0]))
    nearest = plan_regions(positions, system, tolerance=NEAREST)
    assert isinstance(nearest, CloudPlan)
    over = nearest.makespan_s / nearest.lower_bound_s - 1
    assert over > 0
    kept = plan_regions(positions, system, tolerance=2 * over)
    balanced = plan_regions(positions, system, tolerance=0.5 * over)
    assert isinstance(kept, CloudPlan)
    assert isinstance(balanced, CloudPlan)
    np.testing.assert_array_equal(kept.edge_of_camera, nearest.edge_of_camera)
    assert balanced.makespan_s == balanced.lower_bound_s
    full = linear_system(np.array([[120.0, 125.0], [1200.0, 125.0]]), np.array([1.0, 1.0]), 250)
    assert planned(positions, full).counts.max() <= 250
    with pytest.raises(BadInput, match="tolerance"):
        plan_regions(positions, system, tolerance=-0.1)


@for_seeds(60)
def test_even_counts_are_the_most_equal_that_capacities_allow(seed: int) -> None:
    """Water-filling by one camera at a time: always to the device that has least and still has
    room, of equals the first of its edge."""
    rng = np.random.default_rng(seed)
    num_devices = rng.integers(1, 4, int(rng.integers(1, 6)))
    capacities = rng.integers(0, 9, num_devices.sum())
    total = int(rng.integers(0, capacities.sum() + 1))
    bare = linear_system(rng.random((len(capacities), 2)), np.ones(len(capacities))).edges
    devices = [replace(edge.devices[0], max_cameras=int(held)) for edge, held in zip(bare, capacities, strict=True)]
    owner = np.repeat(np.arange(len(num_devices)), num_devices)
    place = np.concatenate([np.arange(number) for number in num_devices])
    edges = [replace(bare[e], devices=tuple(d for d, own in zip(devices, owner, strict=True) if own == e)) for e in range(len(num_devices))]
    counts = [0] * len(capacities)
    for _ in range(total):
        open_devices = [index for index in range(len(counts)) if counts[index] < capacities[index]]
        counts[min(open_devices, key=lambda index: (counts[index], place[index], index))] += 1
    by_edge = np.bincount(owner, weights=counts).astype(int)
    assert even_edge_counts(System(edges=tuple(edges)), total).tolist() == by_edge.tolist()
    for index, edge in enumerate(edges):
        assert even_quotas(edge, by_edge[index]).tolist() == [count for count, own in zip(counts, owner, strict=True) if own == index]


def test_the_outline_is_the_cameras_box_with_a_tenth_of_its_longer_side() -> None:
    positions = np.array([[100.0, 50.0], [300.0, 70.0], [200.0, 90.0]])
    plane = _plane(positions, linear_system(np.array([[150.0, 60.0], [250.0, 80.0]]), np.ones(2)))
    np.testing.assert_array_equal(plane.centre, [200, 70])
    np.testing.assert_allclose(plane.box, [[-100, -20], [100, -20], [100, 20], [-100, 20]])
    np.testing.assert_allclose(plane.outline, [[-120, -40], [120, -40], [120, 40], [-120, 40]])
    np.testing.assert_allclose(plane.sites, [[-50, -10], [50, 10]])
    assert plane.side_m == 200
    assert _largest_m2(plane) == pytest.approx(max(np.sum((site - corner) ** 2) for site in plane.sites for corner in plane.box))
    assert _plane(np.full((4, 2), 7.0), linear_system(np.eye(1, 2), np.ones(1))).side_m == 1


@pytest.mark.parametrize(("coordinate", "fits"), [(1e8, True), (1.0001e8, False)])
def test_coordinates_end_at_a_hundred_thousand_kilometres(coordinate: float, fits: bool) -> None:
    for positions, sites in (
        (np.array([[coordinate, 0.0], [coordinate - 50, 9.0]]), np.eye(2)),
        (np.eye(2), np.array([[0.0, -coordinate], [1, 1]])),
    ):
        if fits:
            assert isinstance(plan_regions(positions, linear_system(sites, np.ones(2))), CloudPlan)
        else:
            with pytest.raises(BadInput, match=r"a camera or edge is 1e\+08 m from the origin, expected at most 1e\+08 m"):
                plan_regions(positions, linear_system(sites, np.ones(2)))


def test_cameras_outside_their_cell_are_counted_whatever_the_block(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    cameras, sites, weights = rng.random((50, 2)) * 100, rng.random((4, 2)) * 100, rng.random(4) * 100
    power = np.sum((cameras[:, None] - sites) ** 2, axis=2) - weights
    owner = power.argmin(axis=1)
    assert is_certified(cameras, sites, weights, owner)
    wrong = owner.copy()
    wrong[:7] = (owner[:7] + 1) % 4
    for pairs in (1, 12, 200, 500_000):
        monkeypatch.setattr(region_plan, "_BLOCK_PAIRS", pairs)
        assert num_cameras_outside(cameras, sites, weights, wrong) == 7 and num_cameras_outside(cameras, sites, weights, owner) == 0
        assert not is_certified(cameras, sites, weights, wrong)


@pytest.mark.parametrize(("off", "outside"), [(0.5, 0), (2.0, 1)])
def test_a_camera_may_miss_its_cell_by_a_trillionth_of_the_largest_distance(off: float, outside: int) -> None:
    """The camera in the middle belongs to the right edge; a weight makes it miss by so many
    trillionths of the largest square."""
    sites, cameras = np.array([[-1.0, 0.0], [1.0, 0.0]]), np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0]])
    assert num_cameras_outside(cameras, sites, np.array([4e-12 * off, 0.0]), np.array([1, 1, 0])) == outside


def test_regions_of_given_owners_are_nearest_means_or_as_large_as_what_they_own() -> None:
    positions = np.stack([np.arange(10.0), np.zeros(10)], axis=1)
    owners = np.array([0] * 3 + [1] * 7)
    system = linear_system(np.array([[99.0, 9.0], [-99.0, 9.0], [0.0, 5.0]]), np.ones(3))
    around = regions_around(positions, owners, system)
    np.testing.assert_allclose(around.sites, [[1, 0], [6, 0], [4.5, 0]])
    assert (around.method, around.status, around.certified, around.lower_bound_s) == ("captured", "stopped", False, 4.0)
    assert len(around.borders[2]) == 0 and not around.edge_time_s.any() and around.edge_time_s.shape == (3,)
    xs = np.concatenate(around.borders)[:, 0]
    assert around.borders[0][:, 0].max() == pytest.approx(3.5) and (xs.min(), xs.max()) == pytest.approx((-0.9, 9.9))
    tight = regions_around(positions, owners, linear_system(np.eye(3, 2), np.ones(3), 3))
    assert tight.lower_bound_s == 0.0, "nine of ten cameras fit"
    counted = regions_with_counts(positions, owners, system)
    assert 2.0 < counted.borders[0][:, 0].max() < 3.0
    assert (counted.method, counted.status, counted.certified, counted.lower_bound_s) == ("captured", "stopped", False, 0.0)
    np.testing.assert_array_equal(counted.edge_of_camera, owners)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"tolerance": -0.1}, r"tolerance is -0\.1, expected a finite share of at least 0"),
        ({"tolerance": np.inf}, "tolerance is inf"),
        ({"slack": 0.99}, r"slack is 0\.99, expected a finite factor of at least 1"),
        ({"slack": np.inf}, "slack is inf"),
        ({"slack": 1.0, "tolerance": 0.1}, "tolerance and slack are given together: choose one of them"),
        ({"slack": 1.0, "method": "even"}, "slack is for method exact, the method is even: leave one of them out"),
        ({"tolerance": 0.1, "method": "paper"}, "tolerance is for method exact, the method is paper"),
        ({"method": "best"}, "plan method 'best' is unknown: use one of exact, paper, paper-literal, even"),
        ({"slack": 1.0}, None),
        ({"tolerance": 0.0, "method": "even"}, None),
    ],
)
def test_options_that_exclude_each_other_are_told(options: dict, told: str | None) -> None:
    positions, system = np.eye(4, 2) * 9, linear_system(np.array([[0.0, 0.0], [9.0, 9.0]]), np.ones(2))
    if told is None:
        assert isinstance(plan_regions(positions, system, **options), CloudPlan)
    else:
        with pytest.raises(BadInput, match=told):
            plan_regions(positions, system, **options)


def test_statuses_follow_the_bound_and_the_threshold() -> None:
    """A hundred cameras on a line: the middle border is the best, another within 5 % or beyond."""
    positions = np.stack([np.arange(100.0), np.zeros(100)], axis=1)
    for shift, status in ((0.0, "optimal"), (2.0, "converged"), (3.0, "stopped")):
        system = linear_system(np.array([[24.5 + shift, 0.0], [74.5 + shift, 0.0]]), np.ones(2))
        plan = plan_regions(positions, system, tolerance=NEAREST)
        assert isinstance(plan, CloudPlan) and plan.status == status and plan.lower_bound_s == 50 and plan.certified
        within = plan_regions(positions, system, tolerance=0.05)
        assert isinstance(within, CloudPlan)
        assert within.counts[0] == (50 if status in ("optimal", "stopped") else plan.counts[0]) and within.num_outside == 0
    wide = plan_regions(positions, linear_system(np.array([[20.0, 0.0], [60.0, 0.0]]), np.ones(2)), slack=1.1)
    assert isinstance(wide, CloudPlan) and (wide.status, wide.slack, wide.counts.tolist()) == ("slack", 1.1, [45, 55])


def test_a_fixed_slack_of_one_and_memory_that_forbids_a_method_are_said() -> None:
    positions = np.stack([np.arange(10.0), np.zeros(10)], axis=1)
    system = linear_system(np.array([[0.0, 0.0], [2.0, 0.0]]), np.ones(2), 6)
    found = plan_regions(positions, system, method="paper-literal", paper=PaperConfig(threshold=100.0))
    assert isinstance(found, PlanInfeasible) and (found.capacity, found.num_cameras, found.status) == (12, 10, "infeasible")
    assert found.reason == "method paper-literal gives edge 'e1' 8 cameras, it can hold 6: use method exact."
    few = plan_regions(positions, linear_system(np.eye(2), np.ones(2), 4))
    assert isinstance(few, PlanInfeasible)
    assert few.reason == "the devices can hold 8 of 10 cameras: raise max_cameras or add devices." and few.capacity == 8
    start, three = planned(positions, linear_system(np.eye(2), np.ones(2))), linear_system(np.eye(3, 2), np.ones(3))
    with pytest.raises(BadInput, match="the plan to start from has edges e0, e1, the system others: give one of this system"):
        plan_regions(positions, three, start=start, constraints=PlanConstraints(pinned={0: "e0"}))


def test_nearest_edges_that_are_filled_exactly_are_left_alone_within_the_tolerance() -> None:
    positions = np.array([[0.0, 0.0], [1.0, 3.0], [9.0, 1.0], [8.0, 2.0]])
    sites = np.array([[0.0, 0.0], [9.0, 0.0]])
    for most, alone in ((2, True), (3, True)):
        plan = plan_regions(positions, linear_system(sites, np.ones(2), most), tolerance=0.1)
        assert isinstance(plan, CloudPlan) and plan.counts.tolist() == [2, 2] and (not plan.weights.any()) is alone
    crowded = plan_regions(np.vstack([positions, [[2.0, 2.0], [3.0, 1.0]]]), linear_system(sites, np.ones(2), 3), tolerance=9.0)
    assert isinstance(crowded, CloudPlan) and crowded.counts.tolist() == [3, 3] and crowded.weights.any()
