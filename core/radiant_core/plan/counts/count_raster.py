"""What the cloud plans from where positions are private: cameras per raster cell, edges' curves.

    cloud: counts in cells, one fitted curve T^m per edge → sites and weights of the regions
    edge:  its devices' positions, sites and weights → edge of each camera, at exact cost curves

A camera goes to the edge whose region it lies in, wherever its cell was reckoned to be; counts miss
the planned ones by what cells at borders hold, the raster's price (docs/experiments/privacy.md).
Edges with full devices hand their nearest cameras to a neighbour. Of its devices an edge sends one
time curve and a capacity, nothing else. Once per plan.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core.choices import PlanMethod
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array
from radiant_core.plan.counts.deadline import edge_table
from radiant_core.plan.counts.wide_deadline import fastest_edge_counts, times_of_counts
from radiant_core.plan.devices.even_shares import even_times_s
from radiant_core.plan.plans import CloudPlan, PlanStatus
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.profiles.curve_fit import FittedCurve, fit_curve
from radiant_core.plan.regions.paper_config import PaperConfig
from radiant_core.plan.regions.power_diagram import cell_polygons, rectangle
from radiant_core.plan.regions.region_plan import MARGIN, PlanInfeasible, plan_regions
from radiant_core.plan.system import Edge, System

DEFAULT_CELL_M = 5.0
"""With four edges the median makespan was within 4 % of the one from positions (privacy.md)."""
MAX_CELL_M = 1e6
"""A site is at most 600 km wide: a larger cell resolves nothing."""
MAX_CELL_INDEX = 2**40


@dataclass(frozen=True, kw_only=True, eq=False)
class CountRaster:
    """S cells with cameras: cells (S,2), of which [i, j] is the square from (i, j) to (i + 1, j +
    1) times `cell_m`; counts (S,) ≥ 1."""

    cell_m: float
    cells: NDArray[np.int64]
    counts: NDArray[np.int64]

    def __post_init__(self) -> None:
        _require_cell(self.cell_m)
        object.__setattr__(self, "cells", check_array("cells", self.cells, (None, 2), np.int64))
        object.__setattr__(self, "counts", check_array("counts", self.counts, (len(self.cells),), np.int64))
        if self.counts.min(initial=1) < 1 or len(np.unique(self.cells, axis=0)) != len(self.cells):
            raise BadInput("the raster has a cell twice or one without a camera: count the cameras of each cell once.")

    @property
    def places(self) -> FloatArray:
        """(C,2) m: the middle of its cell for every camera."""
        middles: FloatArray = (self.cells.astype(np.float64) + 0.5) * self.cell_m
        return np.repeat(middles, self.counts, axis=0)


def count_raster(positions: ArrayLike, cell_m: float) -> CountRaster:
    """How many of the positions (C,2) m lie in each cell of side `cell_m`; BadInput for a cell that
    is not positive or far too small."""
    positions = check_array("positions", positions, (None, 2))
    _require_cell(cell_m)
    indices = np.floor(positions / cell_m)
    if np.abs(indices).max(initial=0) > MAX_CELL_INDEX:
        raise BadInput(f"a raster of cells of {cell_m:g} m has more than 10^12 of them on a side here: use larger ones.")
    cells, counts = np.unique(indices.astype(np.int64), axis=0, return_counts=True)
    return CountRaster(cell_m=float(cell_m), cells=cells, counts=counts.astype(np.int64))


def _require_cell(cell_m: float) -> None:
    if not 0 < cell_m <= MAX_CELL_M:
        raise BadInput(f"the raster's cell is {cell_m:g} m, expected more than 0 and at most {MAX_CELL_M:g} m: 10 m is usual.")


def middles_of_cells(positions: ArrayLike, cell_m: float) -> FloatArray:
    """For each of the positions (C,2) m the middle (C,2) of its cell; raises as `count_raster`."""
    return (np.floor(check_array("positions", positions, (None, 2)) / count_raster(positions, cell_m).cell_m) + 0.5) * cell_m


def system_without_devices(system: System, num_cameras: int) -> System:
    """The system without devices: edges by fitted curve and capacity; raises as
    `capacity_curve`."""
    return replace(system, edges=tuple(_without_devices(edge, num_cameras) for edge in system.edges))


def regions_of_raster(
    raster: CountRaster, system: System, method: PlanMethod = "exact", paper: PaperConfig | None = None
) -> CloudPlan | PlanInfeasible:
    """The cloud's plan: regions for the cameras at `raster.places` by edges that are known by their
    curves alone; raises as `plan_regions`."""
    if any(edge.devices for edge in system.edges):
        raise BadInput("the cloud was given devices, expected edges with their curves alone: pass what known_to_the_cloud returns.")
    plan = plan_regions(raster.places, system, method=method, paper=paper)
    if isinstance(plan, PlanInfeasible):
        return plan
    # Cameras lie anywhere in their cells, not in the middles alone.
    low, high = raster.cells.min(axis=0) * raster.cell_m, (raster.cells.max(axis=0) + 1) * raster.cell_m
    centre, margin_m = (low + high) / 2, MARGIN * float((high - low).max())
    outline = rectangle(low - centre - margin_m, high - centre + margin_m)
    borders = tuple(border + centre for border in cell_polygons(plan.sites - centre, plan.weights, outline))
    return replace(plan, borders=borders)


def assign_to_regions(regions: CloudPlan, positions: ArrayLike, system: System) -> CloudPlan:
    """What the edges make of the regions: cameras (C,2) m by the region they lie in, exact times.
    Edges without a camera in the cloud's plan get none. Cameras that an edge's devices cannot hold
    go to an edge with room, those for which the way grows least; then the plan is not certified.
    Raises BadInput when all edges together cannot hold them."""
    positions = check_array("positions", positions, (None, 2))
    if regions.edge_ids != tuple(edge.id for edge in system.edges):
        raise BadInput(f"the regions are of edges {', '.join(regions.edge_ids)}, the system has others: plan this system anew.")
    used = np.flatnonzero(regions.counts)
    power_m2 = np.sum((positions[:, None] - regions.sites[used]) ** 2, axis=-1) - regions.weights[used]
    room = np.array([edge_table(system.edges[index], len(positions)).capacity for index in used], np.int64)
    if room.sum() < len(positions):
        raise BadInput(f"the edges can hold {room.sum()} of {len(positions)} cameras: raise max_cameras or add devices.")
    chosen = power_m2.argmin(axis=1)
    handed_over = _hand_over(chosen, power_m2, room)
    edge_of_camera = used[chosen]
    times_s = even_times_s if regions.method == "even" else times_of_counts
    edge_time_s = times_s(system, np.bincount(edge_of_camera, minlength=len(system.edges)))
    lower_bound_s, makespan_s = float(fastest_edge_counts(system, len(positions)).edge_time_s.max()), float(edge_time_s.max())
    status: PlanStatus = "stopped"
    if not handed_over and makespan_s <= lower_bound_s:
        status = "optimal"
    elif makespan_s <= (1 + PaperConfig().threshold) * lower_bound_s:
        status = "converged"
    return replace(
        regions,
        edge_of_camera=edge_of_camera,
        looks=None,
        edge_time_s=edge_time_s,
        lower_bound_s=lower_bound_s,
        status=status,
        certified=not handed_over,
        history=(makespan_s,),
        num_outside=handed_over,
    )


def _hand_over(chosen: NDArray[np.int64], power_m2: FloatArray, room: NDArray[np.int64]) -> int:
    """Move cameras, in place, from edges that hold more than their `room` (E,) to others, cheapest
    first; returns how many were moved."""
    counts = np.bincount(chosen, minlength=len(room))
    moved = 0
    while (counts > room).any():
        movable = np.flatnonzero((counts > room)[chosen])
        costs = np.where(counts < room, power_m2[movable], np.inf) - power_m2[movable, chosen[movable]][:, None]
        camera, edge = np.unravel_index(int(costs.argmin()), costs.shape)
        counts[chosen[movable[camera]]] -= 1
        counts[edge] += 1
        chosen[movable[camera]] = edge
        moved += 1
    return moved


def _without_devices(edge: Edge, num_cameras: int) -> Edge:
    if not edge.devices:
        return edge
    if edge_table(edge, num_cameras).capacity:
        return edge_without_devices(edge, num_cameras)
    return Edge(
        id=edge.id,
        position=edge.position,
        lat_lon_deg=edge.lat_lon_deg,
        aggregate_s=CostCurve(),
        uplink_bytes_per_s=edge.uplink_bytes_per_s,
        devices=(),
        time_s=CostCurve(),
        max_cameras=0,
    )


_SAMPLES = 32


def capacity_curve(edge: Edge, num_cameras: int) -> FittedCurve:
    """T^m of an edge fitted by one curve over 1..`num_cameras` cameras; `worst_error` is the
    largest relative error at its samples.

    T^m has a bend wherever a device comes in or is full, which one curve smooths. Raises BadInput
    where the edge can hold no camera.
    """
    table = edge_table(edge, num_cameras)
    if table.capacity < 1:
        raise BadInput(f"edge {edge.id!r} can hold {table.capacity} cameras: give its devices room for at least one.")
    counts = np.unique(np.round(np.geomspace(1, table.capacity, _SAMPLES)).astype(np.int64))
    times_s = table.edge_time_s[counts]
    if times_s.min() <= 0:
        raise BadInput(f"edge {edge.id!r} needs no time for {int(counts[times_s.argmin()])} cameras: profile its devices first.")
    return fit_curve(counts, times_s)


def edge_without_devices(edge: Edge, num_cameras: int) -> Edge:
    """The same edge as the cloud may receive it: place, fitted curve and how many cameras it holds
    (None: at least `num_cameras`)."""
    capacity = edge_table(edge, num_cameras).capacity
    return Edge(
        id=edge.id,
        position=edge.position,
        lat_lon_deg=edge.lat_lon_deg,
        aggregate_s=CostCurve(),
        uplink_bytes_per_s=edge.uplink_bytes_per_s,
        devices=(),
        time_s=capacity_curve(edge, num_cameras).curve,
        max_cameras=capacity if capacity < num_cameras else None,
    )
