"""A longer makespan for shorter ways: the cameras each edge can do within slack · the bound.

With capacities u_e = max { c : T^m(c) ≤ slack · T* } the cameras go where Σ ‖camera − edge‖² is
least (`capped_transport`). At slack 1 the makespan is still the bound, with counts that suit the
land better than those of the deadline alone. Runs once per slack.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radiant_core.plan.counts.deadline import edge_table
from radiant_core.plan.counts.wide_deadline import SMALL_TABLE_ENTRIES, fastest_edge_counts, system_capacity
from radiant_core.plan.system import Edge, System


def capacities_within(system: System, num_cameras: int, deadline_s: float) -> NDArray[np.int64]:
    """Cameras (E,) that each edge can be done with by the deadline, up to `num_cameras`."""
    return np.array([_capacity(edge, num_cameras, deadline_s) for edge in system.edges], np.int64)


def _capacity(edge: Edge, num_cameras: int, deadline_s: float) -> int:
    alone = System(edges=(edge,))
    if num_cameras * len(alone.workers) <= SMALL_TABLE_ENTRIES:
        return int(edge_table(edge, num_cameras).edge_time_s.searchsorted(deadline_s, side="right")) - 1
    low, high = 0, system_capacity(alone, num_cameras)
    high = min(high, num_cameras)
    while low < high:
        middle = (low + high + 1) // 2
        in_time = float(fastest_edge_counts(alone, middle).edge_time_s[0]) <= deadline_s
        low, high = (middle, high) if in_time else (low, middle - 1)
    return low
