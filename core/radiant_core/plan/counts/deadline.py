"""The time of an edge with c cameras, and the counts that follow (paper Eqn. 5-8; RTP, Eqn. 9-17).

    T^n(k) = G(k) + F_n(k) + H(k) / B^n            one device with k cameras, non-decreasing in k
    T^m(c) = max_n T^n(q_n(c)) + F_m(c) + Σ_n H_n(q_n(c)) / B^m           one edge with c cameras

Sort the times T^n(1), T^n(2), … of all devices up to their memory limits: a deadline T lets through
exactly the entries ≤ T, so the c-th smallest entry is the least deadline for c cameras, and the
devices of the first c entries are their quotas q_n(c). Quotas only grow with c, hence T^m is
non-decreasing too, and the same sort over edges gives the counts with the smallest makespan. No
geography enters: no partition into these edges is faster. Slower quotas that send fewer bytes are
not looked for (nor in the paper). Runs once per plan, O(N log N) in N = cameras × devices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, require_finite
from radiant_core.plan.system import Device, Edge, System

MAX_TABLE_ENTRIES = 50_000_000
"""Cameras × devices that are tabulated at most, about 2 GB while sorting."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EdgeTable:
    """What one edge needs for 0..K cameras, K = `capacity`. device_of_slot (K,): the device of the
    c-th camera; edge_time_s (K+1,): T^m(c), non-decreasing, T^m(0) = 0."""

    num_devices: int
    device_of_slot: NDArray[np.int64]
    edge_time_s: FloatArray

    @property
    def capacity(self) -> int:
        """Cameras the edge's devices can hold, at most the scene's."""
        return len(self.device_of_slot)

    def quotas(self, num_cameras: int) -> NDArray[np.int64]:
        """Cameras per device (D,) with the smallest slowest device; BadInput above the capacity."""
        if not 0 <= num_cameras <= self.capacity:
            raise BadInput(f"an edge was given {num_cameras} cameras, its devices can hold {self.capacity}: plan with fewer.")
        return np.bincount(self.device_of_slot[:num_cameras], minlength=self.num_devices)


def device_time_s(device: Device, num_cameras: ArrayLike) -> FloatArray:
    """T^n in seconds for camera counts of any shape (paper Eqn. 12-15)."""
    sending_s = device.model_bytes(num_cameras) / device.uplink_bytes_per_s
    return device.init_s(num_cameras) + device.train_s(num_cameras) + sending_s


def edge_tables(system: System, num_cameras: int) -> tuple[EdgeTable, ...]:
    """The table of every edge; BadInput when curves overflow or cameras × devices is too large."""
    entries = num_cameras * len(system.workers)
    if entries > MAX_TABLE_ENTRIES:
        raise BadInput(
            f"{num_cameras} cameras on {len(system.workers)} devices make {entries} table entries, at most {MAX_TABLE_ENTRIES} "
            "are supported: plan with fewer cameras or devices."
        )
    return tuple(edge_table(edge, num_cameras) for edge in system.edges)


def edge_table(edge: Edge, num_cameras: int) -> EdgeTable:
    """The table of one edge for up to `num_cameras` cameras."""
    limits = [num_cameras if d.max_cameras is None else min(d.max_cameras, num_cameras) for d in edge.workers]
    with np.errstate(over="ignore", invalid="ignore"):
        times_s = [_monotone(device_time_s(d, np.arange(1, k + 1))) for d, k in zip(edge.workers, limits, strict=True)]
        slots, slot_time_s = earliest_slots(times_s, num_cameras)
        sizes = [d.model_bytes(np.arange(k + 1)) for d, k in zip(edge.workers, limits, strict=True)]
        growth = np.concatenate([np.diff(size) for size in sizes])
        model_bytes = _from_zero(np.cumsum(growth[_flat_indices(slots, limits)]))
        counts = np.arange(len(slots) + 1)
        others = np.flatnonzero(slots != slots[0]) if len(slots) else slots
        total_s = _from_zero(slot_time_s) + aggregate_times_s(edge, counts, others[0] if len(others) else len(slots))
        total_s = total_s + model_bytes / edge.uplink_bytes_per_s
    require_finite(f"the time of edge {edge.id!r} against cameras", total_s)
    return EdgeTable(num_devices=len(edge.workers), device_of_slot=slots, edge_time_s=_monotone(total_s))


def aggregate_times_s(edge: Edge, num_cameras: ArrayLike, num_alone: ArrayLike) -> FloatArray:
    """F_m for camera counts of any shape, of which up to `num_alone` go to one device."""
    counts = np.asarray(num_cameras)
    joined_s = edge.aggregate_s(counts)
    if edge.aggregate_alone_s is None:
        return joined_s
    return np.where(counts <= num_alone, np.minimum(edge.aggregate_alone_s(counts), joined_s), joined_s)


def fastest_counts(tables: Sequence[EdgeTable], num_cameras: int) -> tuple[NDArray[np.int64], float]:
    """Cameras per edge (E,) and makespan in seconds, the least; all cameras must fit."""
    slots, slot_time_s = earliest_slots([table.edge_time_s[1:] for table in tables], num_cameras)
    assert len(slots) == num_cameras, "the caller checks the capacity first"
    return np.bincount(slots, minlength=len(tables)), float(slot_time_s[-1]) if num_cameras else 0.0


def earliest_slots(times_s: Sequence[FloatArray], num_slots: int) -> tuple[NDArray[np.int64], FloatArray]:
    """Owners and times of the `num_slots` earliest entries of non-decreasing lists, or of all there
    are. Equal times go to the owner with fewer entries so far, then to the smaller index, so that
    owners whose time does not depend on the number of cameras share them evenly."""
    lengths = [len(times) for times in times_s]
    owners = np.repeat(np.arange(len(lengths)), lengths)
    ranks = np.concatenate([np.arange(length) for length in lengths])
    times = np.concatenate(times_s)
    order = np.lexsort((owners, ranks, times))[:num_slots]
    return owners[order], times[order]


def _flat_indices(slots: NDArray[np.int64], lengths: Sequence[int]) -> NDArray[np.int64]:
    """Index of each slot in the concatenated lists: an owner's k-th slot is its k-th entry."""
    starts = np.cumsum([0, *lengths[:-1]])
    flat = np.empty(len(slots), dtype=np.int64)
    by_owner = np.argsort(slots, kind="stable")
    first = np.searchsorted(slots[by_owner], np.arange(len(lengths)))
    flat[by_owner] = np.arange(len(slots)) - first[slots[by_owner]] + starts[slots[by_owner]]
    return flat


def _from_zero(values: FloatArray) -> FloatArray:
    return np.concatenate([[0.0], values])


def _monotone(times_s: FloatArray) -> FloatArray:
    # Rounding of c ** exponent and of the sums may fall by a last digit where the law cannot.
    return np.maximum.accumulate(times_s)
