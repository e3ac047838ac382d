"""The line that a drone flies through chosen views: short, safe, with climbs where it must. Once
per device, O(P²) a round of 2-opt; P places.

A leg is safe where every point of it is (`Air`), checked at every half cell. A leg that is not is
flown higher: straight up, across, straight down. A leg across land that is not flown over goes
along the corners around it, by the shortest way (Dijkstra over the corners that see each other).
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra

from radiant_core.errors import BadInput
from radiant_core.next_flight.candidates import Air, usual_take_off
from radiant_core.numerics import FloatArray

MAX_ROUNDS, NUM_STARTS = 50, 16
CORNER_CELLS = 1.0
"""Corners are passed so many cells outside."""
HEADROOM = 1.5
"""Around eight of the generator's towns the tallest thing is at most 1.45 times as tall as the
tallest within."""


def shortest_order(places: FloatArray) -> NDArray[np.int64]:
    """An order (P,) of places (P,3) to fly by, home again at its end: from each to its nearest,
    then by turning parts round until none gets shorter (2-opt); the best of `NUM_STARTS`
    beginnings."""
    count = len(places)
    if count < 4:
        return np.arange(count)
    far = np.linalg.norm(places[:, None] - places[None], axis=2)
    starts = np.unique(np.linspace(0, count - 1, NUM_STARTS).astype(np.int64))
    tours = [_untangled(far, _by_nearest(far, int(start))) for start in starts]
    return _from_longest_leg(far, min(tours, key=lambda tour: _length(far, tour)))


def _by_nearest(far: FloatArray, start: int) -> NDArray[np.int64]:
    order, unvisited = [start], np.ones(len(far), bool)
    unvisited[start] = False
    while unvisited.any():
        order.append(int(np.where(unvisited, far[order[-1]], np.inf).argmin()))
        unvisited[order[-1]] = False
    return np.array(order, np.int64)


def _untangled(far: FloatArray, tour: NDArray[np.int64]) -> NDArray[np.int64]:
    count = len(tour)
    for _ in range(MAX_ROUNDS):
        before = _length(far, tour)
        for first in range(count - 2):
            after = np.arange(first + 2, count)
            ends = tour[(after + 1) % count]
            change = far[tour[first], tour[after]] + far[tour[first + 1], ends] - far[tour[first], tour[first + 1]] - far[tour[after], ends]
            best = int(change.argmin())
            if change[best] < -1e-9:
                last = int(after[best])
                tour[first + 1 : last + 1] = tour[first + 1 : last + 1][::-1].copy()
        if not _length(far, tour) < before - 1e-9:
            break
    return tour


def _length(far: FloatArray, tour: NDArray[np.int64]) -> float:
    return float(far[tour, np.roll(tour, -1)].sum())


def _from_longest_leg(far: FloatArray, tour: NDArray[np.int64]) -> NDArray[np.int64]:
    """The round trip begun behind its longest leg, which is then the way home."""
    longest = int(far[tour, np.roll(tour, -1)].argmax())
    return np.roll(tour, -longest - 1)


def safe_way(air: Air, places: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
    """The way (Q,3) through places (P,3) in their order, and of each of its points the place that
    it is, or −1 where it is only passed. BadInput where a leg would have to climb beyond the
    highest allowed, or no way leads around the land that is not flown over."""
    way, owner = [places[0]], [0]
    for index, (start, end) in enumerate(pairwise(places)):
        between = _between(air, start, end)
        way += [*between, end]
        owner += [-1] * len(between) + [index + 1]
    return np.array(way), np.array(owner, np.int64)


def low_over_unknown(air: Air, places: FloatArray) -> NDArray[np.bool_]:
    """Which places (P,3) are within the safe distance of land that is not known, too low for what
    might stand there: `HEADROOM` times as tall above low ground as all that is known."""
    ground = usual_take_off(air.facets)
    return ~air.knows(places) & (places[:, 2] < ground + HEADROOM * (air.facets.highest - ground) + air.rules.safe)


def length_low_over_unknown(air: Air, way: FloatArray) -> float:
    """How much of a way (Q,3) is so."""
    return sum(
        float(np.linalg.norm(end - start)) * float(low_over_unknown(air, _along(air, start, end)).mean()) for start, end in pairwise(way)
    )


def _between(air: Air, start: FloatArray, end: FloatArray) -> list[FloatArray]:
    """What is passed on the way between two safe places."""
    line = shapely.LineString([start[:2], end[:2]])
    if not shapely.intersects(air.land, line) and air.is_safe(_along(air, start, end)).all():
        return []
    corners = _around(air, start[:2], end[:2])
    flat = [start[:2], *corners, end[:2]]
    ground = np.concatenate([_along(air, np.append(a, 0.0), np.append(b, 0.0)) for a, b in pairwise(flat)])
    height = max(float(air.floors_at(ground).max()), start[2], end[2])
    passed = [np.append(place, height) for place in flat]
    passed = [place for place in passed if (place != start).any() and (place != end).any()]
    lifted = np.column_stack([ground[:, :2], np.full(len(ground), height)])
    if not air.is_safe(lifted).all():
        raise BadInput(
            f"a leg of the flight needs {height - air.rules.take_off:.0f} above take-off to keep {air.rules.safe:g} from the surface, "
            f"more than the {air.rules.highest:g} that are allowed there: raise the upper limit or ask for fewer views."
        )
    return passed


def _along(air: Air, start: FloatArray, end: FloatArray) -> FloatArray:
    """Points (N,3) every half cell from start to end, with both."""
    count = int(np.ceil(2 * np.linalg.norm(end - start) / air.facets.surface.grid.cell)) + 1
    return start + np.linspace(0, 1, max(2, count))[:, None] * (end - start)


def _around(air: Air, start: FloatArray, end: FloatArray) -> list[FloatArray]:
    """Corners (2,) to pass from start to end outside of the land that is not flown over."""
    if not shapely.intersects(air.land, shapely.LineString([start, end])):
        return []
    margin = CORNER_CELLS * air.facets.surface.grid.cell
    wider = shapely.buffer(air.land, margin, join_style="mitre")
    nodes = np.concatenate([[start, end], np.unique(shapely.get_coordinates(wider), axis=0)])
    nodes = nodes[np.concatenate([[True, True], ~shapely.intersects_xy(air.land, nodes[2:])])]
    first, second = np.triu_indices(len(nodes), 1)
    lines = np.array([shapely.LineString(ends) for ends in np.stack([nodes[first], nodes[second]], axis=1)])
    is_free = ~shapely.intersects(air.land, lines)
    lengths = np.zeros((len(nodes), len(nodes)))
    lengths[first[is_free], second[is_free]] = shapely.length(lines[is_free])
    distances, before = dijkstra(lengths, directed=False, indices=0, return_predecessors=True)
    if not np.isfinite(distances[1]):
        raise BadInput("no way leads around the no-fly land from one view to the next: give less of it, or ask for fewer views.")
    path, at = list[FloatArray](), int(before[1])
    while at != 0:
        path.insert(0, nodes[at])
        at = int(before[at])
    return path
