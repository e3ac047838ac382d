"""The order of an edge's devices along its strips that makes the seams between them shortest.

    minimise Σ_i chord(q_1 + … + q_i)     over orders q of the quotas,
    chord(k) = length of the cut after the k-th camera

A cut's place depends only on which devices stand before it, so the least sum is found over subsets
(Held, Karp, J. SIAM 1962); devices with equal quotas count once. Exact up to `MAX_STATES` subsets
(12 different quotas), beyond that the best of three orders, improved by exchanging two devices
while that helps. Runs once per edge and plan.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from radiant_core.numerics import FloatArray

MAX_STATES = 1 << 12
MAX_EXCHANGED = 100
"""Devices up to which exchanges are tried: each round is cubic in them."""
_STEPS = 1e9
"""Lengths are compared in billionths of the land's extent, so that no rounding decides between
orders that are equal by symmetry."""

Indices = NDArray[np.int64]


def shortest_order(quotas: Indices, names: Sequence[str], chords_m: FloatArray) -> Indices:
    """Indices (D',) of devices with cameras in the order of least seams, ties by name; `chords_m`
    (K+1,): the seam after k of K cameras."""
    working = sorted(np.flatnonzero(quotas).tolist(), key=lambda device: names[device])
    extent_m = float(chords_m.max())
    if len(working) < 2 or extent_m == 0:
        return np.array(working, np.int64)
    chords = np.round(chords_m / extent_m * _STEPS).astype(np.int64)
    chords[-1] = 0  # behind the last device there is no seam
    classes: dict[int, list[int]] = {}
    for device in working:
        classes.setdefault(int(quotas[device]), []).append(device)
    if np.prod([len(members) + 1.0 for members in classes.values()]) <= MAX_STATES:
        return _exact(classes, chords)
    return _improve(np.array(working, np.int64), quotas, chords)


def chords_across(border: FloatArray, axis: FloatArray, at: FloatArray) -> FloatArray:
    """Lengths (T,) m of a convex polygon's (V,2) cuts across the unit vector `axis` (2,) at
    coordinates (T,) along it."""
    if len(border) < 3:
        return np.zeros(len(at))
    along, across = border @ axis, border @ np.array([-axis[1], axis[0]])
    low, high = np.full(len(at), np.inf), np.full(len(at), -np.inf)
    for here, there, across_here, across_there in zip(along, np.roll(along, -1), across, np.roll(across, -1), strict=True):
        crossed = (at >= min(here, there)) & (at <= max(here, there))
        share = np.clip((at - here) / (there - here), 0, 1) if there != here else np.zeros(len(at))
        meets = across_here + share * (across_there - across_here)
        low, high = np.where(crossed, np.minimum(low, meets), low), np.where(crossed, np.maximum(high, meets), high)
    return np.where(high > low, high - low, 0.0)


def _exact(classes: dict[int, list[int]], chords: Indices) -> Indices:
    """The least sum over states: how many devices of each class stand already, in mixed radix."""
    sizes = np.array([len(members) for members in classes.values()])
    strides = np.concatenate([[1], np.cumprod(sizes + 1)[:-1]])
    states = np.arange(int(np.prod(sizes + 1)))
    standing = states[:, None] // strides % (sizes + 1)
    placed_at = chords[standing @ np.array(list(classes))]
    level = standing.sum(axis=1)
    costs = np.zeros(len(states), np.int64)
    never = np.iinfo(np.int64).max // 2
    for count in range(1, int(sizes.sum()) + 1):
        now = np.flatnonzero(level == count)
        before = np.where(standing[now] > 0, costs[now[:, None] - strides], never)
        costs[now] = placed_at[now] + before.min(axis=1)
    members = [list(devices) for devices in classes.values()]
    order: list[int] = []
    state = len(states) - 1
    while state:
        before = np.where(standing[state] > 0, costs[state - strides], never)
        last = int(np.flatnonzero(before == before.min())[-1])
        order.append(members[last].pop())
        state -= int(strides[last])
    return np.array(order[::-1], np.int64)


def _improve(working: Indices, quotas: Indices, chords: Indices) -> Indices:
    starts = (working, working[np.argsort(quotas[working], kind="stable")], working[np.argsort(-quotas[working], kind="stable")])
    order = min(starts, key=lambda start: int(chords[np.cumsum(quotas[start])].sum()))
    if len(order) > MAX_EXCHANGED:
        return order
    while True:
        ends = np.cumsum(quotas[order])
        least, exchange = 0, None
        for first in range(len(order) - 1):
            # Exchanging `first` and a later device moves the cuts between them by one amount.
            later = np.arange(first + 1, len(order))
            moved = ends[first:-1] + (quotas[order[later]] - quotas[order[first]])[:, None]
            between = np.arange(first, len(order) - 1) < later[:, None]
            change = np.where(between, chords[np.where(between, moved, 0)] - chords[ends[first:-1]], 0).sum(axis=1)
            if change.min() < least:
                least, exchange = int(change.min()), (first, int(later[change.argmin()]))
        if exchange is None:
            return order
        order[list(exchange)] = order[list(exchange[::-1])]
