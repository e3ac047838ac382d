"""Cameras dealt to edges at the least Σ ‖camera − edge‖² within capacities, and proof by weights.

    minimise Σ_c ‖x_c − P_e(c)‖²   with at most u_e cameras at edge e

Optimal exactly where weights w ≤ 0 exist, w_e < 0 only at full edges, under which every camera is
in its power cell (the KKT conditions). Counts are guessed on boxes of cameras from the smoothed
dual and Newton's steps on the true counts; cameras are dealt with the guess (`transport`); then the
shortest chain of edges is taken while moving cameras along it shortens the sum (successive shortest
paths; Ahuja, Magnanti, Orlin, Network Flows, 1993, ch. 9), which ends in the optimum whatever the
guess. Once per plan with slack; a chain costs O(E² + cameras of its edges · E).
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array
from radiant_core.plan.regions.power_diagram import assign
from radiant_core.plan.regions.transport import Dealt, deal_with_counts

Indices = NDArray[np.int64]
_BOXES_PER_SIDE = 64
_CAMERAS_PER_BOX = 4
_NEWTON_STEPS = 10
_ROUNDING = 1e-14
"""Share of the largest squared distance per camera that a chain must win, so as not to cycle."""


def deal_within(positions: FloatArray, sites: FloatArray, capacities: Indices) -> Dealt:
    """Deal cameras at positions (C,2) m, about a local origin, to distinct sites (E,2) m, at most
    capacities (E,) to each; BadInput where these hold too few. In the result `violation_m2` is by
    how much the worst camera misses its cell among edges of positive capacity, `num_paths` the
    chains taken."""
    capacities = np.minimum(check_array("capacities", capacities, (len(sites),), np.int64), len(positions))
    if capacities.min(initial=0) < 0 or capacities.sum() < len(positions):
        raise BadInput(f"capacities sum to {capacities.sum()} for {len(positions)} cameras: give at least 0 each, together all cameras.")
    open_edges = np.flatnonzero(capacities)
    if not len(positions):
        return deal_with_counts(positions, sites, np.zeros(len(sites), np.int64))
    own_sites, limits = sites[open_edges], capacities[open_edges]
    counts, weights = _guess(positions, own_sites, limits)
    dealt = deal_with_counts(positions, own_sites, counts, weights=weights)
    flow = _Flow(positions, own_sites, limits, dealt)
    num_paths = flow.improve()
    weights = flow.middle_weights()
    edge_of_position = np.empty(len(positions), np.int64)
    for edge, members in zip(open_edges, flow.members, strict=True):
        edge_of_position[members] = edge
    out_weights = np.zeros(len(sites))
    out_weights[open_edges] = weights
    return Dealt(
        edge_of_position=edge_of_position,
        parts=np.zeros((0, 3), np.int64),
        weights=out_weights,
        violation_m2=flow.violation_m2(weights),
        num_rounds=dealt.num_rounds,
        num_paths=num_paths,
    )


class _Boxes:
    """Boxes of cameras: means (P,2), cameras (P,), and their counts, smooth in the weights."""

    def __init__(self, positions: FloatArray, sites: FloatArray) -> None:
        means, cameras, radii_m = _boxes(positions)
        self.cameras = cameras
        self.squared_m2 = np.sum((means[:, None] - sites) ** 2, axis=-1)
        # A box beside a border counts for both sides: where the border has moved by its radius,
        # powers differ by radius · gap of the sites.
        gaps_m = np.sort(np.hypot(*np.moveaxis(sites[:, None] - sites, -1, 0)), axis=1)[:, 1:2]
        gap_m = float(np.sqrt(np.mean(gaps_m**2))) if gaps_m.size else 1.0
        self.widths_m2 = gap_m * np.maximum(radii_m, 1e-4 * max(float(np.ptp(positions, axis=0).max()), gap_m))
        self.unit_m2 = float(np.median(self.widths_m2))

    def dual(self, weights: FloatArray, limits: FloatArray) -> tuple[float, FloatArray]:
        """(Σ_p c_p τ_p log Σ_e exp((w_e − d²_pe)/τ_p) − u·w) / C, c_p cameras; gradient (E,)."""
        highest, shares = self._shares(weights)
        total = float(self.cameras.sum())
        return float(self.cameras @ highest - limits @ weights) / total, (self.cameras @ shares - limits) / total

    def smooth_weights(self, limits: Indices) -> FloatArray:
        """Weights (E,) ≤ 0 with the least dual."""
        from scipy import optimize  # pyright: ignore[reportMissingTypeStubs]

        room, unit_m2 = limits.astype(np.float64), self.unit_m2

        def scaled(weights: FloatArray) -> tuple[float, FloatArray]:
            value, gradient = self.dual(weights * unit_m2, room)
            return value / unit_m2, gradient

        solver: Any = optimize
        solved = solver.minimize(scaled, np.zeros(len(limits)), jac=True, bounds=[(None, 0.0)] * len(limits))
        return np.minimum(solved.x * unit_m2, 0.0)

    def slopes(self, weights: FloatArray) -> FloatArray:
        """d counts / d weights (E,E)."""
        _, shares = self._shares(weights)
        weighted = shares * (self.cameras / self.widths_m2)[:, None]
        return np.diag(weighted.sum(axis=0)) - weighted.T @ shares

    def _shares(self, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        power = weights - self.squared_m2
        top = power.max(axis=1)
        raised = np.exp((power - top[:, None]) / self.widths_m2[:, None])
        sums = raised.sum(axis=1)
        return top + self.widths_m2 * np.log(sums), raised / sums[:, None]


def _boxes(positions: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Means (P,2), cameras (P,), radii (P,) m of boxes: columns, cut into rows, of equal counts."""
    per_side = int(np.clip(np.sqrt(len(positions) / _CAMERAS_PER_BOX), 1, _BOXES_PER_SIDE))
    columns = np.empty(len(positions), np.int64)
    columns[np.lexsort((positions[:, 1], positions[:, 0]))] = np.arange(len(positions)) * per_side // len(positions)
    order = np.lexsort((positions[:, 1], columns))
    first = np.searchsorted(columns[order], np.arange(per_side + 1))
    rows = (np.arange(len(positions)) - first[columns[order]]) * per_side // np.diff(first)[columns[order]]
    box = columns[order] * per_side + rows
    cameras = np.bincount(box, minlength=per_side**2).astype(np.float64)
    means = np.stack([np.bincount(box, weights=axis) for axis in positions[order].T], axis=1) / cameras[:, None]
    spread = np.bincount(box, weights=np.sum((positions[order] - means[box]) ** 2, axis=1))
    return means, cameras, np.sqrt(spread / cameras)


def _guess(positions: FloatArray, sites: FloatArray, limits: Indices) -> tuple[Indices, FloatArray]:
    """Counts (E,) within the limits near the optimum, and weights (E,) ≤ 0 near those for it."""
    boxes = _Boxes(positions, sites)
    weights = boxes.smooth_weights(limits)
    best, least = weights, np.inf
    for _ in range(_NEWTON_STEPS):
        excess = _cell_counts(positions, sites, weights) - limits
        is_active = (weights < 0) | (excess > 0)
        wrong = int(np.abs(excess[is_active]).sum())
        if wrong >= least:
            weights = (weights + best) / 2
            continue
        best, least = weights, wrong
        if wrong == 0:
            break
        slopes = boxes.slopes(weights)[np.ix_(is_active, is_active)]
        ridge = 1e-6 * float(np.trace(slopes)) / len(slopes) + 1e-12 * len(positions) / boxes.unit_m2
        step = np.zeros(len(sites))
        step[is_active] = np.linalg.solve(slopes + ridge * np.eye(len(slopes)), excess[is_active])
        weights = np.clip(weights - step, -2 * float(boxes.squared_m2.max()), 0.0)
    return _within(_cell_counts(positions, sites, best), limits), best


def _cell_counts(positions: FloatArray, sites: FloatArray, weights: FloatArray) -> Indices:
    return np.bincount(assign(positions, sites, weights), minlength=len(sites))


def _within(wanted: Indices, limits: Indices) -> Indices:
    """Counts (E,) cut at the limits; the excess goes to the others in proportion to their room."""
    counts = np.minimum(wanted, limits)
    room, excess = limits - counts, int(wanted.sum() - counts.sum())
    if excess:
        counts = counts + np.minimum(np.floor(room * (excess / room.sum())).astype(np.int64), room)
        room = limits - counts
        counts += np.diff(np.minimum(np.cumsum(room), wanted.sum() - counts.sum()), prepend=0)
    return counts


class _Flow:
    """The cameras of every edge, and for every pair of edges the least cost of moving one camera
    from the first to the second."""

    def __init__(self, positions: FloatArray, sites: FloatArray, limits: Indices, dealt: Dealt) -> None:
        self.positions, self.sites, self.limits = positions, sites, limits
        self.members = [np.flatnonzero(dealt.edge_of_position == index) for index in range(len(sites))]
        self.counts = np.array([len(members) for members in self.members])
        self.costs = np.full((len(sites), len(sites)), np.inf)
        self.movers = np.zeros((len(sites), len(sites)), np.int64)
        for index in range(len(sites)):
            self._look(index, np.arange(len(sites)))
        reach_m = float(np.abs(positions).max()) + float(np.abs(sites).max())
        self.least_gain = _ROUNDING * 2 * reach_m**2
        # Edges without cameras want none: theirs are the greatest weights that draw no camera away.
        used = self.counts > 0
        neutral_weights = (dealt.weights[used, None] + self.costs[used]).min(axis=0)
        self.weights = np.where(used, dealt.weights, neutral_weights)
        """Under which every camera is in its cell, whatever the limits."""

    def improve(self) -> int:
        """Take shortest chains until none shortens the sum; returns how many."""
        num_chains = 0
        while (self.counts < self.limits).any():
            distance, following = self._distances(self.counts < self.limits)
            self.weights = -distance
            first = int(np.where(self.counts > 0, distance, np.inf).argmin())
            if not distance[first] < -self.least_gain:
                break
            self._take(first, following)
            num_chains += 1
        return num_chains

    def middle_weights(self) -> FloatArray:
        """Weights (E,) ≤ 0 midway between the extremes that keep every camera in its cell and edges
        with room at 0."""
        room = self.counts < self.limits
        if not room.any():
            room = np.arange(len(room)) == int(self.weights.argmax())
            self.weights = self.weights - self.weights.max()
        self.weights = -self._distances(room)[0]
        least = np.where(room, 0.0, self.weights)
        reduced = self._reduced_costs().T
        raised = -self.weights
        while ((lower := (reduced + raised).min(axis=1)) < raised).any():
            raised = np.minimum(raised, lower)
        greatest = np.where(room, 0.0, self.weights + raised)
        return np.minimum((least + greatest) / 2, 0.0)

    def violation_m2(self, weights: FloatArray) -> float:
        """max over cameras and edges of how much nearer, in power, another edge is than its own."""
        return float(max(0.0, (weights - weights[:, None] - self.costs).max()))

    def _reduced_costs(self) -> FloatArray:
        """Costs (E,E) less the difference of weights; below 0 only by rounding, hence cut off."""
        return np.maximum(self.costs + self.weights[:, None] - self.weights, 0.0)

    def _distances(self, room: NDArray[np.bool_]) -> tuple[FloatArray, Indices]:
        """Cost (E,) of the cheapest chain from each edge to one with room, and its next edge, −1 at
        an end (Bellman, Ford)."""
        reduced = self._reduced_costs()
        distance = np.where(room, self.weights, np.inf)
        following = np.full(len(distance), -1)
        rows = np.arange(len(distance))
        while True:
            through = reduced + distance
            best = through.argmin(axis=1)
            shorter = through[rows, best] < distance
            if not shorter.any():
                # An edge without cameras leads nowhere and keeps its weight.
                return np.where(np.isfinite(distance), distance, 0.0) - self.weights, following
            distance = np.where(shorter, through[rows, best], distance)
            following = np.where(shorter, best, following)

    def _take(self, first: int, following: Indices) -> None:
        chain = [first]
        while (after := int(following[chain[-1]])) >= 0:
            chain.append(after)
        moves = [(here, int(self.movers[here, there]), there) for here, there in pairwise(chain)]
        cameras = [int(self.members[here][mover]) for here, mover, _ in moves]
        for here, mover, _ in moves:
            self._remove(here, mover)
        for (_, _, there), camera in zip(moves, cameras, strict=True):
            self._add(there, camera)
        self.counts[first] -= 1
        self.counts[chain[-1]] += 1

    def _remove(self, edge: int, mover: int) -> None:
        last = len(self.members[edge]) - 1
        self.members[edge][mover] = self.members[edge][last]
        self.members[edge] = self.members[edge][:last]
        stale = np.flatnonzero(self.movers[edge] == mover)
        self.movers[edge, self.movers[edge] == last] = mover
        self._look(edge, stale)

    def _add(self, edge: int, camera: int) -> None:
        self.members[edge] = np.append(self.members[edge], camera)
        costs = self._changes(edge, self.members[edge][-1:], np.arange(len(self.sites)))[0]
        nearer = costs < self.costs[edge]
        self.costs[edge, nearer] = costs[nearer]
        self.movers[edge, nearer] = len(self.members[edge]) - 1

    def _look(self, edge: int, others: Indices) -> None:
        """Find for each of the other edges (J,) the camera of `edge` cheapest to move there."""
        if not len(self.members[edge]):
            self.costs[edge] = np.inf
            self.costs[edge, edge] = 0.0
            return
        changes = self._changes(edge, self.members[edge], others)
        self.movers[edge, others] = changes.argmin(axis=0)
        self.costs[edge, others] = changes[self.movers[edge, others], np.arange(len(others))]

    def _changes(self, edge: int, cameras: Indices, others: Indices) -> FloatArray:
        """(K,J) ‖x − P_j‖² − ‖x − P_edge‖² of cameras (K,), edges (J,), about the sites' middle."""
        middles = (self.sites[others] + self.sites[edge]) / 2
        toward = 2 * (self.sites[edge] - self.sites[others])
        return self.positions[cameras] @ toward.T - np.sum(middles * toward, axis=1)
