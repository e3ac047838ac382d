"""Device models brought into one frame by what they show of common ground. Once per edge.

1. Neighbours: models with common ground (`frame_matches.find_overlap`), the best four of each.
2. Per pair: the similarity of both from points followed through renders (`frame_matches`), or by
   ICP (`surface_matches`). No photograph is read.
3. A pair that disagrees with the GPS of both by more than four standard deviations contradicts;
   what agrees holds models together. Of two groups that contradict each other the one with fewer
   photographs is refused, with the figures.
4. All agreeing pairs and GPS in one least squares (`frame_graph`), without pairs that loops refute;
   with `GPS_BIAS_M` where a model is moved by more than four standard deviations.
GPS stays the gauge: an error common to all models of a group is only averaged down.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.frames import FrameUncertainty, Sim3
from radiant_core.geometry.frame_graph import FrameEdge, SolvedFrames, edge_xi, solve_frames, spread_to, strains
from radiant_core.geometry.frame_matches import IDENTITY, Overlap, find_overlap, match_models
from radiant_core.geometry.open3d_ops import surface_points
from radiant_core.geometry.pair_fit import PairFit, xi_about
from radiant_core.geometry.surface_matches import icp_match
from radiant_core.numerics import FloatArray
from radiant_core.splats import Splats

GPS_BIAS_M = 1.5
"""What the GPS of two flights may differ by as a whole, per axis; residuals within one flight
cannot show it."""
MAX_SIGMAS = 4.0
BEND = np.array([0.3, 0.3, 0.3, 0.005, 0.005, 0.005, 0.005])
"""What models bend by (m, rad, 1) beyond the errors of their pairs: loops may stay open by this."""
LENS_BEND = np.array([0.0, 0.0, 0.0, 0.01, 0.01, 0.01, 0.01])
"""Standard deviations (m, rad, 1) of common ground against the whole of a model: from few
photographs a camera calibrates itself badly (brighton: two halves with focal lengths 3 % apart bent
so that their common strip differed by 3 % of scale)."""
MIN_SHARE = 0.05
EXPECTED_SHARE = 0.35
"""Models that have so much known ground in common match: on the town all pairs from 0.36 on did,
one with 0.10 did not."""
ALONE_MAX_SCALE = 0.05
ALONE_MAX_ROTATION_RAD = np.radians(5.0)
"""A model that no neighbour holds is not merged when GPS fixes its frame to no better than this."""
MAX_NEIGHBOURS = 4
MAX_SURFACE_SHARE = 0.03
"""Largest Gaussian of a surface, as a share of the extent of the cameras and what they look at."""

FrameStatus = Literal["ok", "refused", "alone"]
Report = Callable[[int, int, str], None]
"""Called with how many pairs are done, how many there are, and what comes next."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PlacedModel:
    """A trained model and its training cameras in the common frame (m, z up), and how well GPS or
    poses fix that frame."""

    splats: Splats
    cameras: Cameras
    uncertainty: FrameUncertainty
    name: str = ""
    """What reasons call it; by default its number."""

    def __post_init__(self) -> None:
        if not (len(self.cameras) and len(self.splats)):
            raise BadInput(f"a model to place has {len(self.splats)} Gaussians and {len(self.cameras)} cameras: leave empty ones out.")


@dataclass(frozen=True, kw_only=True, eq=False)
class RefinedFrame:
    """What became of one model's frame.

    ok: `correction` moves it to its neighbours. alone: no neighbour shares enough ground, it stays
    where GPS puts it. refused: do not merge it. `uncertainty` is what is left, GPS's own included;
    `residual_m` the distance left to its neighbours on common ground, None without any;
    `neighbours` are the indices of the models it was joined with; `reason` is one sentence.
    """

    status: FrameStatus
    correction: Sim3
    uncertainty: FrameUncertainty
    reason: str
    residual_m: float | None = None
    neighbours: tuple[int, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class _Pair:
    """A pair's outcome: a fit that agrees with GPS, one that contradicts it (`reason`), or none."""

    a: int
    b: int
    share: float
    fit: PairFit | None
    agrees: bool
    reason: str

    @property
    def edge(self) -> FrameEdge:
        assert self.fit is not None
        return FrameEdge(a=self.a, b=self.b, fit=self.fit)

    def partner_of(self, model: int) -> int:
        return self.b if model == self.a else self.a


def refine_frames(models: Sequence[PlacedModel], report: Report | None = None) -> tuple[RefinedFrame, ...]:
    """What to do with each of the M models: their corrections, or why one must not be merged."""
    surfaces = [surface_points(model.splats, _largest_m(model.cameras))[0] for model in models]
    overlaps = _neighbours(models, surfaces)
    pairs = []
    for num_done, ((a, b), overlap) in enumerate(overlaps.items()):
        if report is not None:
            report(num_done, len(overlaps), " and ".join(models[index].name or f"model {index + 1}" for index in (a, b)))
        pairs.append(_fit_pair(models, surfaces, (a, b), overlap))
    if report is not None:
        report(len(overlaps), len(overlaps), "all frames at once")
    centers = np.array([_middle(model) for model in models]).reshape(-1, 3)
    priors = [model.uncertainty for model in models]
    solved, used, dropped = _solve(centers, priors, [pair for pair in pairs if pair.agrees])
    group = _groups(len(models), used)
    sizes = [len(model.cameras) for model in models]
    named = [model.name or f"model {number}" for number, model in enumerate(models, 1)]
    refusals = _refusals(pairs, dropped, group, sizes, named)
    return tuple(_verdict(index, models[index], solved, used, refusals) for index in range(len(models)))


def _largest_m(cameras: Cameras) -> float:
    extent = float(np.linalg.norm(np.ptp(cameras.centers, axis=0)))
    return max(MAX_SURFACE_SHARE * extent, 1e-6)


def _middle(model: PlacedModel) -> FloatArray:
    return model.cameras.centers.mean(axis=0)


def _neighbours(models: Sequence[PlacedModel], surfaces: Sequence[FloatArray]) -> dict[tuple[int, int], Overlap]:
    """Pairs (a < b) with common ground: of each model the four best, and those chosen by others."""
    overlaps: dict[tuple[int, int], Overlap] = {}
    for a, b in combinations(range(len(models)), 2):
        overlap = find_overlap(surfaces[a], models[a].cameras, surfaces[b], models[b].cameras)
        if overlap is not None and overlap.share >= MIN_SHARE:
            overlaps[a, b] = overlap
    chosen = set()
    for index in range(len(models)):
        by_share = sorted((pair for pair in overlaps if index in pair), key=lambda pair: -overlaps[pair].share)
        chosen |= set(by_share[:MAX_NEIGHBOURS])
    return {pair: overlaps[pair] for pair in sorted(chosen)}


def _fit_pair(models: Sequence[PlacedModel], surfaces: Sequence[FloatArray], pair: tuple[int, int], overlap: Overlap) -> _Pair:
    a, b = pair
    fit = match_models(models[a].splats, models[b].splats, overlap)
    if isinstance(fit, str) and overlap.share >= EXPECTED_SHARE:
        a_points = surfaces[a][models[b].cameras.any_sees(surfaces[a])]
        b_points = surfaces[b][models[a].cameras.any_sees(surfaces[b])]
        radius_m = 2 * max(float(np.hypot(models[a].uncertainty.position_m, models[b].uncertainty.position_m)), 0.5)
        by_icp = icp_match(a_points, b_points, radius_m)
        fit = by_icp if isinstance(by_icp, PairFit) else f"{fit}, and {by_icp}"
    if isinstance(fit, str):
        return _Pair(a=a, b=b, share=overlap.share, fit=None, agrees=False, reason=fit)
    apart = xi_about(fit.center, fit.a_from_b)
    variances = np.diag(fit.covariance) + LENS_BEND**2
    variances = variances + sum(spread_to(fit.center, _middle(models[i]), models[i].uncertainty, GPS_BIAS_M) for i in pair)
    limits = MAX_SIGMAS * np.sqrt(variances)
    agrees = not _exceeds(apart, limits)
    reason = f"their common ground lies {_figures(apart)} apart, where GPS allows {_figures(limits / np.sqrt([3, 3, 3, 3, 3, 3, 1]))}"
    return _Pair(a=a, b=b, share=overlap.share, fit=fit, agrees=agrees, reason=reason)


def _exceeds(xi: FloatArray, limits: FloatArray) -> bool:
    """Whether shift, rotation or scale exceed their largest limit per axis."""
    lengths = [np.linalg.norm(xi[:3]), np.linalg.norm(xi[3:6]), abs(xi[6])]
    return bool((lengths > np.array([limits[:3].max(), limits[3:6].max(), limits[6]])).any())


def _figures(xi: FloatArray) -> str:
    return f"{np.linalg.norm(xi[:3]):.2f} m, {np.degrees(np.linalg.norm(xi[3:6])):.2f}° and {100 * abs(np.expm1(xi[6])):.2f} % of scale"


def _solve(centers: FloatArray, priors: list[FrameUncertainty], agreeing: list[_Pair]) -> tuple[SolvedFrames, list[_Pair], list[_Pair]]:
    """All frames from the pairs; with the bias of GPS where a model is moved further than its own
    residuals allow.

    Lenses that few photographs leave open bend models apart in height. GPS that fixes places to
    centimetres would have them tilted by degrees for it; with the bias they are shifted.
    """
    solution = _solve_without_open_loops(centers, priors, agreeing)
    if strains(solution[0], centers, priors).max(initial=0) <= MAX_SIGMAS:
        return solution
    biased = [replace(prior, position_m=float(np.hypot(prior.position_m, GPS_BIAS_M))) for prior in priors]
    return _solve_without_open_loops(centers, biased, agreeing)


def _solve_without_open_loops(
    centers: FloatArray, priors: list[FrameUncertainty], agreeing: list[_Pair]
) -> tuple[SolvedFrames, list[_Pair], list[_Pair]]:
    """All frames from the pairs; the worst pair is left out until no loop stays open."""
    used, dropped = list(agreeing), []
    while True:
        solved = solve_frames(centers, priors, [pair.edge for pair in used])
        excess = [_loop_excess(pair, solved) for pair in used]
        if not excess or max(excess) <= 1:
            return solved, used, dropped
        dropped.append(used.pop(int(np.argmax(excess))))


def _loop_excess(pair: _Pair, solved: SolvedFrames) -> float:
    """By how many times its limit a pair still misses after the solution."""
    edge = pair.edge
    missed = edge_xi(edge, solved.corrections[edge.a], solved.corrections[edge.b])
    return float((np.abs(missed) / (MAX_SIGMAS * np.sqrt(np.diag(edge.fit.covariance)) + BEND)).max())


def _groups(num_models: int, used: Sequence[_Pair]) -> list[int]:
    """The number (M,) of the group that each model is joined to."""
    group = list(range(num_models))
    for pair in used:
        group_a, group_b = group[pair.a], group[pair.b]
        group = [group_a if number == group_b else number for number in group]
    return group


def _refusals(pairs: Sequence[_Pair], dropped: Sequence[_Pair], group: list[int], sizes: list[int], named: list[str]) -> dict[int, str]:
    """The models that must not be merged, each with the reason.

    Of two groups that contradict each other it is the one with fewer photographs. A contradiction
    is a pair that disagrees with GPS or with the loops, or, for a model joined to no other, one
    that should match and does not.
    """
    photographs = {number: sum(size for size, label in zip(sizes, group, strict=True) if label == number) for number in set(group)}
    refusals: dict[int, str] = {}
    # From the largest group down, so that a refused model refuses no other.
    for pair in sorted(pairs, key=lambda pair: -max(photographs[group[pair.a]], photographs[group[pair.b]])):
        if group[pair.a] == group[pair.b]:
            continue
        small, large = sorted((pair.a, pair.b), key=lambda index: (photographs[group[index]], -index))
        alone = group.count(group[small]) == 1
        contradicts = (pair.fit is not None and not pair.agrees) or pair in dropped
        unmatched = pair.fit is None and pair.share >= EXPECTED_SHARE and alone
        if large in refusals or not (contradicts or unmatched):
            continue
        why = pair.reason if contradicts and pair not in dropped else f"loops over other models contradict it ({pair.reason})"
        if unmatched:
            why = f"both know {pair.share:.0%} common ground, but {pair.reason}"
        for index in (i for i, number in enumerate(group) if number == group[small]):
            refusals.setdefault(index, f"it does not fit {named[large]}, which has no fewer photographs behind it: {why}.")
    return refusals


def _verdict(index: int, model: PlacedModel, solved: SolvedFrames, used: Sequence[_Pair], refusals: dict[int, str]) -> RefinedFrame:
    if index in refusals:
        return RefinedFrame(status="refused", correction=IDENTITY, uncertainty=model.uncertainty, reason=refusals[index])
    own_pairs = [pair for pair in used if index in (pair.a, pair.b)]
    if not own_pairs:
        loose = model.uncertainty.scale > ALONE_MAX_SCALE or model.uncertainty.rotation_rad > ALONE_MAX_ROTATION_RAD
        if loose:
            reason = (
                f"no other model knows enough of the same ground, and GPS fixes its scale to {100 * model.uncertainty.scale:.1f} % and its "
                f"rotation to {np.degrees(model.uncertainty.rotation_rad):.1f}° only, expected {100 * ALONE_MAX_SCALE:.0f} % and "
                f"{np.degrees(ALONE_MAX_ROTATION_RAD):.0f}° or better."
            )
            return RefinedFrame(status="refused", correction=IDENTITY, uncertainty=model.uncertainty, reason=reason)
        reason = "no other model knows enough of the same ground, so it stays where its own frame puts it."
        return RefinedFrame(status="alone", correction=IDENTITY, uncertainty=model.uncertainty, reason=reason)
    misses = [edge_xi(pair.edge, solved.corrections[pair.a], solved.corrections[pair.b])[:3] for pair in own_pairs]
    squares = [pair.edge.fit.residual_m**2 + float(miss @ miss) for pair, miss in zip(own_pairs, misses, strict=True)]
    neighbours = tuple(sorted(pair.partner_of(index) for pair in own_pairs))
    num_points, num_followed = (sum(getattr(pair.edge.fit, name) for pair in own_pairs) for name in ("num_pairs", "num_followed"))
    return RefinedFrame(
        status="ok",
        correction=solved.corrections[index],
        uncertainty=solved.uncertainty(index),
        reason=f"{num_points} of {num_followed} points on ground common with {len(own_pairs)} other models agree.",
        residual_m=float(np.sqrt(np.mean(squares))),
        neighbours=neighbours,
    )
