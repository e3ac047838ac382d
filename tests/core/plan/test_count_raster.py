"""Planning from a count raster: what the cloud is told, what the edges make of it, and that nothing
is lost or invented on the way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.plan.counts.count_raster import (
    CountRaster,
    _hand_over,
    assign_to_regions,
    count_raster,
    middles_of_cells,
    regions_of_raster,
    system_without_devices,
)
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.regions.power_diagram import assign
from radiant_core.plan.regions.region_plan import PlanInfeasible, plan_regions
from radiant_core.plan.system import System

from .instances import LAYOUTS, linear_system


def four_edges(max_cameras: int | None = None) -> System:
    corners = np.array([[100.0, 60.0], [400.0, 60.0], [100.0, 190.0], [400.0, 190.0]])
    return linear_system(corners, np.array([1.0, 2.0, 1.0, 3.0]), max_cameras)


def planned(positions: FloatArray, system: System, cell_m: float) -> tuple[CloudPlan, CloudPlan]:
    regions = regions_of_raster(count_raster(positions, cell_m), system_without_devices(system, len(positions)))
    assert isinstance(regions, CloudPlan)
    return regions, assign_to_regions(regions, positions, system)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("cell_m", [1e-3, 7.0, 1e4])
def test_a_raster_counts_every_camera_in_the_cell_it_lies_in(layout: str, cell_m: float) -> None:
    positions = LAYOUTS[layout](np.random.default_rng(0), 150) - np.array([250.0, 0.0])
    raster = count_raster(positions, cell_m)
    assert raster.counts.sum() == 150 and len(raster.places) == 150
    assert np.abs(np.sort(middles_of_cells(positions, cell_m), axis=0) - np.sort(raster.places, axis=0)).max() <= 1e-9 * max(1, cell_m)
    assert (np.abs(middles_of_cells(positions, cell_m) - positions) <= cell_m / 2 * (1 + 1e-9) + 1e-9).all()


@pytest.mark.parametrize("layout", LAYOUTS)
def test_with_tiny_cells_and_exact_curves_it_is_the_plan_from_positions(layout: str) -> None:
    positions = LAYOUTS[layout](np.random.default_rng(1), 210)
    exact = plan_regions(positions, four_edges())
    assert isinstance(exact, CloudPlan)
    regions, plan = planned(positions, four_edges(), 1e-4)
    np.testing.assert_array_equal(regions.counts, exact.counts)
    assert plan.lower_bound_s == exact.lower_bound_s and plan.certified
    # There many cameras lie on the border and all go one way.
    if layout not in ("lattice", "duplicates", "one spot"):
        assert plan.makespan_s <= exact.makespan_s * 1.03


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("cell_m", [3.0, 40.0, 1000.0])
def test_every_camera_follows_the_border_it_lies_within(layout: str, cell_m: float) -> None:
    positions = LAYOUTS[layout](np.random.default_rng(2), 160) + np.array([3e5, 5e6])
    regions, plan = planned(positions, replace_positions(four_edges(), [3e5, 5e6]), cell_m)
    used = np.flatnonzero(regions.counts)
    expected = used[assign(positions, regions.sites[used], regions.weights[used])]
    centre = positions.mean(axis=0)
    power = np.sum((positions[:, None] - centre - (regions.sites[used] - centre)) ** 2, axis=-1) - regions.weights[used]
    nearly_equal = np.diff(np.sort(power, axis=1)[:, :2]).ravel() < 1e-3 if len(used) > 1 else np.zeros(160, bool)
    assert ((plan.edge_of_camera == expected) | nearly_equal).all()
    assert plan.makespan_s >= plan.lower_bound_s and plan.counts.sum() == 160 and plan.num_outside == 0
    # The land of the regions holds every camera, wherever in its cell it lies.
    corners = np.concatenate(plan.borders)
    assert (corners.min(axis=0) <= positions.min(axis=0)).all() and (corners.max(axis=0) >= positions.max(axis=0)).all()


def replace_positions(system: System, shift: list[float]) -> System:
    return replace(system, edges=tuple(replace(e, position=tuple(np.add(e.position or (0, 0), shift).tolist())) for e in system.edges))


def test_what_devices_cannot_hold_goes_to_a_neighbour_by_the_shortest_way() -> None:
    positions = LAYOUTS["clustered"](np.random.default_rng(3), 200)
    system = four_edges(max_cameras=50)
    _, plan = planned(positions, system, 90.0)
    np.testing.assert_array_equal(plan.counts, [50, 50, 50, 50])
    assert plan.num_outside > 0 and not plan.certified and plan.status != "optimal"
    with pytest.raises(BadInput, match="can hold 196 of 200"):
        assign_to_regions(plan, positions, four_edges(max_cameras=49))
    infeasible = regions_of_raster(count_raster(positions, 90.0), system_without_devices(four_edges(max_cameras=49), 200))
    assert isinstance(infeasible, PlanInfeasible) and infeasible.capacity == 196


def test_one_that_must_move_is_the_one_nearest_to_the_border() -> None:
    positions = np.array([[1.0, 0.0], [2.0, 0.0], [3.0, 0.0], [30.0, 0.0]])
    system = linear_system(np.array([[0.0, 0.0], [20.0, 0.0]]), np.ones(2))
    regions, _ = planned(positions, system, 1.0)
    regions = replace(regions, weights=np.zeros(2))
    first, second = system.edges
    small = replace(system, edges=(replace(first, devices=(replace(first.devices[0], max_cameras=2),)), second))
    plan = assign_to_regions(regions, positions, small)
    np.testing.assert_array_equal(plan.edge_of_camera, [0, 0, 1, 1])
    assert plan.num_outside == 1


def test_the_cloud_is_told_curves_alone_and_refuses_devices() -> None:
    system = four_edges()
    told = system_without_devices(system, 100)
    assert not told.devices and all(edge.time_s is not None for edge in told.edges)
    assert system_without_devices(told, 100) == told, "an edge that is known by its curve already stays as it is"
    positions = LAYOUTS["uniform"](np.random.default_rng(4), 30)
    with pytest.raises(BadInput, match="was given devices"):
        regions_of_raster(count_raster(positions, 5.0), system)
    with pytest.raises(BadInput, match="the system has others"):
        assign_to_regions(planned(positions, system, 5.0)[0], positions, replace(system, edges=system.edges[:2]))
    full = system_without_devices(four_edges(max_cameras=0), 10)
    assert [edge.max_cameras for edge in full.edges] == [0] * 4


@pytest.mark.parametrize("cell_m", [0.0, -1.0, np.nan, np.inf, 1e-12])
def test_cells_that_are_no_raster_are_refused(cell_m: float) -> None:
    with pytest.raises(BadInput, match="raster"):
        count_raster([[1e3, 0.0]], cell_m)


@pytest.mark.parametrize(("cells", "counts"), [([[0, 0], [0, 0]], [1, 1]), ([[0, 0]], [0]), ([[0, 0]], [1, 2])])
def test_a_raster_that_contradicts_itself_is_refused(cells: list, counts: list) -> None:
    with pytest.raises(BadInput):
        CountRaster(cell_m=1.0, cells=np.array(cells), counts=np.array(counts))


def test_poisoned_positions_are_refused() -> None:
    with pytest.raises(BadInput, match="positions"):
        count_raster([[0.0, np.nan]], 1.0)


def test_the_land_of_a_raster_ends_a_tenth_of_its_longer_side_beyond_its_cells() -> None:
    positions = np.array([[11.0, 21.0], [58.0, 21.0], [35.0, 39.0]])
    regions = regions_of_raster(
        count_raster(positions, 10.0), system_without_devices(linear_system(np.array([[20.0, 30.0], [50.0, 30.0]]), np.ones(2)), 3)
    )
    assert isinstance(regions, CloudPlan)
    corners = np.concatenate(regions.borders)
    # Cells from 10 to 60 and 20 to 40.
    np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)], [[5.0, 15.0], [65.0, 45.0]])


@pytest.mark.parametrize(("cell_m", "fits"), [(1.0, True), (0.999, False)])
def test_a_raster_has_some_10_to_the_12_cells_on_a_side(cell_m: float, fits: bool) -> None:
    positions = [[2.0**40, -(2.0**40)]]
    if fits:
        assert count_raster(positions, cell_m).cells.tolist() == [[2**40, -(2**40)]]
    else:
        with pytest.raises(BadInput, match=r"a raster of cells of 0\.999 m has more than 10\^12 of them on a side here"):
            count_raster(positions, cell_m)


@pytest.mark.parametrize("cell_m", [0.0, -1.0, np.nan, np.inf, 1.1e6, 1e300])
def test_a_cell_has_a_side(cell_m: float) -> None:
    with pytest.raises(BadInput, match=r"expected more than 0 and at most 1e\+06 m: 10 m is usual"):
        CountRaster(cell_m=cell_m, cells=np.zeros((0, 2), np.int64), counts=np.zeros(0, np.int64))
    with pytest.raises(BadInput, match=r"expected more than 0 and at most 1e\+06 m: 10 m is usual"):
        middles_of_cells(np.eye(2), cell_m)


def test_the_status_of_what_edges_make_of_it_is_by_the_bound_and_by_who_was_handed_over() -> None:
    """Fifty to fifty is the best of 100 cameras; 52 is within a twentieth, 53 is not."""
    system = linear_system(np.array([[25.0, 0.0], [75.0, 0.0]]), np.ones(2))
    positions = np.stack([np.arange(100.0), np.zeros(100)], axis=1)
    regions, _ = planned(positions, system, 1.0)
    for border, status in ((49.5, "optimal"), (51.5, "converged"), (52.5, "stopped")):
        plan = assign_to_regions(replace(regions, weights=np.array([100 * (border - 50.0), 0.0])), positions, system)
        assert (plan.counts[0], plan.status, plan.certified, plan.history) == (border + 0.5, status, True, (border + 0.5,))
    first, second = system.edges
    full = replace(system, edges=(replace(first, devices=(replace(first.devices[0], max_cameras=50),)), second))
    plan = assign_to_regions(replace(regions, weights=np.array([150.0, 0.0])), positions, full)
    assert plan.counts.tolist() == [50, 50] and (plan.num_outside, plan.certified, plan.status) == (2, False, "converged")


def test_cameras_handed_over_are_the_cheapest_against_every_choice() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        power = rng.random((7, 3)) * 100
        room = np.array([2, 3, 4])
        chosen = power.argmin(axis=1)
        before, counts = chosen.copy(), np.bincount(chosen, minlength=3)
        moved = _hand_over(chosen, power, room)
        assert moved == (chosen != before).sum() or moved >= np.maximum(counts - room, 0).sum()
        after = np.bincount(chosen, minlength=3)
        assert (after <= room).all()
        if moved == 1:
            full = int((counts > room).argmax())
            costs = [(power[c, e] - power[c, full], c, e) for c in np.flatnonzero(before == full) for e in range(3) if counts[e] < room[e]]
            _, camera, edge = min(costs)
            assert chosen[camera] == edge


def test_an_edge_of_which_no_device_has_room_is_told_with_its_place() -> None:
    edge = system_without_devices(four_edges(max_cameras=0), 10).edges[1]
    assert (edge.id, edge.position, edge.lat_lon_deg, edge.max_cameras, edge.uplink_bytes_per_s) == ("e1", (400.0, 60.0), None, 0, 1.0)
