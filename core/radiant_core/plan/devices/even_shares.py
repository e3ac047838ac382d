"""Equal shares: as many cameras for every device, whatever it can do (the paper's "Even", Sec. V).

    q_n = min(k_n, L) and one more for some with room
    k_n: what device n holds, L: the level at which all are dealt

What is left over goes to the first device of every edge, then to the second ones, so that edges of
equal numbers are equal too. An edge's count is the sum of its devices' shares; an edge known by its
curve alone counts as one device. Runs once per plan, O(D log D).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.plan.counts.deadline import aggregate_times_s, device_time_s
from radiant_core.plan.system import Edge, System

Counts = NDArray[np.int64]


def even_edge_counts(system: System, num_cameras: int) -> Counts:
    """Cameras per edge (E,), the sums of its devices' equal shares; BadInput where not all fit."""
    shares = _shares(system, num_cameras)
    firsts = np.cumsum([0, *(len(edge.workers) for edge in system.edges[:-1])])
    return np.add.reduceat(shares, firsts)


def even_quotas(edge: Edge, num_cameras: int) -> Counts:
    """Cameras per device (D,) of an edge; raises as `even_edge_counts`."""
    return _shares(System(edges=(edge,)), num_cameras)


def even_times_s(system: System, counts: Counts) -> FloatArray:
    """Seconds (E,) of each edge with equal shares: the slowest device, then joining and sending."""
    return np.array([_edge_time_s(edge, even_quotas(edge, int(count))) for edge, count in zip(system.edges, counts, strict=True)])


def _shares(system: System, num_cameras: int) -> Counts:
    """Cameras per device as equal as capacities allow: one level, some one camera above it."""
    capacities = np.array([num_cameras if d.max_cameras is None else min(d.max_cameras, num_cameras) for d in system.workers], np.int64)
    if capacities.sum() < num_cameras:
        raise BadInput(f"the devices can hold {capacities.sum()} of {num_cameras} cameras: raise max_cameras or add devices.")
    ordered = np.sort(capacities)
    levels = np.arange(num_cameras + 1)
    below = np.searchsorted(ordered, levels, side="left")
    filled = np.concatenate([[0], np.cumsum(ordered)])[below] + (len(ordered) - below) * levels
    level = int(np.searchsorted(filled, num_cameras, side="right")) - 1
    shares = np.minimum(capacities, level)
    places = np.concatenate([np.arange(len(edge.workers)) for edge in system.edges])
    in_turn = np.argsort(places, kind="stable")
    shares[in_turn[capacities[in_turn] > level][: num_cameras - int(shares.sum())]] += 1
    return shares


def _edge_time_s(edge: Edge, quotas: Counts) -> float:
    total, largest = int(quotas.sum()), int(quotas.max(initial=0))
    if not total:
        return 0.0
    slowest_s = max(float(device_time_s(device, count)) for device, count in zip(edge.workers, quotas, strict=True))
    sent_bytes = sum(float(device.model_bytes(count)) for device, count in zip(edge.workers, quotas, strict=True))
    joined_s = float(aggregate_times_s(edge, total, total if largest == total else 0))
    return slowest_s + joined_s + sent_bytes / edge.uplink_bytes_per_s
