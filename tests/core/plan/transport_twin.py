"""The slow, plain twin of `radiant_core.plan.regions.transport`, for any costs: the cheapest
dealing for given counts, and its weights.

    minimise Σ_c cost[c, edge_of_camera[c]]   with exactly counts[e] cameras at edge e

Start with every camera in its power cell for some weights, which is optimal for the counts it
happens to give; the weights come from a few sweeps that set one edge's count right at a time. Then
move one camera per step along the cheapest chain of edges from one that has too many to one that
has too few (successive shortest paths with potentials: Ahuja, Magnanti, Orlin, Network Flows, 1993,
ch. 9): it stays optimal for the counts it has. The graph has E nodes, not C. Runs once per plan: at
most C steps of O(C + E² + cameras of the edges on the chain × E).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from radiant_core.numerics import FloatArray

Indices = NDArray[np.int64]
_START_SWEEPS = 3


@dataclass(frozen=True, eq=False)
class _Moves:
    """extra_cost (E,E): cheapest change of cost when one camera of edge i moves to edge j, inf
    without cameras; camera (E,E)."""

    extra_cost: FloatArray
    camera: Indices

    def refresh(self, cost: FloatArray, edge_of_camera: Indices, edge: int) -> None:
        """Recompute row `edge` in place after its cameras changed."""
        members = np.flatnonzero(edge_of_camera == edge)
        if not len(members):
            self.extra_cost[edge] = np.inf
            return
        extra = cost[members] - cost[members, edge][:, None]
        cheapest = extra.argmin(axis=0)
        self.extra_cost[edge] = extra[cheapest, np.arange(cost.shape[1])]
        self.camera[edge] = members[cheapest]


def assign_with_counts(cost: FloatArray, counts: Indices) -> Indices:
    """Edge (C,) of each camera: least total cost (C,E) for exactly the counts (E,), Σ = C."""
    assert counts.sum() == len(cost)
    assert counts.min() >= 0
    potentials = _start_weights(cost, counts)
    edge_of_camera = (cost - potentials).argmin(axis=1)
    moves = _cheapest_moves(cost, edge_of_camera)
    surplus = np.bincount(edge_of_camera, minlength=len(counts)) - counts
    while surplus.any():
        # Reduced costs are non-negative up to rounding; Dijkstra needs them so exactly.
        reduced = np.maximum(moves.extra_cost + potentials[:, None] - potentials, 0.0)
        chain, distances = _cheapest_chain(reduced, surplus)
        potentials += np.minimum(distances, distances[chain[-1]])
        for giver, taker in pairwise(chain):
            edge_of_camera[moves.camera[giver, taker]] = taker
        for edge in chain:
            moves.refresh(cost, edge_of_camera, edge)
        surplus[chain[0]] -= 1
        surplus[chain[-1]] += 1
    return edge_of_camera


def separating_weights(cost: FloatArray, edge_of_camera: Indices) -> FloatArray:
    """Weights (E,) with cost[c, own] − w[own] ≤ cost[c, e] − w[e] for every camera c and edge e
    that has cameras.

    They exist where the assignment is optimal for its counts. All of them form a convex set bounded
    by shortest distances between edges; the mean of its extreme points is taken, so that borders
    run between cameras and not through one wherever there is room. Edges without cameras get weight
    0. Mean weight of the others 0. O(E³).
    """
    used = np.unique(edge_of_camera)
    distances = _cheapest_moves(cost, edge_of_camera).extra_cost[np.ix_(used, used)]
    for middle in range(len(used)):
        np.minimum(distances, distances[:, middle, None] + distances[middle], out=distances)
    np.fill_diagonal(distances, 0.0)  # rounding may have left cycles of −1e-16
    weights = np.zeros(cost.shape[1])
    weights[used] = (distances.mean(axis=0) - distances.mean(axis=1)) / 2
    return weights


def largest_violation(cost: FloatArray, weights: FloatArray, edge_of_camera: Indices) -> float:
    """How far the worst camera is outside its cell: max_c (own − min_e) of cost[c, e] − w[e]."""
    power = cost - weights
    return float((power[np.arange(len(cost)), edge_of_camera] - power.min(axis=1)).max(initial=0.0))


def _start_weights(cost: FloatArray, counts: Indices) -> FloatArray:
    """Weights (E,) whose power cells hold about `counts` cameras; any weights would do, these save
    steps.

    A camera is in the cell of e while w_e > cost[c, e] − min over the others: w_e goes between the
    counts[e]-th and the next of these gaps. A sweep costs C E², the steps it saves up to C², so it
    is left out where edges are many.
    """
    num_cameras, num_edges = cost.shape
    weights = np.zeros(num_edges)
    if num_edges == 1 or num_edges**2 > num_cameras:
        return weights
    power = cost.copy()
    for edge in [*range(num_edges)] * _START_SWEEPS:
        power[:, edge] = np.inf
        gaps = cost[:, edge] - power.min(axis=1)
        ranks = np.clip([counts[edge] - 1, counts[edge]], 0, num_cameras - 1)
        weights[edge] = np.partition(gaps, ranks)[ranks].mean()
        power[:, edge] = cost[:, edge] - weights[edge]
    return weights


def _cheapest_moves(cost: FloatArray, edge_of_camera: Indices) -> _Moves:
    num_edges = cost.shape[1]
    moves = _Moves(np.full((num_edges, num_edges), np.inf), np.zeros((num_edges, num_edges), dtype=np.int64))
    for edge in range(num_edges):
        moves.refresh(cost, edge_of_camera, edge)
    return moves


def _cheapest_chain(reduced: FloatArray, surplus: Indices) -> tuple[list[int], FloatArray]:
    """Dijkstra over the edges (E,E) from all with too many cameras to the nearest with too few: the
    chain, and distances (E,)."""
    distances = np.where(surplus > 0, 0.0, np.inf)
    previous = np.full(len(surplus), -1)
    done = np.zeros(len(surplus), dtype=bool)
    while True:
        nearest = int(np.where(done, np.inf, distances).argmin())
        if surplus[nearest] < 0:
            break
        done[nearest] = True
        reached = distances[nearest] + reduced[nearest]
        closer = (reached < distances) & ~done
        distances[closer] = reached[closer]
        previous[closer] = nearest
    chain = [nearest]
    while previous[chain[-1]] >= 0:
        chain.append(int(previous[chain[-1]]))
    return chain[::-1], distances
