"""Regions of the edges (paper Sec. III-B, ARP): who owns which cameras for the least makespan.

In the paper's cost model an edge's time depends on its region only through its number of cameras.
So the best counts are found first, without geography (`deadline`); then the cameras are dealt to
the edges with exactly these counts and the least Σ ‖camera − edge‖² (`transport`): a power diagram
of the edge positions (Aurenhammer, Hoffmann, Aronov, Algorithmica 1998), hence convex, disjoint,
covering regions at the geography-free lower bound.

    exact          counts with the smallest makespan: optimal in this model, with a certificate
    even           as many cameras for every device as the memory limits allow (`even_shares`)
    paper          Alg. 1, moving borders by a fixed step (`paper_arp`)
    paper-literal  Alg. 1 as written, a camera in no region to the nearest edge (`other_splits`)

The regions of the last are no power cells: they are drawn and joined by the power diagram of their
cameras' means with their counts, and the plan says how many cameras lie outside of it.

Runs once per plan.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core.choices import PlanMethod
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array
from radiant_core.plan.counts.deadline import edge_tables
from radiant_core.plan.counts.slack import capacities_within
from radiant_core.plan.counts.wide_deadline import FastestCounts, cached_edge_counts, fastest_edge_counts, system_capacity, times_of_counts
from radiant_core.plan.devices.even_shares import even_edge_counts, even_times_s
from radiant_core.plan.plans import CloudPlan, PlanStatus
from radiant_core.plan.regions.capped_transport import deal_within
from radiant_core.plan.regions.constraints import PlanConstraints, Reference, deal_around
from radiant_core.plan.regions.edge_sites import require_within_reach, separate_sites
from radiant_core.plan.regions.other_splits import half_planes
from radiant_core.plan.regions.paper_arp import paper_regions
from radiant_core.plan.regions.paper_config import PaperConfig
from radiant_core.plan.regions.power_diagram import assign, bounds, cell_polygons, rectangle
from radiant_core.plan.regions.transport import deal_with_counts, violations
from radiant_core.plan.system import System

_BLOCK_PAIRS = 500_000
MARGIN = 0.1
"""Width of land beyond the outermost cameras that still belongs to a region, as a share of their
bounding box's longer side."""
CERTIFICATE_TOLERANCE = 1e-12
"""A camera may miss its cell by this share of the largest squared distance: thousands of roundings,
below a micrometre per km."""


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
    """Cameras (C,2), sites (E,2), the cameras' bounding box (4,2) and the same with a margin,
    `outline`, in metres about `centre` (2,); side_m: the box's longer side, 1 for one spot."""

    cameras: FloatArray
    sites: FloatArray
    outline: FloatArray
    box: FloatArray
    centre: FloatArray
    side_m: float


@dataclass(frozen=True, kw_only=True, eq=False)
class _Partition:
    edge_of_camera: NDArray[np.int64]
    weights: FloatArray
    history: tuple[float, ...] = ()
    converged: bool = False
    violation_m2: float | None = None
    """By how much the worst camera misses its cell, None where it was not computed."""
    aim: Literal["slack", "constrained"] | None = None
    """None: the bound."""
    sentences: tuple[str, ...] = ()
    edge_time_s: FloatArray | None = None
    """Where it is known already."""


def plan_regions(  # noqa: PLR0913
    positions: ArrayLike,
    system: System,
    *,
    method: PlanMethod = "exact",
    paper: PaperConfig | None = None,
    start: CloudPlan | None = None,
    tolerance: float = 0.0,
    slack: float | None = None,
    constraints: PlanConstraints | None = None,
) -> CloudPlan | PlanInfeasible:
    """Regions for cameras (C,2) m by one of the methods above; edges were placed (`place_edges`).

    status: optimal = the lower bound with a certificate; converged = within the paper's threshold
    (of the bound, for methods that do not iterate); stopped otherwise. `start`: a plan of nearly
    the same input for `exact` to start from. `tolerance`: `exact` leaves every camera at its
    nearest edge where that is slower than the bound by this share at most. `slack` ≥ 1: `exact` may
    take this many times the bound if that shortens Σ distance² (`slack.py`); `constraints`: `exact`
    plans around them. Raises BadInput for a tolerance or slack out of range, both or constraints
    with them, and for positions that are not finite, none, or beyond 1e8 m.
    """
    _require_options(method, tolerance, slack, constraints)
    plane = _plane(positions, system)
    num_cameras = len(plane.cameras)
    capacity = system_capacity(system, num_cameras)
    if capacity < num_cameras:
        reason = f"the devices can hold {capacity} of {num_cameras} cameras: raise max_cameras or add devices."
        return PlanInfeasible(method=method, num_cameras=num_cameras, capacity=capacity, reason=reason)
    paper = paper or PaperConfig()
    fastest = (cached_edge_counts if constraints else fastest_edge_counts)(system, num_cameras)
    nearest = _nearest_if_good(plane, system, fastest, tolerance) if method == "exact" and tolerance > 0 else None
    if constraints:
        dealt = _constrained_partition(plane, system, fastest, constraints, start)
        if isinstance(dealt, str):
            return PlanInfeasible(method=method, num_cameras=num_cameras, capacity=capacity, reason=dealt)
        partition = dealt
    elif slack is not None:
        partition = _slack_partition(plane, system, fastest, slack)
    elif nearest is not None:
        partition = nearest
    elif method == "exact":
        partition = _exact_partition(plane, fastest.counts, start)
    elif method == "paper-literal":
        plane, partition = _literal_partition(plane, system, paper, float(fastest.edge_time_s.max()))
    else:
        partition = _partition(method, plane, system, paper)
    counts = np.bincount(partition.edge_of_camera, minlength=len(system.edges))
    for edge, count in zip(system.edges, counts, strict=True):
        if count > (edge_capacity := system_capacity(System(edges=(edge,)), num_cameras)):
            reason = f"method {method} gives edge {edge.id!r} {count} cameras, it can hold {edge_capacity}: use method exact."
            return PlanInfeasible(method=method, num_cameras=num_cameras, capacity=capacity, reason=reason)
    plan = _cloud_plan(method, system, plane, partition, fastest, paper.threshold)
    return replace(plan, slack=slack)


def regions_around(positions: ArrayLike, edge_of_camera: NDArray[np.int64], system: System) -> CloudPlan:
    """Regions for cameras (C,2) m that already belong to edges (C,): every place belongs to the
    edge whose cameras' mean is nearest, none to an edge without cameras. The lower bound is that of
    the same counts of cameras dealt freely, 0 where memory forbids it."""
    positions = check_array("positions", positions, (len(edge_of_camera), 2))
    plane = _plane(positions, _at_means(positions, edge_of_camera, system))
    fits = system_capacity(system, len(positions)) >= len(positions)
    bound_s = float(fastest_edge_counts(system, len(positions)).edge_time_s.max()) if fits else 0.0
    return _regions_of_owners(plane, system, edge_of_camera, np.zeros(len(system.edges)), bound_s)


def regions_with_counts(positions: ArrayLike, edge_of_camera: NDArray[np.int64], system: System) -> CloudPlan:
    """Regions for cameras (C,2) m that belong to edges (C,): the power diagram of the edges' mean
    cameras with as many in each cell, though not always the same ones. Times and the lower bound
    are left at 0."""
    positions = check_array("positions", positions, (len(edge_of_camera), 2))
    counts = np.bincount(edge_of_camera, minlength=len(system.edges))
    plane = _plane(positions, _at_means(positions, edge_of_camera, system))
    return _regions_of_owners(plane, system, edge_of_camera, _exact_partition(plane, counts, None).weights, 0.0)


def _regions_of_owners(
    plane: _Plane, system: System, edge_of_camera: NDArray[np.int64], weights: FloatArray, lower_bound_s: float
) -> CloudPlan:
    """The power diagram of the plane's sites and weights (E,) for cameras owned by edges (C,)."""
    weights = _close_unused(weights, np.bincount(edge_of_camera, minlength=len(weights)), plane)
    return CloudPlan(
        method="captured",
        edge_ids=tuple(edge.id for edge in system.edges),
        sites=plane.sites + plane.centre,
        weights=weights,
        borders=tuple(border + plane.centre for border in cell_polygons(plane.sites, weights, plane.outline)),
        edge_of_camera=edge_of_camera,
        edge_time_s=np.zeros(len(weights)),
        lower_bound_s=lower_bound_s,
        status="stopped",
        certified=False,
    )


def _at_means(positions: FloatArray, edge_of_camera: NDArray[np.int64], system: System) -> System:
    """The system with every edge at the mean of its cameras, of all where it has none."""
    counts = np.bincount(edge_of_camera, minlength=len(system.edges))
    means = [positions[edge_of_camera == index].mean(axis=0) if count else positions.mean(axis=0) for index, count in enumerate(counts)]
    return System(edges=tuple(replace(edge, position=(float(x), float(y))) for edge, (x, y) in zip(system.edges, means, strict=True)))


def _plane(positions: ArrayLike, system: System) -> _Plane:
    positions = check_array("positions", positions, (None, 2))
    if not len(positions):
        raise BadInput("positions holds no camera: give at least one.")
    unplaced = [edge.id for edge in system.edges if edge.position is None]
    if unplaced:
        raise BadInput(f"edge {unplaced[0]!r} has no position in metres: call place_edges first.")
    sites = np.array([edge.position for edge in system.edges], dtype=np.float64)
    require_within_reach(positions, sites)
    low, high = bounds(positions)
    centre, side_m = (low + high) / 2, float((high - low).max()) or 1.0
    margin_m = MARGIN * side_m
    return _Plane(
        cameras=positions - centre,
        sites=separate_sites(sites - centre, side_m),
        outline=rectangle(low - centre - margin_m, high - centre + margin_m),
        box=rectangle(low - centre, high - centre),
        centre=centre,
        side_m=side_m,
    )


def _exact_partition(plane: _Plane, counts: NDArray[np.int64], start: CloudPlan | None) -> _Partition:
    weights = None if start is None or len(start.weights) != len(counts) else start.weights
    dealt = deal_with_counts(plane.cameras, plane.sites, counts, weights=weights)
    return _Partition(edge_of_camera=dealt.edge_of_position, weights=dealt.weights, violation_m2=dealt.violation_m2)


def _require_options(method: PlanMethod, tolerance: float, slack: float | None, constraints: PlanConstraints | None) -> None:
    if not (np.isfinite(tolerance) and tolerance >= 0):
        raise BadInput(f"tolerance is {tolerance}, expected a finite share of at least 0.")
    if method not in get_args(PlanMethod):
        raise BadInput(f"plan method {method!r} is unknown: use one of {', '.join(get_args(PlanMethod))}.")
    if slack is not None and not (np.isfinite(slack) and slack >= 1):
        raise BadInput(f"slack is {slack}, expected a finite factor of at least 1 on the shortest makespan.")
    chosen = [
        name for name, is_set in (("tolerance", tolerance > 0), ("slack", slack is not None), ("constraints", bool(constraints))) if is_set
    ]
    if len(chosen) > 1:
        raise BadInput(f"{' and '.join(chosen)} are given together: choose one of them.")
    if chosen and method != "exact":
        raise BadInput(f"{chosen[0]} is for method exact, the method is {method}: leave one of them out.")


def _slack_partition(plane: _Plane, system: System, fastest: FastestCounts, slack: float) -> _Partition:
    """The least Σ distance² within slack times the bound; never fewer places than the fastest
    counts, whatever rounding says."""
    capacities = capacities_within(system, len(plane.cameras), slack * float(fastest.edge_time_s.max()))
    dealt = deal_within(plane.cameras, plane.sites, np.maximum(capacities, fastest.counts))
    return _Partition(edge_of_camera=dealt.edge_of_position, weights=dealt.weights, violation_m2=dealt.violation_m2, aim="slack")


def _constrained_partition(
    plane: _Plane, system: System, fastest: FastestCounts, constraints: PlanConstraints, start: CloudPlan | None
) -> _Partition | str:
    """The plan around constraints, on the weights of the plan to start from or of the exact one; a
    sentence where there is none."""
    if start is not None and start.edge_ids != tuple(edge.id for edge in system.edges):
        raise BadInput(f"the plan to start from has edges {', '.join(start.edge_ids)}, the system others: give one of this system.")
    weights = _exact_partition(plane, fastest.counts, None).weights if start is None and constraints.fixed_weights_m2 else None
    reference = Reference(
        weights=start.weights if start is not None else np.zeros(len(plane.sites)) if weights is None else weights,
        edge_of_camera=None if start is None else start.edge_of_camera,
    )
    dealt = deal_around(plane.cameras, plane.sites, system, constraints, reference)
    if isinstance(dealt, str):
        return dealt
    free = "hold" if dealt.free_violation_m2 <= CERTIFICATE_TOLERANCE * _largest_m2(plane) else "do not hold"
    sentence = f"the certificate's conditions {free} among the cameras and edges that are free"
    return _Partition(
        edge_of_camera=dealt.edge_of_camera,
        weights=dealt.weights,
        aim="constrained",
        sentences=(*dealt.sentences, sentence),
        edge_time_s=dealt.edge_time_s,
    )


def _largest_m2(plane: _Plane) -> float:
    """The largest squared distance of an edge to a corner of the cameras' bounding box."""
    return max(float(np.sum((plane.sites - corner) ** 2, axis=1).max()) for corner in plane.box)


def _nearest_if_good(plane: _Plane, system: System, fastest: FastestCounts, tolerance: float) -> _Partition | None:
    """The Voronoi partition where its makespan is within the tolerance of the bound, else None."""
    weights = np.zeros(len(plane.sites))
    edge_of_camera = assign(plane.cameras, plane.sites, weights)
    counts = np.bincount(edge_of_camera, minlength=len(weights))
    if any(count > system_capacity(System(edges=(edge,)), len(plane.cameras)) for edge, count in zip(system.edges, counts, strict=True)):
        return None
    good = float(times_of_counts(system, counts).max()) <= (1 + tolerance) * float(fastest.edge_time_s.max())
    return _Partition(edge_of_camera=edge_of_camera, weights=weights) if good else None


def _partition(method: PlanMethod, plane: _Plane, system: System, paper: PaperConfig) -> _Partition:
    num_cameras = len(plane.cameras)
    if method == "paper":
        tables = edge_tables(system, num_cameras)
        regions = paper_regions(plane.cameras, plane.sites, tables, paper.boundary_step * plane.side_m, paper)
        return _Partition(
            edge_of_camera=regions.edge_of_camera, weights=regions.weights, history=regions.history, converged=regions.converged
        )
    counts = even_edge_counts(system, num_cameras)
    return replace(_exact_partition(plane, counts, None), edge_time_s=even_times_s(system, counts))


def _literal_partition(plane: _Plane, system: System, paper: PaperConfig, bound_s: float) -> tuple[_Plane, _Partition]:
    """The cells of Alg. 1 as written, and the plane whose sites are their cameras' means."""
    tables, step_m = edge_tables(system, len(plane.cameras)), paper.boundary_step * plane.side_m
    cells, _ = half_planes(plane.cameras, plane.sites, tables, step_m, paper.threshold * bound_s, paper.max_iterations)
    edge_of_camera = np.where(cells < 0, assign(plane.cameras, plane.sites, np.zeros(len(plane.sites))), cells)
    placed = _plane(plane.cameras + plane.centre, _at_means(plane.cameras + plane.centre, edge_of_camera, system))
    counts = np.bincount(edge_of_camera, minlength=len(system.edges))
    weights = _exact_partition(placed, counts, None).weights
    return placed, _Partition(edge_of_camera=edge_of_camera, weights=weights)


def _cloud_plan(
    method: PlanMethod, system: System, plane: _Plane, partition: _Partition, fastest: FastestCounts, threshold: float
) -> CloudPlan:
    counts = np.bincount(partition.edge_of_camera, minlength=len(system.edges))
    edge_time_s = partition.edge_time_s
    if method != "even" and np.array_equal(counts, fastest.counts):
        edge_time_s = fastest.edge_time_s
    if edge_time_s is None:
        edge_time_s = times_of_counts(system, counts)
    lower_bound_s = float(fastest.edge_time_s.max())
    makespan_s = float(edge_time_s.max())
    weights = _close_unused(partition.weights, counts, plane)
    num_outside = 0
    if partition.violation_m2 is None:
        num_outside = num_cameras_outside(plane.cameras, plane.sites, weights, partition.edge_of_camera)
        certified = num_outside == 0
    else:
        # Edges without cameras were left out there; they lose everywhere by construction.
        certified = partition.violation_m2 <= CERTIFICATE_TOLERANCE * _largest_m2(plane)
    status: PlanStatus = "stopped"
    if certified and makespan_s <= lower_bound_s:
        status = "optimal"
    elif partition.aim == "constrained" or (partition.aim == "slack" and certified):
        status = partition.aim
    elif partition.converged or (not method.startswith("paper") and makespan_s <= (1 + threshold) * lower_bound_s):
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
        constrained=partition.sentences,
        num_outside=num_outside,
    )


def _close_unused(weights: FloatArray, counts: NDArray[np.int64], plane: _Plane) -> FloatArray:
    """Weights (E,) under which edges without cameras own no land, as no model of it would be
    trained. ‖x − P_e‖² − ‖x − P_j‖² is linear in x: an edge that loses to one used edge j at all
    corners loses everywhere; it loses by a squared side length more, which no rounding undoes."""
    weights = weights.copy()
    largest = int(counts.argmax())
    for edge in np.flatnonzero(counts == 0):
        to_edge, to_largest = (np.sum((plane.outline - plane.sites[index]) ** 2, axis=1) for index in (edge, largest))
        weights[edge] = min(weights[edge], weights[largest] + float((to_edge - to_largest).min()) - plane.side_m**2)
    return weights


def is_certified(cameras: FloatArray, sites: FloatArray, weights: FloatArray, edge_of_camera: NDArray[np.int64]) -> bool:
    """Whether every camera (C,2) m is in its own power cell within the tolerance."""
    return num_cameras_outside(cameras, sites, weights, edge_of_camera) == 0


def num_cameras_outside(cameras: FloatArray, sites: FloatArray, weights: FloatArray, edge_of_camera: NDArray[np.int64]) -> int:
    """Cameras (C,2) m outside their power cells by more than the tolerance; C × E in blocks."""
    missed_m2, largest_m2 = np.zeros(len(cameras)), 0.0
    rows = max(1, _BLOCK_PAIRS // len(weights))
    for start in range(0, len(cameras), rows):
        block = slice(start, start + rows)
        squared_m2 = np.sum((cameras[block, None] - sites) ** 2, axis=-1)
        missed_m2[block] = violations(squared_m2, weights, edge_of_camera[block])
        largest_m2 = max(largest_m2, float(squared_m2.max()))
    return int((missed_m2 > CERTIFICATE_TOLERANCE * largest_m2).sum())
