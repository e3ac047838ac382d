"""Figures of each border of a plan in a model: observed part, colour step, texture beside it.

A border has a verdict where at least `MIN_OBSERVED_SHARE` of its length was observed on both sides
and has Gaussians. A step is detected from `VISIBLE_LEVELS` on where it exceeds that of every
parallel (`seam_layer.color_steps`). Pieces are weighted by their coverage; the worst has the
largest ratio of step to detectable step, times coverage. O(N), once per picture or window.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.evaluate.borders import border_distance_m
from radiant_core.evaluate.observed_ground import observed_coverage
from radiant_core.numerics import FloatArray
from radiant_core.plan.borders.borders import Border, shared_borders
from radiant_core.plan.plans import CloudPlan
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from radiant_viewer.layers.seam_layer import SeamPieces, color_steps, piece_normals, seam_pieces

VISIBLE_LEVELS = 10.0
"""Of 255: what a glance at two even surfaces beside each other sees. Unplanted, the borders of the
sample runs step by 0.0 levels over their whole length, the planted one of 30 levels by 23.1."""
MIN_OBSERVED_SHARE = 0.25
"""Of a border's length, for a verdict."""
MIN_OBSERVED_PIECES = 3
"""Fewer may step by chance."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BorderFigures:
    """One border and its K pieces in order: ends (K,2,2), shares (K,) of the usual coverage, levels
    (K,) of their colour steps and limits (K,) of detection, NaN where nothing was observed or too
    few Gaussians lie; step, texture and limit are those of the whole observed length."""

    border: Border
    names: tuple[str, str]
    ends: FloatArray
    shares: FloatArray
    levels: FloatArray
    limits: FloatArray
    step_levels: float
    texture_levels: float
    limit_levels: float

    @property
    def title(self) -> str:
        """The names of the two regions."""
        return " | ".join(self.names)

    @cached_property
    def observed(self) -> NDArray[np.bool_]:
        """Whether each piece (K,) has a figure."""
        return np.isfinite(self.levels)

    @property
    def levels_above_texture(self) -> FloatArray:
        """Steps of the pieces (K,), 0 where lines beside the border step as much (texture)."""
        return np.where(self.levels < self.limits, 0.0, self.levels)

    @property
    def largest_piece_levels(self) -> float:
        """The largest step of a piece above texture, as borders are coloured; 0 without any."""
        return float(np.nanmax(self.levels_above_texture, initial=0.0))

    @property
    def observed_length(self) -> float:
        """Length of the pieces that have a figure, in the frame's unit."""
        return float(np.linalg.norm(self.ends[:, 1] - self.ends[:, 0], axis=1)[self.observed].sum())

    @property
    def has_verdict(self) -> bool:
        """Whether enough of the border was observed for a verdict."""
        enough = self.observed_length >= MIN_OBSERVED_SHARE * self.border.length_m and self.observed.sum() >= MIN_OBSERVED_PIECES
        return bool(enough and np.isfinite(self.step_levels))

    @property
    def detectable_levels(self) -> float:
        """The least detectable step: visible, and larger than those of the parallels."""
        return max(VISIBLE_LEVELS, self.limit_levels)

    @property
    def has_step(self) -> bool:
        """Whether colours step visibly and more than beside the border."""
        return self.has_verdict and self.step_levels >= self.detectable_levels

    @property
    def verdict(self) -> str:
        """The verdict in words."""
        if not self.has_verdict:
            return "none: too little observed"
        return "step told from texture" if self.has_step else f"no step of {math.ceil(self.detectable_levels)} levels or more told"

    @property
    def median_levels(self) -> float:
        """Median step of the observed pieces, NaN without any."""
        return float(np.median(self.levels[self.observed])) if self.observed.any() else float("nan")

    @property
    def worst(self) -> int | None:
        """The piece whose step exceeds the texture most, weighted by coverage; None without any."""
        if not self.observed.any():
            return None
        visible_levels = np.maximum(VISIBLE_LEVELS, np.nan_to_num(self.limits))
        return int(np.argmax(np.where(self.observed, np.nan_to_num(self.levels) / visible_levels * self.shares, -1.0)))

    @property
    def observed_ends(self) -> FloatArray:
        """Ends (2,2) of the longest observed part; of the border where nothing was observed."""
        edges = np.flatnonzero(np.diff(np.concatenate([[False], self.observed, [False]]).astype(np.int8)))
        if not len(edges):
            return self.border.ends
        first, stop = max(edges.reshape(-1, 2).tolist(), key=lambda run: run[1] - run[0])
        return np.stack([self.ends[first, 0], self.ends[stop - 1, 1]])


def border_figures(scene: SfmScene, cloud_plan: CloudPlan, splats: Splats) -> tuple[BorderFigures, ...]:
    """Return all borders, those with a verdict first, then by falling step; BadInput for a plan of
    one region."""
    width = seam_band_width(cloud_plan)
    pieces = seam_pieces(cloud_plan, width)
    if not len(pieces.ends):
        raise BadInput("the plan has one region only: there is no border and no seam to look at.")
    shares = _shares(scene, pieces, width)
    steps = color_steps(splats, pieces, width, shares)
    whole = color_steps(splats, pieces, width, shares, pooled_widths=np.inf)
    figures = []
    for border in shared_borders(cloud_plan):
        chosen = np.flatnonzero((pieces.edge_pairs == (border.first, border.second)).all(axis=1))
        # Unobserved pieces have no figure of the whole border either.
        measured = chosen[np.isfinite(whole.levels[chosen])]
        one = measured[0] if len(measured) else chosen[0]
        figures.append(
            BorderFigures(
                border=border,
                names=(cloud_plan.edge_ids[border.first], cloud_plan.edge_ids[border.second]),
                ends=pieces.ends[chosen],
                shares=shares[chosen],
                levels=steps.levels[chosen],
                limits=steps.limit_levels[chosen],
                step_levels=float(whole.levels[one]),
                texture_levels=float(whole.texture_levels[one]),
                limit_levels=float(whole.limit_levels[one]),
            )
        )
    return tuple(sorted(figures, key=lambda one: (not one.has_verdict, -np.nan_to_num(one.step_levels, nan=-1.0), one.title)))


def _shares(scene: SfmScene, pieces: SeamPieces, width: float) -> FloatArray:
    """Return the share (S,) of the usual coverage of each piece on its less observed side: a step
    needs both."""
    middles, aside = pieces.ends.mean(axis=1), 0.5 * width * piece_normals(pieces)
    sides = observed_coverage(np.concatenate([middles + aside, middles - aside]), scene, width)
    return sides.reshape(2, -1).min(axis=0)


def seam_band_width(cloud_plan: CloudPlan) -> float:
    """Return the width of the bands beside a border: a twentieth of the regions' diagonal, at most
    a third of the deepest site."""
    corners = np.concatenate([*cloud_plan.borders, np.zeros((0, 2))])
    if len(corners) < 3:
        raise BadInput("the plan has no regions: there is no border and no seam to look at.")
    diagonal = float(np.linalg.norm(np.ptp(corners, axis=0)))
    middles = np.array([border.mean(axis=0) for border in cloud_plan.borders if len(border) >= 3])
    depths = border_distance_m(middles, cloud_plan)
    depth = float(depths[np.isfinite(depths)].max(initial=0.0))
    return min(diagonal / 20, depth / 3) if depth > 0 else diagonal / 20
