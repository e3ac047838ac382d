"""What a seam costs: how much worse photographs show the ground beyond a border than the ground
before it. Once per run: a render and a comparison per training photograph.

A photograph taken on one side of a border between two edges often shows the ground on both. Where
models were only cut there, the near ground was learnt from it and the far ground without it. With
MSE over the pixels within a band of the border, per photograph and border
    d = 10 log10 (MSE beyond the border / MSE before it)
    excess = mean over borders and their two sides of the mean of d over that side's photographs.
A model learnt as one has seen both sides in all training photographs, so that its excess is near
zero: what is hard on one side is before the border for some photographs and beyond it for others. A
seam is found where the bootstrap over photographs bounds the excess from below by more than
`MARGIN_DB`. Photographs that a model was not trained on say nothing here.

A machine with photographs computes their `BorderError`, two figures each, and sends those.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.evaluate.bootstrap import paired_bootstrap
from radiant_core.evaluate.borders import EdgeBorders, edge_owners
from radiant_core.evaluate.ground_places import ground_places
from radiant_core.evaluate.image_pair import Used
from radiant_core.plan.plans import CloudPlan

if TYPE_CHECKING:
    from radiant_core.render.rendered_view import RenderedView

MARGIN_DB = 0.25
"""Distance and slant alone may cost as much beyond a border: docs/experiments/borders.md."""
BAND = 0.1
"""Width of the ground on either side of a border, as a share of the least distance of two edges.
With half of it plain cuts scored less; with more, slant takes part and bounds are no better."""
MIN_PHOTOGRAPHS = 3
"""Of either side of a border; with fewer it has no figure."""
MIN_SHARE = 0.002
"""Share of a photograph's pixels that must lie in the band before a border, and beyond it."""
OPAQUE = 0.5
"""Where the model covers a pixel less, no place is known. To leave out also what lies on the edges
of depth, as `seam_masks` does, cost power: that is where a cut model is wrong."""
LEAST_MSE = 1e-6
"""Added to both errors: 60 dB and no error at all are the same."""


@dataclass(frozen=True, kw_only=True)
class BorderError:
    """Errors of one photograph at one border, MSE of colours in 0..1 in dB (larger is worse)."""

    side: str
    """Edge in whose region the camera stands, or looks if the plan was cut by that."""
    beyond: str
    """Edge on the other side of the border."""
    before_db: float
    beyond_db: float


@dataclass(frozen=True, kw_only=True)
class SeamExcess:
    """Mean excess over borders and its lower bound; None with a reason where too little is seen."""

    excess_db: float | None
    at_least_db: float | None
    """One-sided 95 % bound."""
    num_photographs: int
    """Photographs of borders that have a figure, counted once per border."""

    @property
    def has_seam(self) -> bool | None:
        """Whether there is a seam; None where nothing can be said."""
        return None if self.at_least_db is None else self.at_least_db > MARGIN_DB

    @property
    def reason(self) -> str | None:
        """Why there is no figure, or None when there is one."""
        if self.excess_db is not None:
            return None
        return f"insufficient: no border is seen, on both of its sides, by {MIN_PHOTOGRAPHS} training photographs of either side"


def border_errors(
    cameras: Cameras,
    renders: Iterable[RenderedView],
    photographs: Iterable[NDArray[np.floating]],
    plan: CloudPlan,
    used: Sequence[Used] | None = None,
) -> Iterator[BorderError]:
    """Errors of C training photographs (H,W,3) in 0..1 at every border whose two sides they show.

    `renders` are those of the judged model, whose depths say which ground a pixel shows. Pictures
    come one at a time. Raises BadInput when sizes differ or values near a border are not finite.
    """
    half_band_m = _half_band_m(plan)
    if half_band_m is None:
        return
    sides = edge_owners(cameras.centers[:, :2] if plan.looks is None else plan.places_of(cameras.centers[:, :2]), plan)
    for index, (view, photograph) in enumerate(zip(renders, photographs, strict=True)):
        if view.image.shape != photograph.shape:
            raise BadInput(f"the render of {view.name!r} has the shape {view.image.shape}, its photograph {photograph.shape}.")
        places = ground_places(cameras, index, view.depth)
        valid = np.isfinite(places).all(axis=2) & (view.alpha >= OPAQUE)
        pixels = None if used is None else used[index]
        valid = valid if pixels is None else valid & pixels
        row, column = np.nonzero(valid)
        of_known = places[row, column]
        nearest, side = EdgeBorders(plan=plan).nearest(of_known), int(sides[index])
        # Errors and owners of the band alone: most pixels are far from a border.
        band = np.flatnonzero((nearest.distance_m <= half_band_m) & (nearest.pair == side).any(axis=1))
        pair, owners, at = nearest.pair[band], edge_owners(of_known[band], plan), (row[band], column[band])
        squared = ((view.image[at].astype(np.float64) - photograph[at]) ** 2).mean(axis=1)
        for neighbour in np.setdiff1d(pair, [side]):
            at_border = (pair == neighbour).any(axis=1)
            before, beyond = squared[at_border & (owners == side)], squared[at_border & (owners == neighbour)]
            if min(len(before), len(beyond)) >= MIN_SHARE * valid.size:
                names = {"side": plan.edge_ids[side], "beyond": plan.edge_ids[neighbour]}
                yield BorderError(**names, before_db=_mean_db(before), beyond_db=_mean_db(beyond))


def pooled_excess(errors: Iterable[BorderError]) -> SeamExcess:
    """The excess over all borders, whichever machines the errors come from."""
    groups: dict[tuple[str, str], list[tuple[float, float]]] = {}
    # Sorted, so that neither the order of the machines nor that of their photographs matters.
    for error in sorted(errors, key=lambda error: (error.side, error.beyond, error.beyond_db - error.before_db)):
        groups.setdefault((error.side, error.beyond), []).append((error.before_db, error.beyond_db))
    judged = {key for key, rows in groups.items() if len(rows) >= MIN_PHOTOGRAPHS}
    both = sorted(key for key in judged if key[::-1] in judged)
    if not both:
        return SeamExcess(excess_db=None, at_least_db=None, num_photographs=0)
    before, beyond = ([np.array([[row[part] for row in groups[key]]]) for key in both] for part in (0, 1))
    difference = paired_bootstrap(beyond, before)
    num_photographs = sum(len(groups[key]) for key in both)
    return SeamExcess(excess_db=difference.mean, at_least_db=difference.at_least, num_photographs=num_photographs)


def excess_by_border(errors: Iterable[BorderError]) -> dict[tuple[str, str], SeamExcess]:
    """The excess of every border that any of the photographs shows both sides of."""
    groups: dict[tuple[str, str], list[BorderError]] = {}
    for error in errors:
        first, second = sorted((error.side, error.beyond))
        groups.setdefault((first, second), []).append(error)
    return {border: pooled_excess(groups[border]) for border in sorted(groups)}


def _half_band_m(plan: CloudPlan) -> float | None:
    """`BAND` of the least distance between two edges, on either side; None where there is one."""
    gaps_m = np.linalg.norm(plan.sites[:, None] - plan.sites, axis=2)
    return BAND * float(gaps_m[gaps_m > 0].min()) if (gaps_m > 0).any() else None


def _mean_db(squared: NDArray[np.floating]) -> float:
    mean = float(squared.mean())
    if not np.isfinite(mean):
        raise BadInput("a render or photograph has values that are not finite near a border: check the model it came from.")
    return 10 * float(np.log10(mean + LEAST_MSE))
