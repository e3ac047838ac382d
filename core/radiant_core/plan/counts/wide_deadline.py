"""`deadline.fastest_counts` where tables are too large: only entries near the deadline are made.

Guess: T^n(k) on a geometric grid of k, hence k_n(t) and T^m against the device deadline t by
interpolation, and the T at which all edges together take C cameras. Then the exact entries within
`window` of the guessed quotas are sorted as in `deadline`. Proof: what lies below the window is
earlier than the deadline found, what lies above later; otherwise the window is widened. Runs once
per plan, O(D log C) for the guess and C · window entries, some 1 % of C.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, require_finite
from radiant_core.plan.counts.deadline import MAX_TABLE_ENTRIES, device_time_s, edge_table, edge_tables, fastest_counts
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.system import Edge, System

SMALL_TABLE_ENTRIES = 60_000
"""Cameras × devices up to which whole tables are quicker."""
_GRID_RATIO = 1.05
_DEADLINES = 128
_HALVINGS = 40
"""Of the range in which the guessed deadline lies: far inside the first window."""
_FIRST_WINDOW = 0.01

Indices = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, eq=False)
class FastestCounts:
    """counts (E,) with the smallest makespan and the time (E,) s of each edge with them; read-only,
    as they are remembered for a drag."""

    counts: Indices
    edge_time_s: FloatArray

    def __post_init__(self) -> None:
        self.counts.flags.writeable = False
        self.edge_time_s.flags.writeable = False


def system_capacity(system: System, num_cameras: int) -> int:
    """Cameras that all devices together can hold, each at most `num_cameras`."""
    return int(_limits(system, num_cameras).sum())


def fastest_edge_counts(system: System, num_cameras: int) -> FastestCounts:
    """Counts with the smallest makespan; all cameras must fit. BadInput when curves overflow."""
    if num_cameras * len(system.workers) <= SMALL_TABLE_ENTRIES:
        tables = edge_tables(system, num_cameras)
        counts, _ = fastest_counts(tables, num_cameras)
        return FastestCounts(counts=counts, edge_time_s=np.array([t.edge_time_s[c] for t, c in zip(tables, counts, strict=True)]))
    fleet = _Fleet(system, num_cameras)
    guess = fleet.guess_quotas()
    window = _FIRST_WINDOW
    while True:
        margin = int(2 * window / _FIRST_WINDOW)
        low = np.clip(np.floor(guess * (1 - window)).astype(np.int64) - margin, 0, fleet.limits)
        high = np.clip(np.ceil(guess * (1 + window)).astype(np.int64) + margin, 0, fleet.limits)
        if int((high - low).sum()) > MAX_TABLE_ENTRIES:
            raise BadInput(f"{num_cameras} cameras on {len(fleet.limits)} devices cannot be told apart by time: use fewer.")
        solution = fleet.solve(low, high)
        if solution is not None:
            return solution
        window *= 3


@lru_cache(maxsize=8)
def cached_edge_counts(system: System, num_cameras: int) -> FastestCounts:
    """`fastest_edge_counts`, once for all frames of a drag, which changes none of its inputs."""
    return fastest_edge_counts(system, num_cameras)


def times_of_counts(system: System, counts: Indices) -> FloatArray:
    """T^m (E,) s of each edge with its count, which it must be able to hold."""
    return np.array([edge_table(edge, int(count)).edge_time_s[count] for edge, count in zip(system.edges, counts, strict=True)])


def _limits(system: System, num_cameras: int) -> Indices:
    return np.array([num_cameras if d.max_cameras is None else min(d.max_cameras, num_cameras) for d in system.workers], np.int64)


def _num_alone(edge: Edge, num_cameras: int) -> int:
    """The most cameras that all go to the edge's fastest device, before the next could do one."""
    limits = [num_cameras if d.max_cameras is None else min(d.max_cameras, num_cameras) for d in edge.devices]
    firsts = sorted((float(device_time_s(d, 1)), index) for index, (d, limit) in enumerate(zip(edge.devices, limits, strict=True)) if limit)
    if not firsts:
        return 0
    fastest = firsts[0][1]
    if len(firsts) == 1:
        return limits[fastest]
    low, high = 1, limits[fastest] + 1
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if float(device_time_s(edge.devices[fastest], middle)) < firsts[1][0] else (low, middle)
    return low


class _Curves:
    """Several cost curves at once; the same operations in the same order as `CostCurve`."""

    def __init__(self, curves: list[CostCurve]) -> None:
        self.terms = np.array([[c.constant, c.linear, c.power_coefficient, c.exponent] for c in curves]).T

    def __call__(self, counts: NDArray[np.int64] | FloatArray, rows: Indices | slice = slice(None)) -> FloatArray:
        counts = counts.T.astype(np.float64)
        constant, linear, power, exponent = (term[rows] for term in self.terms)
        # Where no power term is, its exponent would only cost time.
        value: FloatArray = constant + linear * counts
        if power.any():
            value = value + power * counts**exponent
        return np.where(counts > 0, value, 0.0).T


class _Fleet:
    def __init__(self, system: System, num_cameras: int) -> None:
        devices = system.workers
        self.num_cameras = num_cameras
        self.limits = _limits(system, num_cameras)
        sizes = [len(edge.workers) for edge in system.edges]
        self.starts = np.cumsum([0, *sizes[:-1]])
        self.edge_of_device = np.repeat(np.arange(len(sizes)), sizes)
        self.init, self.train = _Curves([d.init_s for d in devices]), _Curves([d.train_s for d in devices])
        self.model_bytes = _Curves([d.model_bytes for d in devices])
        self.joined = _Curves([edge.aggregate_s for edge in system.edges])
        self.alone = _Curves([edge.aggregate_alone_s or edge.aggregate_s for edge in system.edges])
        self.num_alone = np.array([_num_alone(edge, num_cameras) if edge.aggregate_alone_s else 0 for edge in system.edges])
        self.uplink = np.array([d.uplink_bytes_per_s for d in devices])
        self.edge_uplink = np.array([edge.uplink_bytes_per_s for edge in system.edges])

    def time_s(self, counts: NDArray[np.int64] | FloatArray, rows: Indices | slice = slice(None)) -> FloatArray:
        """T^n of devices `rows` with `counts`, (D,) or (D,J)."""
        with np.errstate(over="ignore", invalid="ignore"):
            times = self.init(counts, rows) + self.train(counts, rows) + (self.model_bytes(counts, rows).T / self.uplink[rows]).T
        require_finite("the time of a device against cameras", times)
        return times

    def aggregate(self, counts: NDArray[np.int64] | FloatArray, rows: Indices | slice = slice(None)) -> FloatArray:
        """F_m of edges `rows` with `counts`, (E,) or (E,J)."""
        joined_s = self.joined(counts, rows)
        if not self.num_alone.any():
            return joined_s
        is_alone = (self.num_alone[rows] >= counts.T).T
        return np.where(is_alone, np.minimum(self.alone(counts, rows), joined_s), joined_s)

    def guess_quotas(self) -> FloatArray:
        """Quotas (D,) near the optimum, from interpolation; a slope too small to matter shares flat
        curves evenly."""
        steps = int(np.ceil(np.log(max(self.num_cameras, 2)) / np.log(_GRID_RATIO))) + 1
        grid = np.unique(np.round(np.geomspace(1, self.num_cameras, steps)))
        counts = np.minimum(grid, np.maximum(self.limits, 1)[:, None])
        times = np.maximum.accumulate(self.time_s(counts), axis=1)
        slope = 1e-9 * (float(times.max()) or 1.0) / self.num_cameras
        times += slope * counts
        last = np.where(self.limits > 0, times[:, -1], np.inf)
        times[self.limits == 0] = np.inf
        first_s = np.minimum.reduceat(times[:, 0], self.starts)
        last_s = np.maximum.reduceat(np.where(np.isfinite(last), last, 0.0), self.starts)
        usable = np.isfinite(first_s)
        first_s, last_s = np.where(usable, first_s, 1.0), np.where(usable, np.maximum(last_s, first_s), 1.0)
        shares = np.linspace(0, 1, _DEADLINES)
        growing = first_s[:, None] * (last_s / np.maximum(first_s, 1e-300))[:, None] ** shares
        deadlines = np.where(first_s[:, None] > 0, growing, last_s[:, None] * shares**4)
        quotas = np.zeros((len(times), _DEADLINES))
        for device in np.flatnonzero(self.limits > 0):
            quotas[device] = np.interp(deadlines[self.edge_of_device[device]], times[device], counts[device], left=0.0)
        totals = np.add.reduceat(quotas, self.starts, axis=0)
        sent = np.add.reduceat(self.model_bytes(quotas), self.starts, axis=0) / self.edge_uplink[:, None]
        edge_time = np.maximum.accumulate(deadlines + self.aggregate(totals) + sent, axis=1)
        edge_time += slope * totals
        low, high = 0.0, float(edge_time.max())
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            num_dealt = _interpolate(edge_time, totals, np.full(len(self.starts), middle)).sum()
            low, high = (low, middle) if num_dealt >= self.num_cameras else (middle, high)
        edge_deadline = _interpolate(edge_time, deadlines, np.full(len(self.starts), high))
        return self._of_all_cameras(_interpolate(times, counts, edge_deadline[self.edge_of_device]))

    def _of_all_cameras(self, quotas: FloatArray) -> FloatArray:
        """Quotas (D,) scaled to sum to the cameras: flat curves hardly determine how many fit."""
        for _ in range(8):
            quotas = np.minimum(quotas * (self.num_cameras / max(float(quotas.sum()), 1e-300)), self.limits)
        return quotas

    def solve(self, low: Indices, high: Indices) -> FastestCounts | None:
        """The exact optimum if quotas between low and high (D,) hold it and prove it, else None."""
        sizes = high - low
        device = np.repeat(np.arange(len(low)), sizes)
        rank = np.arange(len(device)) - np.repeat(np.cumsum(sizes) - sizes, sizes) + low[device] + 1
        time_s = self.time_s(rank, device)
        growth = self.model_bytes(rank, device) - self.model_bytes(rank - 1, device)
        edge = self.edge_of_device[device]
        order = np.lexsort((device, rank, time_s, edge))
        time_s, growth, edge = time_s[order], growth[order], edge[order]
        first = np.searchsorted(edge, np.arange(len(self.starts) + 1))
        base_count = np.add.reduceat(low, self.starts)
        base_bytes = np.add.reduceat(self.model_bytes(low), self.starts)
        earliest = np.maximum.reduceat(self.time_s(low), self.starts)
        after = np.where(high < self.limits, self.time_s(np.minimum(high + 1, np.maximum(self.limits, 1))), np.inf)
        latest = np.minimum.reduceat(after, self.starts)
        full = np.add.reduceat(self.limits, self.starts)
        start_counts = np.zeros(len(self.starts), np.int64)
        base_s = np.zeros(len(self.starts))
        entries: list[FloatArray] = []
        bounds: list[int] = first.tolist()
        for index, (start, stop) in enumerate(pairwise(bounds)):
            times = time_s[start:stop]
            begin = int(times.searchsorted(float(earliest[index]), side="left"))
            end = int(times.searchsorted(float(latest[index]), side="right"))
            counts = base_count[index] + np.arange(len(times) + 1)
            sent = (base_bytes[index] + np.concatenate([[0.0], np.cumsum(growth[start:stop])])) / self.edge_uplink[index]
            slot_s = np.maximum.accumulate(np.concatenate([[earliest[index]], times]))
            total = slot_s + self.aggregate(counts, np.full(len(counts), index)) + sent
            total = np.where(counts > 0, np.maximum.accumulate(total), 0.0)
            start_counts[index], base_s[index] = counts[begin], total[begin]
            entries.append(total[begin + 1 : end + 1])
        require_finite("the time of an edge against cameras", np.concatenate([base_s, *entries]))
        return self._choose(start_counts, base_s, entries, full)

    def _choose(self, start_counts: Indices, base_s: FloatArray, entries: list[FloatArray], full: Indices) -> FastestCounts | None:
        """The earliest entries beyond `start_counts` (E,), where they are proved earliest."""
        missing = self.num_cameras - int(start_counts.sum())
        lengths = np.array([len(times) for times in entries])
        if missing < 0 or missing > lengths.sum():
            return None
        owner = np.repeat(np.arange(len(entries)), lengths)
        position = np.arange(len(owner)) - np.repeat(np.cumsum(lengths) - lengths, lengths)
        times = np.concatenate(entries)
        chosen = np.lexsort((owner, position + start_counts[owner], times))[:missing]
        extra = np.bincount(owner[chosen], minlength=len(entries))
        counts = start_counts + extra
        # Any other counts take an entry that is not chosen, which is later than all that are; it
        # has to be as late as what is taken unseen.
        later = [float(times[more]) for times, more in zip(entries, extra, strict=True) if more < len(times)]
        if float(base_s.max()) > min(later, default=np.inf) or not ((extra < lengths) | (counts == full)).all():
            return None
        last = [base if not more else times[more - 1] for base, times, more in zip(base_s, entries, extra, strict=True)]
        return FastestCounts(counts=counts, edge_time_s=np.array(last))


def _interpolate(rising: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Row-wise values (R,J) where rising (R,J) reaches at (R,); 0 before the first node, the last
    value after the last."""
    below = (rising <= at[:, None]).sum(axis=1)
    lower = np.clip(below - 1, 0, rising.shape[1] - 1)
    upper = np.minimum(below, rising.shape[1] - 1)
    rows = np.arange(len(at))
    with np.errstate(invalid="ignore"):
        width = rising[rows, upper] - rising[rows, lower]
        share = np.where((width > 0) & np.isfinite(width), (at - rising[rows, lower]) / np.where(width > 0, width, 1.0), 0.0)
    interpolated = values[rows, lower] + np.clip(share, 0, 1) * (values[rows, upper] - values[rows, lower])
    return np.where(below > 0, interpolated, 0.0)
