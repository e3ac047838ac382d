"""Which views add most to what is known: greedily, by expected gain. Once per proposal.

    covered(f, b)  = max over views v of f  exp(−(∠(b, d_v) / 20°)²) · √min(1, g / g_v)
    gain of a view = Σ over facets f that it sees  area · mean over b of the rise of covered(f, b)

b: directions spread evenly over those from which a facet can be looked at; d_v: direction to the
camera, g_v: GSD, g: what is usual. A facet is worth nothing until a view shows it, a second view
from the same side adds next to nothing, one from another side adds the depth and the look from
there. Unlike information about places (FisherRF, arXiv 2311.17874; log det of `sightings`) it does
not reward what is known well already; docs/experiments/again.md compares both.

The sum is submodular and rises with every view, so that the greedy choice has at least 1 − 1/e of
the best gain of as many views (Nemhauser et al., Math. Programming 14, 1978), and a gain from an
earlier round bounds today's: only views whose old gain could win are counted anew (Minoux 1978).
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiant_core.geometry.support import MIN_PARALLAX_DEG, MIN_VIEWS
from radiant_core.next_flight.facets import Facets
from radiant_core.next_flight.sightings import MIN_FACING, Knowledge, Sighting
from radiant_core.numerics import FloatArray

Mask = NDArray[np.bool_]
COMPARED_FACETS = 8_000
"""At most so many facets of a surface are asked of every candidate: enough for a sum over them."""
NUM_DIRECTIONS = 48
WIDTH_RAD = float(np.radians(20))
"""How far from its direction a view still shows a facet as it looks."""
LEAST_SHARE = 0.05
"""A smaller share of the gain is no reason."""


@dataclass(frozen=True, kw_only=True)
class Chosen:
    """A view of a proposal and why: row of the candidate, gain, and the part of the gain, in shares
    that sum to 1, from facets that nothing saw, that were weak, and all others; unseen_area and
    weak_area: how much of either it sees, walls: share of that on walls."""

    row: int
    gain: float
    from_unseen: float
    from_weak: float
    unseen_area: float
    weak_area: float
    walls: float

    @property
    def from_finer(self) -> float:
        """Share of the gain at facets that were known already."""
        return max(0.0, 1.0 - self.from_unseen - self.from_weak)

    def reason(self, unit: str) -> str:
        """In a sentence, areas in square units."""
        parts = [
            (self.from_unseen, f"{self.unseen_area:.0f} {unit}² that no photograph shows"),
            (self.from_weak, f"{self.weak_area:.0f} {unit}² of fewer than {MIN_VIEWS} views or {MIN_PARALLAX_DEG:g}° parallax"),
            (self.from_finer, "surface known already, from another side or finer"),
        ]
        phrases = [f"{100 * share:.0f} %: {label}" for share, label in sorted(parts, key=lambda part: -part[0]) if share >= LEAST_SHARE]
        needed = self.from_unseen + self.from_weak >= LEAST_SHARE
        on_walls = f"; {100 * self.walls:.0f} % of the unseen or weak surface is walls" if needed else ""
        return f"gain {self.gain:.0f}, {', '.join(phrases)}{on_walls}"


class Coverage:
    """How well the directions from which facets (K) can be looked at are covered by views: b as N
    points of a Fibonacci lattice, `covered` (K,N), 0 to 1."""

    def __init__(self, facets: Facets, usual_gsd: float) -> None:
        self.areas = facets.areas
        self.usual_gsd = usual_gsd
        self._directions = _lattice(NUM_DIRECTIONS)
        faced = (facets.normals.astype(np.float32) @ self._directions.T > MIN_FACING).astype(np.float32)
        self._shares = faced / np.maximum(faced.sum(axis=1, keepdims=True), 1)
        self.covered = np.zeros_like(faced)

    def gain_of(self, sighting: Sighting) -> FloatArray:
        """Gain (R,) at each facet that a view sees, in units of area."""
        rise = np.maximum(self._by(sighting) - self.covered[sighting.rows], 0)
        return self.areas[sighting.rows] * (rise * self._shares[sighting.rows]).sum(axis=1, dtype=np.float64)

    def add(self, sighting: Sighting) -> None:
        """Count a view as taken."""
        self.covered[sighting.rows] = np.maximum(self.covered[sighting.rows], self._by(sighting))

    def _by(self, sighting: Sighting) -> NDArray[np.float32]:
        """What one view covers (R,N) of its facets."""
        angles = np.arccos(np.clip(sighting.toward @ self._directions.T, -1, 1))
        fineness = np.sqrt(np.minimum(1, self.usual_gsd / sighting.gsd))
        return (np.exp(-np.square(angles / WIDTH_RAD)) * fineness[:, None]).astype(np.float32)


def _lattice(count: int) -> NDArray[np.float32]:
    """Unit vectors (N,3) spread evenly over the sphere."""
    number = np.arange(count) + 0.5
    z, turn = 1 - 2 * number / count, number * np.pi * (3 - np.sqrt(5))
    level = np.sqrt(1 - z * z)
    return np.column_stack([level * np.cos(turn), level * np.sin(turn), z]).astype(np.float32)


def choose_views(
    facets: Facets,
    knowledge: Knowledge,
    flown: Sequence[Sighting],
    sightings: Sequence[Sighting],
    count: int,
    report: Callable[[int, int], None] = lambda num_done, total: None,
) -> tuple[Chosen, ...]:
    """At most `count` of the candidates that would see `sightings`, each once, best first; fewer
    where no other adds anything. knowledge: by the photographs that saw `flown`."""
    gsds = [sighting.gsd for sighting in flown if len(sighting.gsd)] or [sighting.gsd for sighting in sightings]
    coverage = Coverage(facets, float(np.median(np.concatenate(gsds))) if gsds else 1.0)
    for sighting in flown:
        coverage.add(sighting)
    views, parallax_known = knowledge.num_views.copy(), ~knowledge.weak
    heap = [(-float(coverage.gain_of(sighting).sum()), row, 0) for row, sighting in enumerate(sightings)]
    heapq.heapify(heap)
    chosen: list[Chosen] = []
    while heap and len(chosen) < count:
        bound, row, counted_at = heapq.heappop(heap)
        if counted_at < len(chosen):
            heapq.heappush(heap, (-float(coverage.gain_of(sightings[row]).sum()), row, len(chosen)))
            continue
        if not -bound > 0:
            break
        sighting = sightings[row]
        gains = coverage.gain_of(sighting)
        is_unseen = views[sighting.rows] == 0
        chosen.append(_with_reason(facets, sighting, row, gains, is_unseen, ~is_unseen & ~parallax_known[sighting.rows]))
        coverage.add(sighting)
        # From the second view on a facet counts as known: candidates of one place are one view.
        parallax_known[sighting.rows] |= views[sighting.rows] > 0
        views[sighting.rows] += 1
        parallax_known[sighting.rows[is_unseen]] = False
        report(len(chosen), count)
    return tuple(chosen)


def _with_reason(facets: Facets, sighting: Sighting, row: int, gains: FloatArray, is_unseen: Mask, is_weak: Mask) -> Chosen:
    areas, is_wall = facets.areas[sighting.rows], facets.is_wall[sighting.rows]
    total = float(gains.sum())
    needed = is_unseen | is_weak
    return Chosen(
        row=row,
        gain=total,
        from_unseen=float(gains[is_unseen].sum()) / total,
        from_weak=float(gains[is_weak].sum()) / total,
        unseen_area=float(areas[is_unseen].sum()),
        weak_area=float(areas[is_weak].sum()),
        walls=float(areas[needed & is_wall].sum()) / max(float(areas[needed].sum()), 1e-12),
    )
