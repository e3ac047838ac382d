"""Regions of the edges (paper Sec. III-B, ARP): who owns which cameras so that the slowest edge is as fast as possible.

In the paper's cost model an edge's time depends on its region only through the number of cameras in it. So the best counts
are found first, without geography (`deadline`); then the cameras are dealt to the edges with exactly these counts and the
least Σ ‖camera − edge‖² (`transport`). The least-squares assignment for any counts is a power diagram of the edge positions
(Aurenhammer, Hoffmann, Aronov, Algorithmica 1998): convex, disjoint, covering regions at the geography-free lower bound.

    exact     counts with the smallest makespan: optimal in this model, with a certificate
    even      counts as equal as the memory limits allow
    voronoi   every camera to its nearest edge
    paper     Alg. 1, moving borders by a fixed step (`paper_arp`)

Runs once per plan.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, checked_array
from radiant_core.plan.deadline import EdgeTable, earliest_slots, edge_tables, fastest_counts
from radiant_core.plan.edge_sites import separated_sites
from radiant_core.plan.paper_arp import PaperConfig, paper_regions
from radiant_core.plan.plans import CloudPlan, PlanStatus
from radiant_core.plan.power_diagram import assign, cell_polygons, rectangle
from radiant_core.plan.system import System
from radiant_core.plan.transport import assign_with_counts, largest_violation, separating_weights

PlanMethod = Literal["exact", "paper", "voronoi", "even"]

MAX_EXACT_PAIRS = 500_000
"""Cameras × edges up to which least squared distances are sought exactly, some seconds at most; above, `paper` is used."""
MAX_COORDINATE_M = 1e8
"""Coordinates may be UTM-sized, not of another planet."""
MARGIN = 0.1
"""Width of land beyond the outermost cameras that still belongs to a region, as a share of their bounding box's longer side."""
CERTIFICATE_TOLERANCE = 1e-12
"""A camera may miss its cell by this share of the largest squared distance: thousands of roundings, below a micrometre per km."""


@dataclass(frozen=True, kw_only=True)
class PlanInfeasible:
    """No plan by this method: the devices' memory cannot hold the cameras."""

    method: PlanMethod
    num_cameras: int
    capacity: int
    """Cameras that all devices together can hold."""
    reason: str
    """What does not fit and what to do, one sentence."""
    status: PlanStatus = "infeasible"


@dataclass(frozen=True, kw_only=True, eq=False)
class _Plane:
    """Cameras (C,2), sites (E,2) and a rectangle (4,2) with a margin around the cameras, all in metres about `centre` (2,).

    side_m: longer side of the cameras' bounding box, 1 where they share one spot.
    """

    cameras: FloatArray
    sites: FloatArray
    outline: FloatArray
    centre: FloatArray
    side_m: float

    def squared_m2(self) -> FloatArray:
        """‖camera − site‖² (C,E)."""
        return np.sum((self.cameras[:, None] - self.sites) ** 2, axis=-1)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Partition:
    edge_of_camera: NDArray[np.int64]
    weights: FloatArray
    history: tuple[float, ...] = ()
    converged: bool = False


def choose_method(method: PlanMethod, num_cameras: int, num_edges: int) -> tuple[PlanMethod, tuple[Decision, ...]]:
    """The method that plans this many cameras and edges in bearable time, with the decision where it is not the wanted one."""
    pairs = num_cameras * num_edges
    if method not in ("exact", "even") or pairs <= MAX_EXACT_PAIRS:
        return method, ()
    decision = Decision(
        stage="plan",
        topic="method",
        choice=f"paper instead of {method}",
        figure=float(pairs),
        unit="cameras × edges",
        reason=f"Least squared distances are sought exactly up to {MAX_EXACT_PAIRS} pairs.",
    )
    return "paper", (decision,)


def plan_regions(
    positions: ArrayLike, system: System, *, method: PlanMethod = "exact", paper: PaperConfig | None = None
) -> CloudPlan | PlanInfeasible:
    """Regions for cameras (C,2) m; every edge needs a position (`place_edges`). `plan.method` is the one `choose_method` gave.

    status: optimal = the lower bound with a certificate; converged = within the paper's threshold (of the bound, for methods
    that do not iterate); stopped otherwise. Raises BadInput for positions that are not finite, none, or beyond 1e8 m.
    """
    if method not in get_args(PlanMethod):
        raise BadInput(f"plan method {method!r} is unknown: use one of {', '.join(get_args(PlanMethod))}.")
    plane = _plane(positions, system)
    num_cameras = len(plane.cameras)
    method, _ = choose_method(method, num_cameras, len(system.edges))
    tables = edge_tables(system, num_cameras)
    capacity = sum(table.capacity for table in tables)
    if capacity < num_cameras:
        reason = f"the devices can hold {capacity} of {num_cameras} cameras: raise max_cameras or add devices."
        return PlanInfeasible(method=method, num_cameras=num_cameras, capacity=capacity, reason=reason)
    paper = paper or PaperConfig()
    partition = _partition(method, plane, tables, paper)
    counts = np.bincount(partition.edge_of_camera, minlength=len(tables))
    for edge, count, table in zip(system.edges, counts, tables, strict=True):
        if count > table.capacity:
            reason = f"method {method} gives edge {edge.id!r} {count} cameras, it can hold {table.capacity}: use method exact."
            return PlanInfeasible(method=method, num_cameras=num_cameras, capacity=capacity, reason=reason)
    return _cloud_plan(method, system, plane, tables, partition, paper.threshold)


def regions_around(positions: ArrayLike, edge_of_camera: NDArray[np.int64], system: System) -> CloudPlan:
    """Regions for cameras (C,2) m that already belong to edges (C,): every place to the edge whose cameras' mean is nearest.

    Edges without cameras own no land. The lower bound is that of the same counts of cameras dealt freely, 0 where memory forbids it.
    """
    positions = checked_array("positions", positions, (len(edge_of_camera), 2))
    counts = np.bincount(edge_of_camera, minlength=len(system.edges))
    means = [positions[edge_of_camera == index].mean(axis=0) if count else positions.mean(axis=0) for index, count in enumerate(counts)]
    placed = [replace(edge, position=(float(x), float(y))) for edge, (x, y) in zip(system.edges, means, strict=True)]
    plane = _plane(positions, System(edges=tuple(placed)))
    tables = edge_tables(system, len(positions))
    fits = sum(table.capacity for table in tables) >= len(positions)
    weights = _closed_where_unused(np.zeros(len(placed)), counts, plane)
    return CloudPlan(
        method="captured",
        edge_ids=tuple(edge.id for edge in system.edges),
        sites=plane.sites + plane.centre,
        weights=weights,
        borders=tuple(border + plane.centre for border in cell_polygons(plane.sites, weights, plane.outline)),
        edge_of_camera=edge_of_camera,
        edge_time_s=np.zeros(len(placed)),
        lower_bound_s=fastest_counts(tables, len(positions))[1] if fits else 0.0,
        status="stopped",
        certified=False,
    )


def _plane(positions: ArrayLike, system: System) -> _Plane:
    positions = checked_array("positions", positions, (None, 2))
    if not len(positions):
        raise BadInput("positions holds no camera: give at least one.")
    unplaced = [edge.id for edge in system.edges if edge.position is None]
    if unplaced:
        raise BadInput(f"edge {unplaced[0]!r} has no position in metres: call place_edges first.")
    sites = np.array([edge.position for edge in system.edges], dtype=np.float64)
    farthest_m = max(float(np.abs(positions).max()), float(np.abs(sites).max()))
    if farthest_m > MAX_COORDINATE_M:
        raise BadInput(f"a camera or edge is {farthest_m:.3g} m from the origin, expected at most {MAX_COORDINATE_M:g} m.")
    low, high = positions.min(axis=0), positions.max(axis=0)
    centre, side_m = (low + high) / 2, float((high - low).max()) or 1.0
    margin_m = MARGIN * side_m
    return _Plane(
        cameras=positions - centre,
        sites=separated_sites(sites - centre, side_m),
        outline=rectangle(low - centre - margin_m, high - centre + margin_m),
        centre=centre,
        side_m=side_m,
    )


def _partition(method: PlanMethod, plane: _Plane, tables: Sequence[EdgeTable], paper: PaperConfig) -> _Partition:
    num_cameras, num_edges = len(plane.cameras), len(plane.sites)
    if method == "paper":
        regions = paper_regions(plane.cameras, plane.sites, tables, paper.boundary_step * plane.side_m, paper)
        return _Partition(
            edge_of_camera=regions.edge_of_camera, weights=regions.weights, history=regions.history, converged=regions.converged
        )
    if method == "voronoi":
        weights = np.zeros(num_edges)
        return _Partition(edge_of_camera=assign(plane.cameras, plane.sites, weights), weights=weights)
    if method == "exact":
        counts, _ = fastest_counts(tables, num_cameras)
    else:
        counts = _even_counts(tables, num_cameras)
    squared_m2 = plane.squared_m2()
    edge_of_camera = assign_with_counts(squared_m2, counts)
    return _Partition(edge_of_camera=edge_of_camera, weights=separating_weights(squared_m2, edge_of_camera))


def _even_counts(tables: Sequence[EdgeTable], num_cameras: int) -> NDArray[np.int64]:
    slots, _ = earliest_slots([np.arange(1.0, table.capacity + 1) for table in tables], num_cameras)
    return np.bincount(slots, minlength=len(tables))


def _cloud_plan(
    method: PlanMethod, system: System, plane: _Plane, tables: Sequence[EdgeTable], partition: _Partition, threshold: float
) -> CloudPlan:
    counts = np.bincount(partition.edge_of_camera, minlength=len(tables))
    edge_time_s = np.array([table.edge_time_s[count] for table, count in zip(tables, counts, strict=True)])
    _, lower_bound_s = fastest_counts(tables, len(plane.cameras))
    makespan_s = float(edge_time_s.max())
    weights = _closed_where_unused(partition.weights, counts, plane)
    certified = is_certified(plane.cameras, plane.sites, weights, partition.edge_of_camera)
    status: PlanStatus = "stopped"
    if certified and makespan_s <= lower_bound_s:
        status = "optimal"
    elif partition.converged or (method != "paper" and makespan_s <= (1 + threshold) * lower_bound_s):
        status = "converged"
    return CloudPlan(
        method=method,
        edge_ids=tuple(edge.id for edge in system.edges),
        sites=plane.sites + plane.centre,
        weights=weights,
        borders=tuple(border + plane.centre for border in cell_polygons(plane.sites, weights, plane.outline)),
        edge_of_camera=partition.edge_of_camera,
        edge_time_s=edge_time_s,
        lower_bound_s=lower_bound_s,
        status=status,
        certified=certified,
        history=partition.history or (makespan_s,),
    )


def _closed_where_unused(weights: FloatArray, counts: NDArray[np.int64], plane: _Plane) -> FloatArray:
    """Weights (E,) under which edges without cameras own no land: nobody would have trained a model of it.

    ‖x − P_e‖² − ‖x − P_j‖² is linear in x, so an edge that loses to one used edge j at all corners loses everywhere;
    it loses by a squared side length more, which no rounding undoes.
    """
    weights = weights.copy()
    rival = int(counts.argmax())
    for edge in np.flatnonzero(counts == 0):
        to_edge, to_rival = (np.sum((plane.outline - plane.sites[index]) ** 2, axis=1) for index in (edge, rival))
        weights[edge] = min(weights[edge], weights[rival] + float((to_edge - to_rival).min()) - plane.side_m**2)
    return weights


def is_certified(cameras: FloatArray, sites: FloatArray, weights: FloatArray, edge_of_camera: NDArray[np.int64]) -> bool:
    """Whether every camera (C,2) m is in its own power cell within the tolerance; in blocks, as C × E may be large."""
    worst_m2, largest_m2 = 0.0, 0.0
    rows = max(1, MAX_EXACT_PAIRS // len(weights))
    for start in range(0, len(cameras), rows):
        block = slice(start, start + rows)
        squared_m2 = np.sum((cameras[block, None] - sites) ** 2, axis=-1)
        worst_m2 = max(worst_m2, largest_violation(squared_m2, weights, edge_of_camera[block]))
        largest_m2 = max(largest_m2, float(squared_m2.max()))
    return worst_m2 <= CERTIFICATE_TOLERANCE * largest_m2
