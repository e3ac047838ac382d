"""Revises a plan after a change of the fleet: machines that died, are slow or busy, or joined.

First the least makespan, then the fewest positions that change their device, then geography:
    minimise Σ_moved ‖x − centre of the new device‖² − ‖x − centre of the old one‖²
with the quotas of `replan_counts`: a transport problem, solved by the native module where one
device loses or all that lose give up everything, as a linear program (HiGHS; a network's corners
are whole numbers) for up to 40,000 arcs, else device by device, those that give up everything
together. Captured positions and those of a device that is done never move; on a dead device
captured ones are lost. Regions stay where no position changed its edge, else they are the power
diagram of the edges' mean positions with the new counts: the edges' own places would draw regions
that others train in. Runs once per re-plan.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse  # pyright: ignore[reportMissingTypeStubs]

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array
from radiant_core.plan.devices.device_split import long_axis
from radiant_core.plan.plans import CloudPlan, EdgePlan, require_plan_of
from radiant_core.plan.regions.edge_sites import separate_sites
from radiant_core.plan.regions.region_plan import is_certified, regions_with_counts
from radiant_core.plan.regions.transport import deal_with_counts
from radiant_core.plan.revision.assigned import hull_of
from radiant_core.plan.revision.captured import device_of_planned, require_same_system
from radiant_core.plan.revision.replan_counts import ROUNDING, EdgeLoad, MachineLoad, SolvedCounts, solve_counts
from radiant_core.plan.system import Edge, System

Indices = NDArray[np.int64]
MAX_ARCS = 40_000
"""HiGHS took 8 s for 113,000."""


@dataclass(frozen=True, kw_only=True)
class FleetChange:
    """What has changed since the plan was made, by ids; an edge stands for all its devices."""

    dead: frozenset[str] = frozenset()
    """Lost with what they captured; their other positions go to other devices."""
    done: frozenset[str] = frozenset()
    """Finished: their positions stay and none is added. A done edge has delivered."""
    closed: frozenset[str] = frozenset()
    """Devices that keep exactly the positions they have and work until `busy_s`."""
    slow: Mapping[str, float] = field(default_factory=dict[str, float])
    """Factor on their times to initialise and train (of an edge: to aggregate too)."""
    busy_s: Mapping[str, float] = field(default_factory=dict[str, float])
    """Seconds for which devices are busy before this plan begins."""

    def __post_init__(self) -> None:
        for name, factor in self.slow.items():
            if not (np.isfinite(factor) and 0 < factor <= 1e6):
                raise BadInput(f"{name!r} is slow by {factor}, expected a finite factor above 0: 2 means twice the time.")
        for name, seconds in self.busy_s.items():
            if not (np.isfinite(seconds) and seconds >= 0):
                raise BadInput(f"{name!r} is busy for {seconds} s, expected a finite time of at least 0.")
        both = sorted(self.dead & (self.done | self.closed))
        if both:
            raise BadInput(f"{both[0]!r} is given as dead and as done or at work: give one of them.")


@dataclass(frozen=True, kw_only=True)
class ReplanInfeasible:
    """The machines that are left cannot hold what is left."""

    num_positions: int
    capacity: int
    """Positions that all living devices can hold, with what they have."""
    reason: str
    status: str = "infeasible"


@dataclass(frozen=True, kw_only=True, eq=False)
class Replan:
    """The new plan, of `system`, and what it changes. P positions, D devices of all its edges."""

    system: System
    cloud: CloudPlan
    edges: tuple[EdgePlan, ...]
    device_before: Indices
    """(P,)"""
    device_after: Indices
    """(P,)"""
    lost: NDArray[np.bool_]
    """(P,) captured by a device that is dead: no device trains on them."""
    time_before_s: FloatArray
    """(D,) as things are now if nothing moves; inf for a dead device with positions to capture."""
    time_after_s: FloatArray
    """(D,)"""
    makespan_before_s: float
    """If nothing moves: inf where a dead device has positions to capture."""
    fewest_proved: bool
    """Whether fewer moves were proved impossible at this makespan."""

    @property
    def moved(self) -> NDArray[np.bool_]:
        """(P,) which positions change their device."""
        return self.device_after != self.device_before


def extend_system(system: System, joining: System) -> System:
    """The system with further edges, or further devices at edges it has; BadInput where an id comes
    twice or nothing joins."""
    new = {edge.id: edge for edge in joining.edges}
    edge_ids = {edge.id for edge in system.edges}
    grown = tuple(replace(edge, devices=(*edge.devices, *(new[edge.id].devices if edge.id in new else ()))) for edge in system.edges)
    return replace(system, edges=(*grown, *(edge for edge in joining.edges if edge.id not in edge_ids)))


def replan(  # noqa: PLR0913
    cloud_plan: CloudPlan,
    edge_plans: Sequence[EdgePlan],
    positions: ArrayLike,
    system: System,
    change: FleetChange,
    *,
    captured: ArrayLike | None = None,
    joining: System | None = None,
    tolerance: float = 0.0,
) -> Replan | ReplanInfeasible:
    """The new plan of positions (P,2) m, or of where they look if the old one was cut by that;
    captured (P,) bool, none without it; tolerance: share by
    which the makespan may exceed the least, to move fewer. Every edge of `system` and `joining`
    needs a position. Raises BadInput when plan, positions and system do not belong together, for
    unknown ids and tolerance < 0."""
    positions = cloud_plan.places_of(check_array("positions", positions, (len(cloud_plan.edge_of_camera), 2)))
    fixed = np.zeros(len(positions), bool) if captured is None else check_array("captured", captured, (len(positions),), np.int64) > 0
    if not (np.isfinite(tolerance) and tolerance >= 0):
        raise BadInput(f"tolerance is {tolerance}, expected a finite share of at least 0.")
    require_plan_of(len(positions), cloud_plan, edge_plans)
    require_same_system(edge_plans, system)
    before = _renumber_devices(device_of_planned(edge_plans, len(positions)), system, joining)
    grown = system if joining is None else extend_system(system, joining)
    if unplaced := [edge.id for edge in grown.edges if edge.position is None]:
        raise BadInput(f"edge {unplaced[0]!r} has no position in metres: call place_edges first.")
    change = _expand_edges(change, grown)
    slowed = _slow_down(grown, change)
    dead = np.array([device.id in change.dead for device in slowed.devices])
    closed = np.array([device.id in (change.closed | change.done) for device in slowed.devices])
    lost = dead[before] & fixed
    must_stay = fixed | closed[before]
    must_go = dead[before] & ~fixed
    loads = _loads(slowed, change, before, (must_stay, lost), positions, positions[must_go])
    num_positions = int((~lost).sum())
    if not num_positions:
        reason = f"all {len(lost)} positions were captured by devices that are dead: plan them anew."
        return ReplanInfeasible(num_positions=len(lost), capacity=0, reason=reason)
    solved_counts = solve_counts(loads, num_positions, tolerance)
    if solved_counts is None:
        return _infeasible(loads, num_positions)
    quotas = _per_device(slowed, change, solved_counts)
    after = _deal(positions, before, must_stay, quotas, slowed)
    return _result(cloud_plan, edge_plans, positions, slowed, change, (before, after, lost), (loads, solved_counts))


def _expand_edges(change: FleetChange, system: System) -> FleetChange:
    """The change with edge ids replaced by those of devices (done edges stay too)."""
    members = {edge.id: {device.id for device in edge.devices} for edge in system.edges}
    devices = {device.id for device in system.devices}
    for name in (*change.dead, *change.done, *change.closed, *change.slow, *change.busy_s):
        if name not in devices and name not in members:
            raise BadInput(f"there is no device or edge {name!r}: there are {', '.join(sorted(devices))}, of {', '.join(members)}.")

    def spread(names: frozenset[str]) -> frozenset[str]:
        return names.union(*(members[name] for name in names if name not in devices))

    busy_s = {device: seconds for name, seconds in change.busy_s.items() for device in ({name} & devices or members[name])}
    devices_by_state = {name: spread(getattr(change, name)) for name in ("dead", "done", "closed")}
    return replace(change, busy_s=busy_s, **devices_by_state)


def _slow_down(system: System, change: FleetChange) -> System:
    def slow_down_edge(edge: Edge) -> Edge:
        whole = change.slow.get(edge.id, 1.0)
        factors = [whole * change.slow.get(device.id, 1.0) if device.id != edge.id else whole for device in edge.devices]
        devices = tuple(
            replace(device, init_s=device.init_s.scaled(factor), train_s=device.train_s.scaled(factor))
            for device, factor in zip(edge.devices, factors, strict=True)
        )
        return replace(edge.with_aggregation_scaled(whole), devices=devices)

    return replace(system, edges=tuple(slow_down_edge(edge) for edge in system.edges))


def _renumber_devices(device_of_position: Indices, system: System, joining: System | None) -> Indices:
    if joining is None:
        return device_of_position
    index_of = {device.id: index for index, device in enumerate(extend_system(system, joining).devices)}
    return np.array([index_of[device.id] for device in system.devices])[device_of_position]


def _loads(
    system: System,
    change: FleetChange,
    before: Indices,
    marks: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    positions: FloatArray,
    leaving: FloatArray,
) -> list[EdgeLoad]:
    """The positions that every living device holds, keeps and may take."""
    must_stay, lost = marks
    now = np.bincount(before[~lost], minlength=len(system.devices))
    fixed = np.bincount(before[must_stay & ~lost], minlength=len(system.devices))
    middle = leaving.mean(axis=0) if len(leaving) else positions.mean(axis=0)
    loads: list[EdgeLoad] = []
    first = 0
    for edge in system.edges:
        machines: list[MachineLoad] = []
        for index, device in enumerate(edge.devices, start=first):
            if device.id not in change.dead:
                most = len(positions) if device.max_cameras is None else device.max_cameras
                is_done = device.id in change.done
                machines.append(
                    MachineLoad(
                        device=device,
                        now=int(now[index]),
                        fixed=int(fixed[index]),
                        most=max(most, int(fixed[index])),
                        busy_s=0.0 if is_done else change.busy_s.get(device.id, 0.0),
                        closed=is_done or device.id in change.closed,
                    )
                )
        first += len(edge.devices)
        distance_m = float(np.hypot(*(np.array(edge.position) - middle)))
        loads.append(EdgeLoad(edge=edge, machines=tuple(machines), distance_m=distance_m, finished=edge.id in change.done))
    return loads


def _infeasible(loads: Sequence[EdgeLoad], num_positions: int) -> ReplanInfeasible:
    room = [machine.fixed if machine.closed or load.finished else machine.most for load in loads for machine in load.machines]
    capacity = sum(min(most, num_positions) for most in room)
    reason = f"the machines that are left can hold {capacity} of {num_positions} positions: let more join, or raise max_cameras."
    return ReplanInfeasible(num_positions=num_positions, capacity=capacity, reason=reason)


def _per_device(system: System, change: FleetChange, solved_counts: SolvedCounts) -> Indices:
    quotas: list[int] = []
    for edge, living in zip(system.edges, solved_counts.quotas, strict=True):
        living_quotas = iter(living)
        quotas += [0 if device.id in change.dead else next(living_quotas) for device in edge.devices]
    return np.array(quotas)


def _deal(positions: FloatArray, before: Indices, must_stay: NDArray[np.bool_], quotas: Indices, system: System) -> Indices:
    """Device (P,) of every position: quotas (D,) kept, with the fewest moves, to near devices."""
    counts_before = np.bincount(before, minlength=len(quotas))
    lost = np.bincount(before[must_stay], minlength=len(quotas)) * (quotas == 0)
    gains, losses = np.maximum(0, quotas - counts_before), np.maximum(0, counts_before - lost - quotas)
    after = before.copy()
    if not gains.any():
        return after
    centres = _centres(positions, before, system)
    candidates = np.flatnonzero((losses[before] > 0) & ~must_stay)
    after[candidates] = _transport(positions[candidates], before[candidates], centres, gains, losses)
    return _deal_new_in_strips(positions, before, after, counts_before, system)


def _centres(positions: FloatArray, before: Indices, system: System) -> FloatArray:
    """Mean position (D,2) of each device's positions, the edge's own where it has none."""
    of_edge = np.array([edge.position for edge in system.edges for _ in edge.devices], np.float64)
    counts = np.bincount(before, minlength=len(of_edge))
    sums = np.stack([np.bincount(before, weights=axis, minlength=len(of_edge)) for axis in positions.T], axis=1)
    return np.where(counts[:, None] > 0, sums / np.maximum(counts, 1)[:, None], of_edge)


def _transport(points: FloatArray, owners: Indices, centres: FloatArray, gains: Indices, losses: Indices) -> Indices:
    """New owners (K,) of points (K,2): losses[n] of device n leave, gains[n] arrive, at the least
    squared distance."""
    receivers = np.flatnonzero(gains)
    losers = np.unique(owners)
    all_leave = len(points) == losses[losers].sum()
    if all_leave or len(losers) == 1:
        stay = np.zeros(0, np.int64) if all_leave else losers
        counts = np.concatenate([gains[receivers], len(points) - losses[stay]])
        return _transport_natively(points, np.concatenate([receivers, stay]), centres, counts)
    if len(points) * (len(receivers) + 1) <= MAX_ARCS:
        return _solve_linear_program(points, owners, centres, gains, losses)
    after, open_gains = owners.copy(), gains.copy()
    movable = np.bincount(owners, minlength=len(losses))
    emptied = losers[movable[losers] == losses[losers]]
    for group in [group for group in (emptied, *(losers[losers == n] for n in losers if n not in emptied)) if len(group)]:
        rows = np.flatnonzero(np.isin(owners, group))
        part = _share_gains(open_gains, int(losses[group].sum()))
        after[rows] = _transport(points[rows], owners[rows], centres, part, losses * np.isin(np.arange(len(losses)), group))
        open_gains = open_gains - part
    return after


def _share_gains(gains: Indices, total: int) -> Indices:
    """Distribute `total` over the gains (D,) in proportion; remainders go to the largest."""
    exact = gains * (total / max(1, int(gains.sum())))
    part = np.floor(exact).astype(np.int64)
    part[np.argsort(part - exact, kind="stable")[: total - int(part.sum())]] += 1
    return part


def _transport_natively(points: FloatArray, devices: Indices, centres: FloatArray, counts: Indices) -> Indices:
    middle = points.mean(axis=0)
    extent_m = float(np.ptp(points, axis=0).max()) or 1.0
    sites = separate_sites(centres[devices] - middle, extent_m)
    return devices[deal_with_counts(points - middle, sites, counts).edge_of_position]


def _solve_linear_program(points: FloatArray, owners: Indices, centres: FloatArray, gains: Indices, losses: Indices) -> Indices:
    """Arcs point → receiver with the change of squared distance; every point at most one, receivers
    and losers exactly."""
    from scipy import optimize  # pyright: ignore[reportMissingTypeStubs]

    receivers, losers = np.flatnonzero(gains), np.unique(owners)
    num_points, num_receivers = len(points), len(receivers)
    near = np.sum((points[:, None] - centres[receivers]) ** 2, axis=-1)
    cost = near - np.sum((points - centres[owners]) ** 2, axis=1, keepdims=True)
    arcs = np.arange(num_points * num_receivers)
    point, receiver = np.divmod(arcs, num_receivers)
    rows = np.concatenate([receiver, num_receivers + np.searchsorted(losers, owners[point])])
    ones = np.ones(len(arcs))
    exactly = sparse.csr_array((np.tile(ones, 2), (rows, np.tile(arcs, 2))))
    at_most = sparse.csr_array((ones, (point, arcs)))
    solver: Any = optimize
    solved = solver.linprog(
        (cost / max(1e-300, float(np.abs(cost).max()))).ravel(),
        A_ub=at_most,
        b_ub=np.ones(num_points),
        A_eq=exactly,
        b_eq=np.concatenate([gains[receivers], losses[losers]]),
        method="highs-ds",
    )
    assert solved.x is not None, "as many leave as arrive"
    flows: FloatArray = solved.x.reshape(num_points, num_receivers)
    return np.where(flows.max(axis=1) > 0.5, receivers[flows.argmax(axis=1)], owners)


def _deal_new_in_strips(positions: FloatArray, before: Indices, after: Indices, counts_before: Indices, system: System) -> Indices:
    """Deal the positions that new devices of one edge received together to them, in strips along
    the long side."""
    first = 0
    for edge in system.edges:
        new = [index for index in range(first, first + len(edge.devices)) if not counts_before[index]]
        first += len(edge.devices)
        rows = np.flatnonzero(np.isin(after, new) & (after != before))
        if len(new) > 1 and len(rows):
            counts = np.bincount(after[rows], minlength=len(counts_before))[new]
            order = np.argsort((positions[rows] - positions[rows].mean(axis=0)) @ long_axis(positions[rows]), kind="stable")
            after[rows[order]] = np.repeat(new, counts)
    return after


def _result(  # noqa: PLR0913
    cloud_plan: CloudPlan,
    edge_plans: Sequence[EdgePlan],
    positions: FloatArray,
    system: System,
    change: FleetChange,
    dealt: tuple[Indices, Indices, NDArray[np.bool_]],
    counted: tuple[list[EdgeLoad], SolvedCounts],
) -> Replan:
    before, after, lost = dealt
    loads, solved_counts = counted
    edge_of_device = np.repeat(np.arange(len(system.edges)), [len(edge.devices) for edge in system.edges])
    times = [_times_s(system, loads, owner, lost) for owner in (before, after)]
    grown = len(system.edges) > len(cloud_plan.edge_ids)
    regions = cloud_plan
    if grown or (edge_of_device[before] != edge_of_device[after]).any():
        regions = regions_with_counts(positions[~lost], edge_of_device[after[~lost]], system)
    edge_time_s = np.array([load.time_s(quotas) for load, quotas in zip(loads, solved_counts.quotas, strict=True)])
    makespan_s = float(edge_time_s.max())
    middle = positions.mean(axis=0)
    certified = is_certified(positions[~lost] - middle, regions.sites - middle, regions.weights, edge_of_device[after[~lost]])
    at_bound = makespan_s <= solved_counts.deadline_s * (1 + ROUNDING)
    cloud = replace(
        regions,
        method="replan",
        edge_of_camera=edge_of_device[after],
        edge_time_s=edge_time_s,
        lower_bound_s=solved_counts.deadline_s,
        status="optimal" if at_bound and certified else "converged" if at_bound else "stopped",
        certified=certified,
        history=(makespan_s,),
        looks=cloud_plan.looks,
    )
    return Replan(
        system=system,
        cloud=cloud,
        edges=_edge_plans(edge_plans, positions, system, (before, after), times[1]),
        device_before=before,
        device_after=after,
        lost=lost,
        time_before_s=times[0],
        time_after_s=times[1],
        makespan_before_s=_makespan_s(loads, system, before[~lost], change),
        fewest_proved=solved_counts.proved,
    )


def _times_s(system: System, loads: Sequence[EdgeLoad], owners: Indices, lost: NDArray[np.bool_]) -> FloatArray:
    """Time at which each device (D,) has sent its model; inf for a dead one with positions, 0 for
    one without positions."""
    counts = dict(zip((d.id for d in system.devices), np.bincount(owners[~lost], minlength=len(system.devices)).tolist(), strict=True))
    alive = {machine.device.id: machine for load in loads for machine in load.machines}
    return np.array([alive[name].time_s(count) if name in alive else (np.inf if count else 0.0) for name, count in counts.items()])


def _makespan_s(loads: Sequence[EdgeLoad], system: System, owners: Indices, change: FleetChange) -> float:
    counts = dict(zip((d.id for d in system.devices), np.bincount(owners, minlength=len(system.devices)).tolist(), strict=True))
    if any(counts[name] for name in counts if name in change.dead):
        return float("inf")
    return max(load.time_s([counts[machine.device.id] for machine in load.machines]) for load in loads)


def _edge_plans(
    old_plans: Sequence[EdgePlan], positions: FloatArray, system: System, owners: tuple[Indices, Indices], time_s: FloatArray
) -> tuple[EdgePlan, ...]:
    """The new plan of each edge; strips stay if nothing of the edge changed, else hulls."""
    before, after = owners
    old_of = {plan.edge_id: plan for plan in old_plans}
    plans: list[EdgePlan] = []
    first = 0
    for edge in system.edges:
        last = first + len(edge.devices)
        rows = np.flatnonzero((after >= first) & (after < last))
        owned = (before >= first) & (before < last)
        old = old_of.get(edge.id)
        ids = tuple(device.id for device in edge.devices)
        untouched = old is not None and old.device_ids == ids and (before[owned] == after[owned]).all() and len(rows) == owned.sum()
        hulls = tuple(hull_of(positions[after == index]) for index in range(first, last))
        plans.append(
            EdgePlan(
                edge_id=edge.id,
                device_ids=ids,
                camera_indices=rows,
                device_of_camera=after[rows] - first,
                strips=old.strips if old is not None and untouched else hulls,
                device_time_s=np.where(np.isfinite(time_s[first:last]), time_s[first:last], 0.0),
            )
        )
        first = last
    return tuple(plans)
