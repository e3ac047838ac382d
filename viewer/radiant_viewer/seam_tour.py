"""The stops of a walk along the borders, worst seam first: where to stand, and what was measured there. Once per run.

A stop is one border; its figure is the colour step over its whole length (`seam_layer.color_steps`), its place the worst piece.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.plan.plans import CloudPlan
from radiant_core.splats import Splats
from radiant_viewer.seam_layer import color_steps, seam_pieces
from radiant_viewer.view_pose import ViewPose
from radiant_viewer.views import seam_band_width

ELEVATION_DEG, ANGLE_DEG = 38.0, 30.0


@dataclass(frozen=True, kw_only=True, eq=False)
class SeamStop:
    """One border between the regions `first` and `second`, ids of edges; ends (2,2) and worst (2,) on the map.

    step_levels: colour step over the whole border in 8-bit levels beyond the scene's own texture, NaN where too few Gaussians lie
    beside it; worst_levels: that of the worst piece; length in the frame's unit.
    """

    first: str
    second: str
    ends: FloatArray
    worst: FloatArray
    length: float
    step_levels: float
    worst_levels: float

    @property
    def title(self) -> str:
        """The two regions."""
        return f"{self.first} | {self.second}"

    def view(self, height: float) -> ViewPose:
        """Obliquely along the border over its worst place at a height, a third of the border in view."""
        along = (self.ends[1] - self.ends[0]) / max(float(np.linalg.norm(self.ends[1] - self.ends[0])), 1e-12)
        elevation = np.radians(ELEVATION_DEG)
        target = np.array([*self.worst, height])
        back = np.array([*(-along * np.cos(elevation)), np.sin(elevation)])
        distance = max(self.length, 1e-6) / 3 / np.tan(np.radians(ANGLE_DEG / 2))
        return ViewPose(position=target + distance * back, focal_point=target, up=np.array([0.0, 0.0, 1.0]), angle_deg=ANGLE_DEG)


def seam_stops(cloud_plan: CloudPlan, splats: Splats) -> tuple[SeamStop, ...]:
    """All borders between two regions, the strongest step first, those without a figure last; BadInput for a plan of one region."""
    width = seam_band_width(cloud_plan)
    pieces = seam_pieces(cloud_plan, width)
    if not len(pieces.ends):
        raise BadInput("the plan has one region only: there is no border and no seam to look at.")
    levels = color_steps(splats, pieces, width)
    whole = color_steps(splats, pieces, width, pooled_widths=np.inf)
    stops = []
    for pair in np.unique(pieces.edge_pairs, axis=0):
        chosen = np.flatnonzero((pieces.edge_pairs == pair).all(axis=1))
        own = levels[chosen]
        known = np.isfinite(own)
        worst = chosen[int(np.argmax(np.where(known, own, -np.inf)))] if known.any() else chosen[len(chosen) // 2]
        stops.append(
            SeamStop(
                first=cloud_plan.edge_ids[pair[0]],
                second=cloud_plan.edge_ids[pair[1]],
                ends=_outer_ends(pieces.ends[chosen]),
                worst=pieces.ends[worst].mean(axis=0),
                length=float(np.linalg.norm(pieces.ends[chosen, 1] - pieces.ends[chosen, 0], axis=1).sum()),
                step_levels=float(whole[chosen[0]]),
                worst_levels=float(own[known].max()) if known.any() else float("nan"),
            )
        )
    return tuple(sorted(stops, key=lambda stop: (not np.isfinite(stop.step_levels), -np.nan_to_num(stop.step_levels), stop.title)))


def _outer_ends(ends: FloatArray) -> FloatArray:
    """The two ends (2,2), of pieces (S,2,2) on one straight line, that lie farthest apart."""
    points = ends.reshape(-1, 2)
    far = points[int(np.argmax(np.linalg.norm(points - points[0], axis=1)))]
    return np.stack([points[int(np.argmax(np.linalg.norm(points - far, axis=1)))], far])
