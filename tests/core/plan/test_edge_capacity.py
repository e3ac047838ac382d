"""Edges known by their curve alone: planned like others, dealt later by themselves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.io.records import load_plan, save_plan
from radiant_core.plan.counts.count_raster import capacity_curve, edge_without_devices
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.regions.region_plan import PlanInfeasible, plan_regions
from radiant_core.plan.system import System

from .instances import LAYOUTS, linear_system


def test_an_edge_whose_curve_is_exact_is_planned_as_with_its_devices(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    positions = LAYOUTS["uniform"](rng, 90)
    whole = linear_system(rng.random((3, 2)) * 300, np.array([1.0, 2.0, 4.0]), max_cameras=50)
    bare = System(edges=(*(edge_without_devices(edge, 90) for edge in whole.edges[:2]), whole.edges[2]))
    assert not any(edge.devices for edge in bare.edges[:2]) and bare.edges[0].max_cameras == 50
    plan, other = plan_regions(positions, whole), plan_regions(positions, bare)
    assert isinstance(plan, CloudPlan) and isinstance(other, CloudPlan)
    np.testing.assert_array_equal(plan.edge_of_camera, other.edge_of_camera)
    assert other.status == "optimal" and other.makespan_s == pytest.approx(plan.makespan_s, rel=1e-9)
    edges = split_edges(positions, other, bare)
    assert [edge.dealt for edge in edges] == [False, False, True]
    assert edges[0].device_ids == () and (edges[0].device_of_camera == -1).all() and len(edges[0].camera_indices) == other.counts[0]
    save_plan(tmp_path / "plan.json", other, edges)
    _, loaded = load_plan(tmp_path / "plan.json")
    assert [edge.dealt for edge in loaded] == [False, False, True]


def test_what_one_curve_smooths_is_said() -> None:
    edge = linear_system(np.zeros((1, 2)), np.ones(1)).edges[0]
    late = replace(edge.devices[0], id="late", train_s=CostCurve(constant=100.0))
    exact, smoothed = (capacity_curve(one, 200).worst_error for one in (edge, replace(edge, devices=(edge.devices[0], late))))
    assert exact is not None and exact < 1e-9
    assert smoothed is not None and smoothed > 0.01
    with pytest.raises(BadInput, match="can hold 0"):
        capacity_curve(replace(edge, devices=(replace(edge.devices[0], max_cameras=0),)), 5)


def test_curves_count_towards_the_capacity() -> None:
    bare = edge_without_devices(linear_system(np.zeros((1, 2)), np.ones(1), max_cameras=4).edges[0], 9)
    plan = plan_regions(np.random.default_rng(0).random((9, 2)), System(edges=(bare,)))
    assert isinstance(plan, PlanInfeasible) and plan.capacity == 4


def test_a_curve_beside_devices_or_aggregation_is_refused() -> None:
    edge = linear_system(np.zeros((1, 2)), np.ones(1)).edges[0]
    with pytest.raises(BadInput, match="its whole time, and devices"):
        replace(edge, time_s=CostCurve(linear=1.0))
    with pytest.raises(BadInput, match="no time_s"):
        replace(edge, max_cameras=3)
    with pytest.raises(BadInput, match="max_cameras is -1"):
        replace(edge, devices=(), time_s=CostCurve(linear=1.0), max_cameras=-1)
