"""Plans after capture: the same photographs give the same plan, others change counts and times."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.plan.counts.deadline import device_time_s
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_core.plan.revision.captured import find_captured_elsewhere, nearest_planned, plan_captured
from radiant_core.plan.system import System
from tests.core.plan.instances import linear_system, random_system

Planned = tuple[CloudPlan, tuple[EdgePlan, ...]]


def planned(positions: np.ndarray, system: System) -> Planned:
    cloud = plan_regions(positions, system)
    assert isinstance(cloud, CloudPlan)
    return cloud, split_edges(positions, cloud, system)


def site(count: int, seed: int = 0) -> tuple[np.ndarray, System]:
    rng = np.random.default_rng(seed)
    return rng.random((count, 2)) * [500.0, 250.0], random_system(rng, 4)


@pytest.mark.parametrize("count", [1, 17, 1600])
def test_when_every_waypoint_was_captured_the_plan_is_the_same(count: int) -> None:
    positions, system = site(count)
    cloud, edges = planned(positions, system)
    shuffle = np.random.default_rng(1).permutation(count)
    new_cloud, new_edges = plan_captured(cloud, edges, positions, positions[shuffle], system=system)
    np.testing.assert_array_equal(new_cloud.edge_of_camera, cloud.edge_of_camera[shuffle])
    # The planner sums a curve's increments, this adds its value once: last digits differ.
    np.testing.assert_allclose(new_cloud.edge_time_s, cloud.edge_time_s, rtol=1e-9)
    assert new_cloud.status == cloud.status == "optimal"
    assert new_cloud.lower_bound_s == cloud.lower_bound_s
    for old, new in zip(edges, new_edges, strict=True):
        np.testing.assert_array_equal(new.device_time_s, old.device_time_s)
        for device in old.device_ids:
            assert sorted(shuffle[new.cameras_of(device)]) == sorted(old.cameras_of(device))


@pytest.mark.parametrize("seed", range(6))
def test_every_photograph_is_with_the_device_of_the_nearest_waypoint(seed: int) -> None:
    positions, system = site(300, seed)
    cloud, edges = planned(positions, system)
    captured = positions[np.random.default_rng(seed).integers(0, 300, 411)] + np.random.default_rng(seed).normal(size=(411, 2)) * 5
    new_cloud, new_edges = plan_captured(cloud, edges, positions, captured, system=system)
    owner = {int(camera): device for plan in edges for device in plan.device_ids for camera in plan.cameras_of(device)}
    nearest = np.sum((captured[:, None] - positions) ** 2, axis=-1).argmin(axis=1)
    for plan in new_edges:
        for device in plan.device_ids:
            assert plan.cameras_of(device).tolist() == [index for index in range(411) if owner[int(nearest[index])] == device]
    assert new_cloud.counts.tolist() == [len(plan.camera_indices) for plan in new_edges]
    assert new_cloud.makespan_s >= new_cloud.lower_bound_s * (1 - 1e-9)
    assert new_cloud.history == (new_cloud.makespan_s,)
    for old, new in zip(cloud.borders, new_cloud.borders, strict=True):
        np.testing.assert_array_equal(old, new)


def test_times_are_those_of_the_captured_counts_by_the_papers_formula() -> None:
    positions, system = site(200, 3)
    captured = positions[positions[:, 0] < 260]
    _, new_edges = result = plan_captured(*planned(positions, system), positions, captured, system=system)
    for index, (edge, plan) in enumerate(zip(system.edges, new_edges, strict=True)):
        counts = [len(plan.cameras_of(device.id)) for device in edge.devices]
        slowest_s = max(float(device_time_s(device, count)) for device, count in zip(edge.devices, counts, strict=True))
        sent_s = sum(float(device.model_bytes(count)) for device, count in zip(edge.devices, counts, strict=True)) / edge.uplink_bytes_per_s
        expected_s = slowest_s + float(edge.aggregate_s(sum(counts))) + sent_s
        assert result[0].edge_time_s[index] == pytest.approx(expected_s, rel=1e-12)


def test_a_device_that_captured_nothing_stays_with_none() -> None:
    positions, system = site(120, 4)
    cloud, edges = planned(positions, system)
    lost = edges[0].device_ids[0]
    keep = np.setdiff1d(np.arange(120), edges[0].cameras_of(lost))
    assert len(keep) < 120
    _, new_edges = plan_captured(cloud, edges, positions, positions[keep], system=system)
    assert len(new_edges[0].cameras_of(lost)) == 0
    assert new_edges[0].device_time_s[0] == 0
    np.testing.assert_array_equal(new_edges[0].strips[0], edges[0].strips[0])
    assert sum(len(plan.camera_indices) for plan in new_edges) == len(keep)


def test_one_photograph_of_a_whole_site_is_a_plan_too() -> None:
    positions, system = site(50, 5)
    cloud, edges = plan_captured(*planned(positions, system), positions, positions[:1], system=system)
    assert cloud.counts.sum() == 1
    assert np.count_nonzero(cloud.edge_time_s) <= 1
    assert sum(len(plan.camera_indices) for plan in edges) == 1


def test_what_does_not_belong_together_is_refused() -> None:
    positions, system = site(60, 6)
    cloud, edges = planned(positions, system)
    other = random_system(np.random.default_rng(9), 3)
    limited = System(edges=tuple(replace(e, devices=tuple(replace(d, max_cameras=2) for d in e.devices)) for e in system.edges))
    cases = [
        (positions[:-1], positions, system, "60 cameras, there are 59"),
        (positions, positions, other, "use the system it was planned for"),
        (positions, np.zeros((0, 2)), system, "no photograph"),
        (positions, positions + 5000.0, system, "use the plan of this site"),
        (positions, np.full((3, 2), np.nan), system, "not finite"),
        (positions, positions, limited, "its memory holds 2"),
    ]
    for planned_xy, captured_xy, used, told in cases:
        with pytest.raises(BadInput, match=told):
            plan_captured(cloud, edges, planned_xy, captured_xy, system=used)
    with pytest.raises(BadInput, match="disagree"):
        plan_captured(replace(cloud, edge_of_camera=1 - np.minimum(cloud.edge_of_camera, 1)), edges, positions, positions, system=system)


def test_photographs_in_the_folder_of_another_edge_are_told() -> None:
    positions, system = site(120, 7)
    cloud, edges = planned(positions, system)
    first = np.cumsum([0, *(len(plan.device_ids) for plan in edges)])
    own = first[cloud.edge_of_camera]  # the first device of each edge took all of its edge
    assert not find_captured_elsewhere(edges, positions, own, positions).any()
    exchanged = own.copy()
    exchanged[cloud.edge_of_camera == 0] = first[1]
    np.testing.assert_array_equal(find_captured_elsewhere(edges, positions, exchanged, positions), cloud.edge_of_camera == 0)
    with pytest.raises(BadInput, match="use the plan of this site"):
        find_captured_elsewhere(edges, positions, own, positions + 5000.0)


def test_where_one_device_captured_all_of_an_edge_nothing_is_joined() -> None:
    positions, system = site(60)
    edges = tuple(replace(edge, aggregate_s=CostCurve(constant=1000.0), aggregate_alone_s=CostCurve(constant=1.0)) for edge in system.edges)
    system = System(edges=edges)
    cloud, plans = planned(positions, system)
    edge = next(index for index, plan in enumerate(plans) if len(plan.device_ids) > 1 and len(plan.camera_indices))
    plan = plans[edge]
    first = plan.camera_indices[plan.device_of_camera == plan.device_of_camera[0]]
    alone, _ = plan_captured(cloud, plans, positions, positions[first], system=system)
    device = system.edges[edge].devices[int(plan.device_of_camera[0])]
    sent_s = float(device.model_bytes(len(first))) / system.edges[edge].uplink_bytes_per_s
    assert alone.edge_time_s[edge] == pytest.approx(float(device_time_s(device, len(first))) + 1.0 + sent_s)


@pytest.mark.parametrize(("far", "refused"), [(2, False), (3, True)])
def test_a_plan_of_another_site_is_told_where_more_than_half_lie_beyond_its_width(far: int, refused: bool) -> None:
    """One spot stands for a site of 100 m: 100 m away belongs to it, a millimetre more does not."""
    planned_xy = np.zeros((3, 2))
    captured = np.zeros((4, 2))
    captured[:far, 0] = 100.001
    captured[far:, 0] = 100.0
    if refused:
        told = f"{far} of 4 photographs lie farther than 100 m, the width of the plan, from every waypoint, the first by 100 m"
        with pytest.raises(BadInput, match=told):
            nearest_planned(planned_xy, captured)
    else:
        assert len(nearest_planned(planned_xy, captured)) == 4
    wide = np.array([[0.0, 0.0], [300.0, 400.0]])
    assert nearest_planned(wide, np.array([[-500.0, 0.0]])).tolist() == [0]
    with pytest.raises(BadInput, match="1 of 1 photographs lie farther than 500 m"):
        nearest_planned(wide, np.array([[-500.1, 0.0]]))


def test_the_status_says_how_near_the_captured_counts_are_to_the_best() -> None:
    positions = np.stack([np.arange(100.0), np.zeros(100)], axis=1)
    system = linear_system(np.array([[25.0, 0.0], [75.0, 0.0]]), np.ones(2))
    cloud, edges = planned(positions, system)
    for west, east, status in ((50, 50, "optimal"), (52, 48, "converged"), (53, 47, "stopped")):
        rows = np.concatenate([np.arange(50 - min(west, 50), 50), np.full(max(0, west - 50), 3), np.arange(100 - east, 100)])
        new, _ = plan_captured(cloud, edges, positions, positions[rows], system=system)
        assert (new.counts.tolist(), new.status, new.lower_bound_s) == ([west, east], status, 50.0)


def test_a_device_may_capture_exactly_what_its_memory_holds() -> None:
    positions, system = np.stack([np.arange(6.0), np.zeros(6)], axis=1), linear_system(np.array([[1.0, 0.0], [4.0, 0.0]]), np.ones(2), 3)
    cloud, edges = planned(positions, system)
    assert plan_captured(cloud, edges, positions, positions, system=system)[0].counts.tolist() == [3, 3]
    with pytest.raises(BadInput, match="device 'd0' captured 4 photographs, its memory holds 3: raise max_cameras or leave some out"):
        plan_captured(cloud, edges, positions, positions[[0, 0, 1, 2]], system=system)
