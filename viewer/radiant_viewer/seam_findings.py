"""Which borders of a plan show a seam in a model: colour steps of all, and the step detector of those where they are largest.

A border counts as found where the mean colours to its sides differ by `VISIBLE_LEVELS` beyond the scene's own texture, or where the step
detector finds colour, height, density or a gap. O(N) for the steps, a second per examined border.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.evaluate.borders import border_distance_m
from radiant_core.evaluate.step_detector import Quantity, border_steps
from radiant_core.numerics import FloatArray
from radiant_core.plan.borders import Border, shared_borders
from radiant_core.plan.plans import CloudPlan
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from radiant_viewer.seam_layer import SeamPieces, color_steps

VISIBLE_LEVELS = 10.0
"""Of 255. Unplanted, the borders of the sample runs step by 0.0 levels over their whole length, the planted one of 30 levels by 23.1."""
NUM_EXAMINED = 6
MAX_EXAMINED_M = 2000.0
"""Longer borders are left to their colour steps: their strip would have millions of pixels."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SeamFinding:
    """One border: step_levels of 255 over its whole length, NaN without figures; quantities that the step detector found."""

    border: Border
    step_levels: float
    quantities: tuple[Quantity, ...]

    @property
    def found(self) -> bool:
        """Whether there is a seam to see."""
        return bool(self.quantities) or self.step_levels >= VISIBLE_LEVELS


def seam_findings(scene: SfmScene, cloud_plan: CloudPlan, splats: Splats, num_examined: int = NUM_EXAMINED) -> list[SeamFinding]:
    """All borders, the largest colour step first; the first `num_examined` also by the step detector where the scene has metres.

    BadInput when the plan has one region only.
    """
    borders = shared_borders(cloud_plan)
    if not borders:
        raise BadInput("the plan has one region only: there is no border and no seam to look at.")
    pieces = SeamPieces(
        ends=np.stack([border.ends for border in borders]), edge_pairs=np.array([(border.first, border.second) for border in borders])
    )
    steps = _whole_steps(splats, pieces, seam_band_width(cloud_plan))
    order = np.argsort(-np.nan_to_num(steps, nan=-1.0), kind="stable")
    findings = []
    for rank, index in enumerate(order.tolist()):
        border = borders[index]
        examined = rank < num_examined and scene.frame.unit == "m" and border.length_m <= MAX_EXAMINED_M
        quantities = border_steps(splats, border.ends).found if examined else ()
        findings.append(SeamFinding(border=border, step_levels=float(steps[index]), quantities=quantities))
    return findings


def _whole_steps(splats: Splats, borders: SeamPieces, width: float) -> FloatArray:
    """The colour step (B,) of each border over its whole length, from pieces of one width."""
    ends, owner = [], []
    for index, (start, stop) in enumerate(borders.ends):
        count = max(1, int(np.ceil(np.linalg.norm(stop - start) / width)))
        cuts = start + np.linspace(0, 1, count + 1)[:, None] * (stop - start)
        ends.append(np.stack([cuts[:-1], cuts[1:]], axis=1))
        owner += [index] * count
    pieces = SeamPieces(ends=np.concatenate(ends), edge_pairs=borders.edge_pairs[owner])
    steps = color_steps(splats, pieces, width, pooled_widths=np.inf)
    first = np.searchsorted(np.array(owner), np.arange(len(borders.ends)))
    return steps[first]


def seam_band_width(cloud_plan: CloudPlan) -> float:
    """Width of the bands beside a border: a twentieth of the regions' diagonal, at most a third of the deepest site."""
    corners = np.concatenate([*cloud_plan.borders, np.zeros((0, 2))])
    if len(corners) < 3:
        raise BadInput("the plan has no regions: there is no border and no seam to look at.")
    diagonal = float(np.linalg.norm(np.ptp(corners, axis=0)))
    middles = np.array([border.mean(axis=0) for border in cloud_plan.borders if len(border) >= 3])
    depths = border_distance_m(middles, cloud_plan)
    depth = float(depths[np.isfinite(depths)].max(initial=0.0))
    return min(diagonal / 20, depth / 3) if depth > 0 else diagonal / 20
