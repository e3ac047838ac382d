"""Which views add most to what is known: greedily, by expected gain. Once per proposal.

    gain of a view = Σ over facets that it sees of  area · (log det(J + A) − log det J) / 2

J: what is known (`sightings`), A: what the view would add; nats times area. The sum is submodular
and rises with every view, so that the greedy choice has at least 1 − 1/e of the best gain of as
many views (Nemhauser et al., Math. Programming 14, 1978), and a gain from an earlier round bounds
today's: only views whose old gain could win are counted anew (Minoux 1978). It is the expected
information about places of facets, as FisherRF's (arXiv 2311.17874) about Gaussians.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiant_core.geometry.support import MIN_PARALLAX_DEG, MIN_VIEWS
from radiant_core.next_flight.facets import Facets
from radiant_core.next_flight.sightings import Knowledge, Sighting, log_det
from radiant_core.numerics import FloatArray

Mask = NDArray[np.bool_]
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


def gain_of(information: FloatArray, areas: FloatArray, sighting: Sighting) -> FloatArray:
    """Gain (R,) at each facet that a view sees, by J (K,6) of all."""
    before = information[sighting.rows]
    return areas[sighting.rows] * (log_det(before + sighting.information()) - log_det(before)) / 2


def choose_views(
    facets: Facets,
    knowledge: Knowledge,
    sightings: Sequence[Sighting],
    count: int,
    report: Callable[[int, int], None] = lambda num_done, total: None,
) -> tuple[Chosen, ...]:
    """At most `count` of the candidates that would see `sightings`, each once, best first; fewer
    where no other adds anything."""
    information = knowledge.information.copy()
    views, parallax_known = knowledge.num_views.copy(), ~knowledge.weak
    heap = [(-float(gain_of(information, facets.areas, sighting).sum()), row, 0) for row, sighting in enumerate(sightings)]
    heapq.heapify(heap)
    chosen: list[Chosen] = []
    while heap and len(chosen) < count:
        bound, row, counted_at = heapq.heappop(heap)
        if counted_at < len(chosen):
            heapq.heappush(heap, (-float(gain_of(information, facets.areas, sightings[row]).sum()), row, len(chosen)))
            continue
        if not -bound > 0:
            break
        sighting = sightings[row]
        gains = gain_of(information, facets.areas, sighting)
        is_unseen = views[sighting.rows] == 0
        chosen.append(_with_reason(facets, sighting, row, gains, is_unseen, ~is_unseen & ~parallax_known[sighting.rows]))
        information[sighting.rows] += sighting.information()
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
