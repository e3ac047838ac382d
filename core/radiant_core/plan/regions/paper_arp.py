"""The paper's Adaptive Region Planning (Alg. 1) on a power diagram, for comparison only.

    R ← Voronoi(P);  while max_m |T^m − T̄| > T_thres:
        m* ← argmax_m |T^m − T̄|;  move the boundary of m* by d

Moving the boundary of m* is read as a weight change Δw = ∓ 2 d ‖P_m* − P_nearest‖: its border to
the nearest edge moves by d along the normal, those to farther edges by less, and the cells stay a
partition (Eqn. 9, 10), unlike moved half-planes. With a fixed d the loop often cycles; weights are
whole numbers of steps: a state seen before proves it, and the best partition is returned. O(C·E)
per iteration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiant_core.numerics import FloatArray
from radiant_core.plan.counts.deadline import EdgeTable
from radiant_core.plan.regions.paper_config import PaperConfig
from radiant_core.plan.regions.power_diagram import assign


@dataclass(frozen=True, kw_only=True, eq=False)
class PaperRegions:
    """The best partition seen: weights (E,) m², cell of each camera (C,), makespan in seconds after
    each iteration."""

    weights: FloatArray
    edge_of_camera: NDArray[np.int64]
    history: tuple[float, ...]
    converged: bool


def paper_regions(
    positions: FloatArray, sites: FloatArray, tables: Sequence[EdgeTable], boundary_step_m: float, config: PaperConfig
) -> PaperRegions:
    """Run Alg. 1 for cameras (C,2) m and edges (E,2) m; best = fewest cameras over the memory
    limits, then smallest makespan."""
    weight_of_step = 2 * boundary_step_m * _nearest_site_m(sites)
    steps = np.zeros(len(sites), dtype=np.int64)
    best, best_key = steps, (np.inf, np.inf)
    history: list[float] = []
    visited: set[bytes] = set()
    while True:
        counts = np.bincount(assign(positions, sites, steps * weight_of_step), minlength=len(sites))
        times_s = estimated_times_s(tables, counts)
        history.append(float(times_s.max()))
        key = (_overfull(tables, counts), history[-1])
        if key < best_key:
            best, best_key = steps, key
        gaps_s = times_s - times_s.mean()
        converged = bool(np.abs(gaps_s).max() <= config.threshold * times_s.mean())
        if converged or len(history) > config.max_iterations or steps.tobytes() in visited:
            break
        visited.add(steps.tobytes())
        steps = steps.copy()
        outlier = int(np.abs(gaps_s).argmax())
        steps[outlier] += -1 if gaps_s[outlier] > 0 else 1
    weights = best * weight_of_step
    return PaperRegions(weights=weights, edge_of_camera=assign(positions, sites, weights), history=tuple(history), converged=converged)


def estimated_times_s(tables: Sequence[EdgeTable], counts: NDArray[np.int64]) -> FloatArray:
    """T^m (E,) in seconds; beyond an edge's capacity K, T^m(K) · c / K: Alg. 1 can shrink it."""
    return np.array([_estimated_time_s(table, int(count)) for table, count in zip(tables, counts, strict=True)])


def _estimated_time_s(table: EdgeTable, count: int) -> float:
    return float(table.edge_time_s[min(count, table.capacity)]) * max(count / max(table.capacity, 1), 1.0)


def _overfull(tables: Sequence[EdgeTable], counts: NDArray[np.int64]) -> int:
    return sum(max(int(count) - table.capacity, 0) for table, count in zip(tables, counts, strict=True))


def _nearest_site_m(sites: FloatArray) -> FloatArray:
    """Distance (E,) to the nearest other site; 0 for a single one, whose region cannot move."""
    if len(sites) == 1:
        return np.zeros(1)
    apart = np.hypot(*np.moveaxis(sites[:, None] - sites, -1, 0))
    np.fill_diagonal(apart, np.inf)
    return apart.min(axis=1)
