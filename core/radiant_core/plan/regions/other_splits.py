"""Alg. 1 as written (`paper-literal`). Once per plan, O(C E) per iteration.

Every border of an edge's Voronoi cell moves by d along its normal, whatever the neighbour does.

Half-planes that move alone may overlap, where the first edge has the camera, or leave cameras in no
region: orphans.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from radiant_core.numerics import FloatArray
from radiant_core.plan.counts.deadline import EdgeTable
from radiant_core.plan.regions.paper_arp import estimated_times_s

Indices = NDArray[np.int64]
NOBODY = -1


def half_planes(
    positions: FloatArray, sites: FloatArray, tables: Sequence[EdgeTable], step_m: float, threshold_s: float, max_iterations: int
) -> tuple[Indices, tuple[float, ...]]:
    """Alg. 1 as written for cameras (C,2) m and edges (E,2) m with d = `step_m`: the last cells
    (C,), `NOBODY` for orphans, and the history of `move_borders`."""
    squared = np.sum((positions[:, None] - sites) ** 2, axis=-1)
    apart = np.hypot(*np.moveaxis(sites[:, None] - sites, -1, 0))
    beyond_m = np.full(squared.shape, -np.inf)
    for edge in range(len(sites)):
        others = np.flatnonzero(apart[edge] > 0)
        if len(others):
            beyond_m[:, edge] = ((squared[:, [edge]] - squared[:, others]) / (2 * apart[edge, others])).max(axis=1)

    def cells(offsets: FloatArray) -> Indices:
        inside = beyond_m <= offsets * step_m
        return np.where(inside.any(axis=1), inside.argmax(axis=1), NOBODY)

    return move_borders(cells, tables, lambda _: threshold_s, False, max_iterations)


def move_borders(
    cells: Callable[[FloatArray], Indices],
    tables: Sequence[EdgeTable],
    threshold_s: Callable[[FloatArray], float],
    halved: bool,
    max_iterations: int,
) -> tuple[Indices, tuple[float, ...]]:
    """Lines 5–11 of Alg. 1 on offsets (E,) in steps, until the threshold, a state that was there
    before, or the limit; the last cells (C,), and max|T − T̄| / T̄ before each iteration."""
    offsets, length, last_turn = np.zeros(len(tables)), 1.0, np.zeros(len(tables))
    history: list[float] = []
    visited: set[bytes] = set()
    while True:
        edge_of_camera = cells(offsets)
        times_s = estimated_times_s(tables, np.bincount(edge_of_camera[edge_of_camera >= 0], minlength=len(tables)))
        gaps_s = times_s - times_s.mean()
        outlier = int(np.abs(gaps_s).argmax())
        history.append(float(abs(gaps_s[outlier]) / times_s.mean()) if times_s.mean() > 0 else 0.0)
        state = offsets.tobytes() + np.float64(length).tobytes()
        if abs(gaps_s[outlier]) <= threshold_s(times_s) or state in visited or len(history) > max_iterations:
            return edge_of_camera, tuple(history)
        visited.add(state)
        turn = -np.sign(gaps_s[outlier])
        if halved and last_turn[outlier] == -turn:
            length /= 2
        last_turn[outlier] = turn
        offsets = offsets.copy()
        offsets[outlier] += turn * length
