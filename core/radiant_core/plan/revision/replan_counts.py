"""Quotas of positions per device after a fleet change: least makespan, then fewest moves.

A device n holds f_n positions that stay (captured), takes up to u_n, and is busy until r_n:
    τ_n(q) = r_n + G(q) + F_n(q) + H(q) / B^n  for q > 0, else 0        (closed: q fixed, τ_n = r_n)
    T^m(c) = max_n τ_n(q_n) + F_m(c) + Σ_n H_n(q_n) / B^m               f_n ≤ q_n ≤ u_n, Σ_n q_n = c
The deadline T* comes as in `deadline`: the times of the (f_n + 1)-th, (f_n + 2)-th … position of
every open device, sorted; the edges' tables sorted again. Under T* an edge with c positions allows
each device at most κ_n(c), which falls with c. With w_n positions now,
    forced(c) = Σ_n max(0, w_n − κ_n(c)),      leaving(c) = max(forced(c), Σ_n w_n − c)
is the fewest that must leave its devices. Up to some c° one position more saves one move, beyond it
none: every edge gets c° at least, the rest is dealt by dynamic programming over edges. Exact where
all open devices of an edge send equally many bytes per position and nothing beside, and where F_m
does not depend on how many devices have the positions (`aggregate_alone_s`); else quotas are kept
under T* and `proved` is False. Runs once per re-plan: O(P log P) and, only where moves are forced,
E · X² for X positions left over.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiant_core.numerics import FloatArray, require_finite
from radiant_core.plan.counts.deadline import aggregate_times_s, device_time_s, earliest_slots
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.system import Device, Edge

Indices = NDArray[np.int64]
ROUNDING = 1e-12
"""A time may exceed the deadline by this share, a few roundings of sums in another order."""
MAX_STEPS = 2_000_000_000
"""E · X² of the dynamic programme; beyond it the fastest counts are taken, and moves unproved."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MachineLoad:
    """A device: `now` positions, `fixed` of them stay, at most `most`; closed: accepts no more."""

    device: Device
    now: int
    fixed: int
    most: int
    busy_s: float = 0.0
    closed: bool = False

    def time_s(self, quota: int) -> float:
        """Time at which it has sent its model of `quota` positions."""
        if not quota:
            return 0.0
        return self.busy_s if self.closed else self.busy_s + float(device_time_s(self.device, quota))


@dataclass(frozen=True, kw_only=True, eq=False)
class EdgeLoad:
    """One edge with its living devices; finished: it has delivered and its time is 0."""

    edge: Edge
    machines: tuple[MachineLoad, ...]
    distance_m: float = 0.0
    """Distance to the positions that must move; only breaks ties."""
    finished: bool = False

    @property
    def now(self) -> int:
        """Positions its devices hold now."""
        return sum(machine.now for machine in self.machines)

    @property
    def fixed(self) -> int:
        """Positions that stay."""
        return sum(machine.fixed for machine in self.machines)

    def time_s(self, quotas: Sequence[int]) -> float:
        """T^m with these quotas."""
        if self.finished or not sum(quotas):
            return 0.0
        pairs = list(zip(self.machines, quotas, strict=True))
        sent = sum(float(machine.device.model_bytes(quota)) for machine, quota in pairs)
        ready_s = max(machine.time_s(quota) for machine, quota in pairs)
        return ready_s + self.edge.aggregation_s(sum(quotas), sum(quota > 0 for quota in quotas)) + sent / self.edge.uplink_bytes_per_s


@dataclass(frozen=True, kw_only=True, eq=False)
class SolvedCounts:
    """quotas: per edge its devices' positions; deadline_s: the least makespan; proved: that no
    fewer positions could move."""

    quotas: tuple[tuple[int, ...], ...]
    deadline_s: float
    proved: bool


def solve_counts(loads: Sequence[EdgeLoad], num_positions: int, tolerance: float = 0.0) -> SolvedCounts | None:
    """Quotas for all positions, within `tolerance` of the least makespan; None where the machines
    cannot hold them."""
    tables = [_Table(load, num_positions) for load in loads]
    num_free = num_positions - sum(load.fixed for load in loads)
    owners, times_s = earliest_slots([table.time_s[1:] for table in tables], num_free)
    if num_free < 0 or len(owners) < num_free:
        return None
    least_s = max([float(table.time_s[0]) for table in tables] + times_s[-1:].tolist())
    allowed_s = least_s * (1 + tolerance) * (1 + ROUNDING)
    extra = np.bincount(owners, minlength=len(tables))
    choices = [_Choices(table, allowed_s) for table in tables]
    edge_counts, fewest = _distribute(choices, num_positions, extra)
    quotas = [choice.quotas(count) for choice, count in zip(choices, edge_counts, strict=True)]
    proved = fewest and all(table.uniform for table in tables)
    return SolvedCounts(quotas=tuple(tuple(row) for row in quotas), deadline_s=least_s, proved=proved)


class _Table:
    """Times (K+1,) of an edge with its fixed positions and 0..K more, and the device of each."""

    def __init__(self, load: EdgeLoad, num_positions: int) -> None:
        self.load = load
        spare = max(0, num_positions - load.fixed)
        self.rooms = [0 if m.closed or load.finished else max(0, min(m.most - m.fixed, spare)) for m in load.machines]
        self.slot_s: list[FloatArray] = []
        growth: list[FloatArray] = []
        for machine, room in zip(load.machines, self.rooms, strict=True):
            counts = machine.fixed + np.arange(room + 1)
            with np.errstate(over="ignore", invalid="ignore"):
                self.slot_s.append(machine.busy_s + np.maximum.accumulate(device_time_s(machine.device, counts[1:])))
                growth.append(np.diff(machine.device.model_bytes(counts)))
            require_finite(f"the time of device {machine.device.id!r} against positions", self.slot_s[-1])
        self.uniform = _send_alike([m.device.model_bytes for m, room in zip(load.machines, self.rooms, strict=True) if room])
        if load.edge.aggregate_alone_s is not None and len(load.machines) > 1:
            # Where one device alone retrains nothing, time depends on which one has the positions.
            self.uniform &= sum(m.fixed > 0 for m in load.machines) > 1
        self.owners, times_s = earliest_slots(self.slot_s, spare) if load.machines else (np.zeros(0, np.int64), np.zeros(0))
        base_s = max((m.time_s(m.fixed) for m in load.machines), default=0.0)
        self.counts = load.fixed + np.arange(len(self.owners) + 1)
        self.rest_s = self._after_devices_s(growth)
        ready_s = np.maximum(base_s, np.concatenate([[0.0], times_s]))
        total_s = np.where(self.counts > 0, ready_s + self.rest_s, 0.0)
        require_finite(f"the time of edge {load.edge.id!r} against positions", total_s)
        self.time_s: FloatArray = np.zeros(len(total_s)) if load.finished else np.maximum.accumulate(total_s)

    def _after_devices_s(self, growth: Sequence[FloatArray]) -> FloatArray:
        """F_m(c) + Σ H / B^m (K+1,) with the quotas of the fastest devices."""
        position = np.zeros(len(self.owners), np.int64)
        for index in range(len(self.rooms)):
            is_owner = self.owners == index
            position[is_owner] = np.arange(int(is_owner.sum()))
        starts = np.cumsum([0, *self.rooms])[self.owners]
        grown = np.concatenate(growth)[starts + position] if len(self.owners) else np.zeros(0)
        fixed_bytes = sum(float(m.device.model_bytes(m.fixed)) for m in self.load.machines)
        sent = fixed_bytes + np.concatenate([[0.0], np.cumsum(grown)])
        return aggregate_times_s(self.load.edge, self.counts, self._most_alone()) + sent / self.load.edge.uplink_bytes_per_s

    def _most_alone(self) -> int:
        """The largest count that one device has alone with the quotas of the fastest devices."""
        holders = [index for index, m in enumerate(self.load.machines) if m.fixed] or self.owners[:1].tolist()
        if len(holders) != 1:
            return 0
        others = np.flatnonzero(self.owners != holders[0])
        return self.load.fixed + int(others[0] if len(others) else len(self.owners))


class _Choices:
    """For each count of an edge from `first` on: the most per device under a deadline, and the
    fewest that must leave."""

    def __init__(self, table: _Table, allowed_s: float) -> None:
        self.table, self.allowed_s = table, allowed_s
        load = table.load
        size = int(np.searchsorted(table.time_s, allowed_s, side="right"))
        self.counts = table.counts[:size]
        ready_s = allowed_s - table.rest_s[:size]
        self.caps: Indices = np.stack(
            [m.fixed + np.searchsorted(slots, ready_s, side="right") for m, slots in zip(load.machines, table.slot_s, strict=True)]
            or [np.zeros(size, np.int64)]
        )
        counts_now = np.array([m.now for m in load.machines] or [0])
        forced = np.maximum(0, counts_now[:, None] - self.caps).sum(axis=0)
        self.leaving = np.maximum(forced, load.now - self.counts)
        # The last count at which one position more still saves a move.
        self.first = int(np.flatnonzero(forced <= load.now - self.counts)[-1]) if size else 0

    @property
    def extra_cost(self) -> Indices:
        """Moves (X+1,) that 0..X positions beyond `first` force."""
        return self.leaving[self.first :] - self.leaving[self.first]

    def quotas(self, count: int) -> list[int]:
        """Quotas of `count` positions with the fewest leaving; ties: the device named first."""
        load = self.table.load
        caps: list[int] = self.caps[:, int(count) - int(self.counts[0])].tolist()
        if not load.machines:
            return []
        quotas = [min(m.now, cap) for m, cap in zip(load.machines, caps, strict=True)]
        missing = int(count) - sum(quotas)
        for index, machine in enumerate(load.machines):
            room = caps[index] - quotas[index]
            step = min(missing, room) if missing > 0 else max(missing, machine.fixed - quotas[index])
            quotas[index] += step
            missing -= step
        return quotas if self.table.uniform else self._under_deadline(quotas, int(count))

    def _under_deadline(self, quotas: list[int], count: int) -> list[int]:
        """Quotas moved towards the fastest, position by position, until what they send fits too."""
        fixed = [m.fixed for m in self.table.load.machines]
        fastest = np.bincount(self.table.owners[: count - sum(fixed)], minlength=len(fixed)) + fixed
        while self.table.load.time_s(quotas) > self.allowed_s and (gaps := fastest - np.array(quotas)).any():
            quotas[int(gaps.argmax())] += 1
            quotas[int(gaps.argmin())] -= 1
        return quotas


def _distribute(choices: Sequence[_Choices], num_positions: int, fastest: Indices) -> tuple[list[int], bool]:
    """Positions of each edge with the fewest moves, nearer edges first; whether that is proved."""
    firsts = [int(choice.counts[choice.first]) for choice in choices]
    num_left = num_positions - sum(firsts)
    free = [int(np.searchsorted(choice.extra_cost, 0, side="right")) - 1 for choice in choices]
    nearest = sorted(range(len(choices)), key=lambda index: choices[index].table.load.distance_m)
    if sum(free) >= num_left:
        for index in nearest:
            step = min(num_left, free[index])
            firsts[index] += step
            num_left -= step
        return firsts, True
    if len(choices) * num_left * num_left > MAX_STEPS:
        return [int(c.table.load.fixed + more) for c, more in zip(choices, fastest.tolist(), strict=True)], False
    return [first + more for first, more in zip(firsts, _distribute_cheapest(choices, num_left), strict=True)], True


def _distribute_cheapest(choices: Sequence[_Choices], total: int) -> list[int]:
    """Deal `total` positions to edges at the least cost: min-plus convolutions, backtracking."""
    farthest_m = max(choice.table.load.distance_m for choice in choices) or 1.0
    best = np.full(total + 1, np.inf)
    best[0] = 0.0
    chosen: list[Indices] = []
    for choice in choices:
        cost = choice.extra_cost[: total + 1]
        # Distances together weigh less than one move.
        cost = cost + np.arange(len(cost)) * (0.4 * choice.table.load.distance_m / farthest_m / max(total, 1))
        new, increments = np.full(total + 1, np.inf), np.zeros(total + 1, np.int64)
        for more, price in enumerate(cost.tolist()):
            candidate = best[: total + 1 - more] + price
            better = candidate < new[more:]
            new[more:][better] = candidate[better]
            increments[more:][better] = more
        best = new
        chosen.append(increments)
    assert np.isfinite(best[total]), "the tables let through all positions"
    counts: list[int] = []
    for increments in reversed(chosen):
        counts.append(int(increments[total]))
        total -= counts[-1]
    return counts[::-1]


def _send_alike(curves: Sequence[CostCurve]) -> bool:
    """Whether the bytes sent depend on the sum of the positions alone."""
    slopes = {curve.linear + (curve.power_coefficient if curve.exponent == 1 else 0.0) for curve in curves}
    return len(slopes) <= 1 and all(not curve.constant and (not curve.power_coefficient or curve.exponent == 1) for curve in curves)
