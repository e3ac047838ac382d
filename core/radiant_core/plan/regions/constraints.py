"""Decisions made before the planner runs: fixed weights, locked regions, pinned cameras.

    locked region    the cameras that the edge has in the plan to start from, and no others
    fixed weight     the edge's cell in the diagram to start from, with its weight replaced;
                     the cell's cameras and no others
    pinned camera    belongs to the edge it is pinned to, which may have others too

The other cameras are dealt among the edges that are neither locked nor fixed, with the counts of
the least makespan and the least Σ ‖camera − edge‖² for them. The weights drawn are those of that
dealing, shifted to fit between fixed and locked ones as well as they can: a camera may end outside
its cell, which the plan counts. Runs once per plan, and per frame of a drag.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.plan.counts.wide_deadline import FastestCounts, fastest_edge_counts, system_capacity, times_of_counts
from radiant_core.plan.regions.power_diagram import assign
from radiant_core.plan.regions.transport import deal_with_counts
from radiant_core.plan.system import System

Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]
NOBODY = -1
MAX_WEIGHT_M2 = 1e17
"""Ten times the square of the largest coordinate."""


@dataclass(frozen=True, kw_only=True)
class PlanConstraints:
    """What is given. Raises BadInput for weights that are not finite and for edges that are both
    fixed and locked."""

    fixed_weights_m2: Mapping[str, float] = field(default_factory=dict[str, float])
    """Weight per edge id, on the scale of the plan to start from."""
    locked: tuple[str, ...] = ()
    """Ids of edges whose cameras stay."""
    pinned: Mapping[int, str] = field(default_factory=dict[int, str])
    """Edge id per camera index."""

    def __post_init__(self) -> None:
        for edge, weight in self.fixed_weights_m2.items():
            if not (np.isfinite(weight) and abs(weight) <= MAX_WEIGHT_M2):
                raise BadInput(f"the weight of edge {edge!r} is fixed at {weight} m², expected a finite number up to {MAX_WEIGHT_M2:g}.")
        if len(set(self.locked)) != len(self.locked):
            raise BadInput(f"a region is locked twice among {', '.join(self.locked)}: name each edge once.")
        both = sorted(set(self.locked) & set(self.fixed_weights_m2))
        if both:
            raise BadInput(f"edge {both[0]!r} is locked and has a fixed weight: choose one of them.")
        wrong = [camera for camera in self.pinned if isinstance(camera, bool) or camera != int(camera) or camera < 0]
        if wrong:
            raise BadInput(f"camera {wrong[0]!r} is pinned, expected an index of at least 0.")

    def __bool__(self) -> bool:
        return bool(self.fixed_weights_m2 or self.locked or self.pinned)


@dataclass(frozen=True, kw_only=True, eq=False)
class Reference:
    """What constraints refer to: weights (E,) m², and the edge of each camera (C,), None without a
    plan to start from."""

    weights: FloatArray
    edge_of_camera: Indices | None


@dataclass(frozen=True, kw_only=True, eq=False)
class ConstrainedDealing:
    """The edge of each camera (C,), weights (E,) m², times (E,) s, the worst violation among what
    is free, the constraints in words."""

    edge_of_camera: Indices
    weights: FloatArray
    edge_time_s: FloatArray
    free_violation_m2: float
    sentences: tuple[str, ...]


def deal_around(
    cameras: FloatArray, sites: FloatArray, system: System, constraints: PlanConstraints, reference: Reference
) -> ConstrainedDealing | str:
    """Deal cameras (C,2) m to sites (E,2) m under constraints; a sentence where memory forbids it.
    Raises BadInput for unknown edges and cameras, for a locked region without a plan to start from,
    and for a camera of a locked region pinned elsewhere."""
    ids = [edge.id for edge in system.edges]
    fixed, locked = _flags(ids, tuple(constraints.fixed_weights_m2)), _flags(ids, constraints.locked)
    weights = reference.weights.copy()
    weights[fixed] = [constraints.fixed_weights_m2[name] for name, is_fixed in zip(ids, fixed, strict=True) if is_fixed]
    before = weights.copy()
    owner = _given_owners(cameras, sites, weights, ids, fixed, locked, constraints, reference)
    is_open = ~(fixed | locked)
    decided_counts = np.bincount(owner[owner >= 0], minlength=len(ids))
    free = np.flatnonzero(owner == NOBODY)
    open_counts = _open_counts(system, decided_counts, is_open, len(free))
    if isinstance(open_counts, str):
        return open_counts
    counts = open_counts.counts
    edges = np.flatnonzero(is_open)
    dealt = deal_with_counts(cameras[free], sites[edges], (counts - decided_counts)[edges], weights=weights[edges])
    owner[free] = edges[dealt.edge_of_position] if len(free) else owner[free]
    weights[edges] = dealt.weights
    has_free = np.zeros(len(ids), bool)
    has_free[edges] = (counts - decided_counts)[edges] > 0
    weights = _fit_weights(cameras, sites, weights, owner, free, (has_free, is_open, fixed, locked))
    # Fewer edges tie the weights less: where nothing changed, those of the reference fit better.
    weights = min((weights, before), key=lambda tried: _worst_violation(cameras, sites, tried, owner))
    words = _sentences(constraints, np.bincount(owner, minlength=len(ids)), ids)
    return ConstrainedDealing(
        edge_of_camera=owner, weights=weights, edge_time_s=open_counts.edge_time_s, free_violation_m2=dealt.violation_m2, sentences=words
    )


def counts_at_least(system: System, num_cameras: int, least: Indices) -> FastestCounts:
    """Counts (E,) of the smallest makespan, none below `least` (E,), which must fit. An edge that
    would get fewer keeps its least at any earlier deadline: the others are planned without it."""
    counts, times_s = least.copy(), np.zeros(len(least))
    active = np.ones(len(least), bool)
    while active.any():
        part = replace(system, edges=tuple(edge for edge, is_active in zip(system.edges, active, strict=True) if is_active))
        fastest = fastest_edge_counts(part, num_cameras - int(least[~active].sum()))
        rows = np.flatnonzero(active)
        counts[rows] = np.maximum(fastest.counts, least[rows])
        if (fastest.counts >= least[rows]).all():
            times_s[rows] = fastest.edge_time_s
            break
        active[rows[fastest.counts < least[rows]]] = False
    slow = np.flatnonzero(~active)
    if len(slow):
        times_s[slow] = times_of_counts(System(edges=tuple(system.edges[index] for index in slow)), least[slow])
    return FastestCounts(counts=counts, edge_time_s=times_s)


def _flags(ids: list[str], chosen: tuple[str, ...]) -> Flags:
    unknown = sorted(set(chosen) - set(ids))
    if unknown:
        raise BadInput(f"edge {unknown[0]!r} is constrained, but the system's edges are {', '.join(ids)}: correct its id.")
    return np.isin(ids, chosen)


def _given_owners(  # noqa: PLR0913
    cameras: FloatArray,
    sites: FloatArray,
    weights: FloatArray,
    ids: list[str],
    fixed: Flags,
    locked: Flags,
    constraints: PlanConstraints,
    reference: Reference,
) -> Indices:
    """The edge (C,) of every camera that the constraints decide, −1 of the others."""
    owner = np.full(len(cameras), NOBODY)
    if locked.any():
        if reference.edge_of_camera is None or len(reference.edge_of_camera) != len(cameras):
            start_plan = "none" if reference.edge_of_camera is None else f"one of {len(reference.edge_of_camera)}"
            raise BadInput(f"regions are locked, which needs a plan of these {len(cameras)} cameras to start from; {start_plan} was given.")
        owner = np.where(locked[reference.edge_of_camera], reference.edge_of_camera, owner)
    if fixed.any():
        cell = assign(cameras, sites, weights)
        owner = np.where((owner == NOBODY) & fixed[cell], cell, owner)
    for camera, name in constraints.pinned.items():
        if camera >= len(cameras):
            raise BadInput(f"camera {camera} is pinned, there are {len(cameras)}: count them from 0.")
        edge = int(np.flatnonzero(_flags(ids, (name,)))[0])
        if owner[camera] not in (NOBODY, edge) and locked[owner[camera]]:
            raise BadInput(
                f"camera {camera} is pinned to {name!r} and lies in the locked region of {ids[owner[camera]]!r}: drop one of them."
            )
        owner[camera] = edge
    return owner


def _open_counts(system: System, decided_counts: Indices, is_open: Flags, num_free: int) -> FastestCounts | str:
    """Cameras and time of every edge, or why there is no room."""
    num_cameras = int(decided_counts.sum()) + num_free
    for edge, count in zip(system.edges, decided_counts, strict=True):
        # A limit is at least as large as the cameras where the devices' own limits together are.
        if count and count > (edge_capacity := system_capacity(System(edges=(edge,)), num_cameras)):
            return f"the constraints give edge {edge.id!r} {count} cameras, it can hold {edge_capacity}: unlock or unpin some."
    closed, times_s = np.flatnonzero(~is_open), np.zeros(len(decided_counts))
    if len(closed):
        times_s[closed] = times_of_counts(System(edges=tuple(system.edges[index] for index in closed)), decided_counts[closed])
    if not is_open.any():
        if num_free:
            return f"all edges are locked or fixed and {num_free} cameras lie in none of their regions: free an edge."
        return FastestCounts(counts=decided_counts, edge_time_s=times_s)
    part = System(edges=tuple(edge for edge, chosen in zip(system.edges, is_open, strict=True) if chosen))
    wanted = int(decided_counts[is_open].sum()) + num_free
    if (capacity := system_capacity(part, num_cameras)) < wanted:
        return f"the edges that are neither locked nor fixed can hold {capacity} of the {wanted} cameras left to them: free more edges."
    counts = decided_counts.copy()
    fastest = counts_at_least(part, wanted, decided_counts[is_open])
    counts[is_open], times_s[is_open] = fastest.counts, fastest.edge_time_s
    return FastestCounts(counts=counts, edge_time_s=times_s)


def _fit_weights(
    cameras: FloatArray, sites: FloatArray, weights: FloatArray, owner: Indices, free: Indices, groups: tuple[Flags, Flags, Flags, Flags]
) -> FloatArray:
    """Weights (E,) in which open edges stand to fixed ones, and locked edges to all, so that the
    worst camera misses least."""
    has_free, is_open, fixed, locked = groups
    weights = weights.copy()
    settled = has_free.copy()
    for edge in np.flatnonzero(is_open & ~has_free):
        # Only pinned cameras: as much land as takes no free camera away.
        powers = _least_powers(cameras[free], sites, weights, settled)
        weights[edge] = float((np.sum((cameras[free] - sites[edge]) ** 2, axis=1) - powers).min()) if len(free) else 0.0
    settled |= is_open
    if fixed.any() and settled.any():
        inside = np.zeros(len(cameras), bool)
        inside[free] = True
        weights[settled] += _shift(cameras, sites, weights, (inside, settled), (fixed[owner], fixed))
    settled |= fixed
    for edge in np.flatnonzero(locked):
        is_edge = np.arange(len(weights)) == edge
        if settled.any():
            weights[edge] += _shift(cameras, sites, weights, (owner == edge, is_edge), (settled[owner], settled))
        settled |= is_edge
    return weights


def _shift(cameras: FloatArray, sites: FloatArray, weights: FloatArray, ours: tuple[Flags, Flags], theirs: tuple[Flags, Flags]) -> float:
    """By how much to raise our edges' weights: midway between what our cameras need at least and
    theirs allow; (cameras, edges) flags."""
    (our_cameras, our_edges), (their_cameras, their_edges) = ours, theirs
    gap = [
        _least_powers(cameras[chosen], sites, weights, our_edges) - _least_powers(cameras[chosen], sites, weights, their_edges)
        for chosen in (our_cameras, their_cameras)
    ]
    least, most = float(gap[0].max(initial=-np.inf)), float(gap[1].min(initial=np.inf))
    if np.isfinite(least) and np.isfinite(most):
        return (least + most) / 2
    return least if np.isfinite(least) else most if np.isfinite(most) else 0.0


def _worst_violation(cameras: FloatArray, sites: FloatArray, weights: FloatArray, owner: Indices) -> float:
    powers = np.sum((cameras - sites[owner]) ** 2, axis=1) - weights[owner]
    return float((powers - _least_powers(cameras, sites, weights, np.ones(len(sites), bool))).max())


def _least_powers(cameras: FloatArray, sites: FloatArray, weights: FloatArray, edges: Flags) -> FloatArray:
    """min over the flagged edges of ‖x − P_e‖² − w_e for cameras (K,2), inf without edges."""
    if not edges.any() or not len(cameras):
        return np.full(len(cameras), np.inf)
    chosen = np.flatnonzero(edges)[assign(cameras, np.ascontiguousarray(sites[edges]), np.ascontiguousarray(weights[edges]))]
    return np.sum((cameras - sites[chosen]) ** 2, axis=1) - weights[chosen]


def _sentences(constraints: PlanConstraints, counts: Indices, ids: list[str]) -> tuple[str, ...]:
    number = dict(zip(ids, counts.tolist(), strict=True))
    return (
        *(
            f"weight of edge {name!r} fixed at {weight:g} m²: {number[name]} cameras"
            for name, weight in constraints.fixed_weights_m2.items()
        ),
        *(f"region of edge {name!r} locked: {number[name]} cameras" for name in constraints.locked),
        *([f"cameras pinned: {len(constraints.pinned)}"] if constraints.pinned else []),
    )
