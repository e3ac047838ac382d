"""Strips: every camera at one device, cut across the long side, a partition of the edge's land."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import shapely

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.plan.devices.device_split import long_axis, split_edge, split_edges
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.regions.power_diagram import polygon_area_m2, rectangle
from radiant_core.plan.regions.region_plan import plan_regions
from tests.seeds import for_seeds

from .instances import LAYOUTS, random_edge, random_system

BORDER = rectangle(np.array([-100.0, -100.0]), np.array([600.0, 400.0]))


def split(positions: FloatArray, num_devices: int = 3, seed: int = 0) -> EdgePlan:
    edge = random_edge(np.random.default_rng(seed), "e", num_devices)
    return split_edge(edge, positions, np.arange(len(positions)), BORDER)


def rotated(points: FloatArray, angle: float) -> FloatArray:
    return points @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


@pytest.mark.parametrize("layout", LAYOUTS)
@for_seeds(10)
def test_a_whole_plan_gives_every_camera_to_one_device_within_its_land(layout: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    positions, system = LAYOUTS[layout](rng, 70), random_system(rng, 4, limits=(20, 40))
    plan = plan_regions(positions, system)
    assert isinstance(plan, CloudPlan)
    edge_plans = split_edges(positions, plan, system)
    np.testing.assert_array_equal(np.sort(np.concatenate([p.camera_indices for p in edge_plans])), np.arange(70))
    for index, (edge, edge_plan) in enumerate(zip(system.edges, edge_plans, strict=True)):
        np.testing.assert_array_equal(plan.edge_of_camera[edge_plan.camera_indices], index)
        sizes = [len(edge_plan.cameras_of(device.id)) for device in edge.devices]
        assert sum(sizes) == plan.counts[index]
        assert (np.array(sizes) <= [device.max_cameras for device in edge.devices]).all()
        land_m2 = sum(polygon_area_m2(strip) for strip in edge_plan.strips)
        # Clipping loses at most slivers of 1e-13 m along borders of some hundred metres.
        assert land_m2 == pytest.approx(polygon_area_m2(plan.borders[index]), abs=1e-8)
        assert edge_plan.device_time_s.max() <= plan.edge_time_s[index]


@for_seeds(20)
def test_cameras_lie_in_their_device_s_strip_and_strips_follow_one_another(seed: int) -> None:
    positions = LAYOUTS["uniform"](np.random.default_rng(seed), 60)
    plan = split(positions, num_devices=4, seed=seed)
    along = positions @ long_axis(positions)
    spans: list[tuple[float, float]] = []
    for device, strip in enumerate(plan.strips):
        own = np.flatnonzero(plan.device_of_camera == device)
        assert len(strip) == 0 if len(own) == 0 else polygon_area_m2(strip) > 0
        for index in own:
            assert shapely.Polygon(strip).distance(shapely.Point(positions[index])) < 1e-9  # metres
        if len(own):
            spans.append((float(along[own].min()), float(along[own].max())))
    spans.sort()
    assert all(end < start for (_, end), (start, _) in pairwise(spans))


def test_the_cut_is_midway_between_the_cameras_beside_it() -> None:
    positions = np.array([[0.0, 0.0], [10.0, 1.0], [20.0, 0.0], [30.0, 1.0]])
    edge = random_edge(np.random.default_rng(1), "e", 2)
    # Far above what else they differ in.
    equal = [replace(device, train_s=CostCurve(linear=1000.0)) for device in edge.devices]
    plan = split_edge(replace(edge, devices=tuple(equal)), positions, np.arange(4), BORDER)
    axis = long_axis(positions)
    along = positions @ axis
    taken = [along[plan.device_of_camera == device] for device in range(2)]
    assert [len(own) for own in taken] == [2, 2]
    first, second = sorted(range(2), key=lambda device: taken[device].min())
    cut = (taken[first].max() + taken[second].min()) / 2
    assert (plan.strips[first] @ axis).max() == pytest.approx(cut, abs=1e-9)
    assert (plan.strips[second] @ axis).min() == pytest.approx(cut, abs=1e-9)


@for_seeds(20)
def test_the_axis_is_that_of_the_smallest_rectangle_found_by_trying_all_angles(seed: int) -> None:
    points = rotated(np.random.default_rng(seed).normal(size=(25, 2)) * [30.0, 10.0], seed * 0.3)
    axis = long_axis(points)
    assert np.hypot(*axis) == pytest.approx(1.0, abs=1e-12)
    own = np.ptp(points @ axis) * np.ptp(points @ np.array([-axis[1], axis[0]]))
    angles = np.linspace(0, np.pi, 2001)
    turned = np.stack([np.cos(angles), np.sin(angles)])
    areas = np.ptp(points @ turned, axis=0) * np.ptp(points @ np.stack([-turned[1], turned[0]]), axis=0)
    assert own <= areas.min() * (1 + 1e-9)  # the axis is rounded to 1e-12 rad
    assert np.ptp(points @ axis) >= np.ptp(points @ np.array([-axis[1], axis[0]]))


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 90.0, 120.0, 179.0])
def test_a_straight_flight_is_cut_along_its_line(angle_deg: float) -> None:
    axis = np.array([np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))])
    np.testing.assert_allclose(long_axis(np.outer([0.0, 3.0, 7.0, 20.0], axis)), axis, atol=1e-9)


def test_a_square_lattice_has_an_axis_that_no_rounding_decides() -> None:
    lattice = np.stack(np.meshgrid(np.arange(5.0), np.arange(5.0)), axis=-1).reshape(-1, 2)
    for shift_m in (0.0, 0.1, 500_000.3):
        np.testing.assert_allclose(long_axis(lattice + shift_m), [1.0, 0.0], atol=1e-9)


def test_the_order_of_cameras_and_the_origin_do_not_matter() -> None:
    rng = np.random.default_rng(0)
    positions = rng.integers(0, 1 << 18, (80, 2)) / 1024  # exact under the shift
    edge, shift_m = random_edge(rng, "e", 4), np.array([500_000.0, 9_999_000.0])
    plan = split_edge(edge, positions, np.arange(80), BORDER)
    order = rng.permutation(80)
    shuffled = split_edge(edge, positions[order], np.arange(80), BORDER)
    np.testing.assert_array_equal(shuffled.device_of_camera, plan.device_of_camera[order])
    moved = split_edge(edge, positions + shift_m, np.arange(80), BORDER + shift_m)
    np.testing.assert_array_equal(moved.device_of_camera, plan.device_of_camera)
    for strip, other in zip(plan.strips, moved.strips, strict=True):
        # In metres; float64 has steps of 2e-9 there.
        np.testing.assert_allclose(other - shift_m, strip, atol=1e-6)


@pytest.mark.parametrize("layout", ["one spot", "duplicates"])
def test_cameras_at_one_spot_are_dealt_all_the_same(layout: str) -> None:
    plan = split(LAYOUTS[layout](np.random.default_rng(0), 30))
    assert len(plan.device_of_camera) == 30
    assert sum(polygon_area_m2(strip) for strip in plan.strips) == pytest.approx(polygon_area_m2(BORDER))


def test_one_camera_takes_the_whole_land_of_one_device() -> None:
    plan = split(np.array([[3.0, 4.0]]))
    assert sorted(len(strip) for strip in plan.strips) == [0, 0, 4]


def test_an_edge_without_cameras_has_no_strips_and_no_time() -> None:
    edge = random_edge(np.random.default_rng(0), "e", 2)
    plan = split_edge(edge, np.zeros((5, 2)), np.empty(0, dtype=np.int64), np.empty((0, 2)))
    assert [len(strip) for strip in plan.strips] == [0, 0]
    assert plan.device_time_s.tolist() == [0.0, 0.0]


def test_a_plan_of_another_system_is_refused() -> None:
    rng = np.random.default_rng(0)
    positions, system = LAYOUTS["uniform"](rng, 20), random_system(rng, 3)
    plan = plan_regions(positions, system)
    assert isinstance(plan, CloudPlan)
    with pytest.raises(BadInput, match="plan this system anew"):
        split_edges(positions, plan, random_system(rng, 2))
    with pytest.raises(BadInput, match="shape"):
        split_edges(positions[:-1], plan, system)


def test_more_cameras_than_memory_are_refused() -> None:
    edge = random_edge(np.random.default_rng(0), "e", 2, limits=(3, 3))
    with pytest.raises(BadInput, match="can hold 6"):
        split_edge(edge, np.random.default_rng(0).random((7, 2)), np.arange(7), BORDER)


def test_cameras_of_one_column_are_cut_by_how_far_across_they_lie() -> None:
    """Four columns of three along the long side, seven and five cameras: the column in the middle
    is cut across, the lower to the first."""
    positions = np.array([[10.0 * column, 4.0 * row] for row in (2, 0, 1) for column in range(4)])
    curve = CostCurve(linear=1.0)
    edge = random_edge(np.random.default_rng(0), "e", 2)
    first, second = (replace(device, init_s=CostCurve(), train_s=curve, model_bytes=CostCurve(), max_cameras=most)
                     for device, most in zip(edge.devices, (5, 7), strict=True))  # fmt: skip
    plan = split_edge(
        replace(edge, devices=(first, second)), positions, np.arange(12), np.array([[-5.0, -5], [35, -5], [35, 15], [-5, 15]])
    )
    counts = [len(plan.cameras_of(device.id)) for device in (first, second)]
    assert sorted(counts) == [5, 7] or counts == [6, 6]
    west, east = sorted((positions[plan.cameras_of(device.id)] for device in (first, second)), key=lambda part: part[:, 0].mean())
    shared = np.intersect1d(west[:, 0], east[:, 0])
    for column in shared:
        assert west[west[:, 0] == column][:, 1].max() < east[east[:, 0] == column][:, 1].min()
