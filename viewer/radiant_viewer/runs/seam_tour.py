"""The stops of a tour of the borders, worst seam first, with view and figures. Once per run.

A stop is one border, with the colour step over its whole observed length; its place is the worst
piece (`border_figures`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from radiant_core.numerics import FloatArray
from radiant_core.plan.plans import CloudPlan
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from radiant_viewer.pictures.view_pose import ViewPose
from radiant_viewer.runs.border_figures import BorderFigures, border_figures

ELEVATION_DEG, ANGLE_DEG = 38.0, 30.0


@dataclass(frozen=True, kw_only=True, eq=False)
class SeamStop:
    """One border and its figures; lengths in the frame's unit."""

    figures: BorderFigures

    @property
    def ends(self) -> FloatArray:
        """Ends (2,2) of the border on the map."""
        return self.figures.border.ends

    @property
    def worst(self) -> FloatArray:
        """Middle (2,) of the worst piece; of the border where nothing was observed."""
        worst = self.figures.worst
        return self.ends.mean(axis=0) if worst is None else self.figures.ends[worst].mean(axis=0)

    @property
    def worst_levels(self) -> float:
        """Colour step of the worst piece, NaN where nothing was observed."""
        worst = self.figures.worst
        return float("nan") if worst is None else float(self.figures.levels[worst])

    @property
    def length(self) -> float:
        """Length of the border."""
        return self.figures.border.length_m

    @property
    def title(self) -> str:
        """The names of the two regions."""
        return self.figures.title

    def view(self, height: float) -> ViewPose:
        """Return an oblique view along the border on its worst place, at ground height `height`,
        with a third of the border in view."""
        along = (self.ends[1] - self.ends[0]) / max(float(np.linalg.norm(self.ends[1] - self.ends[0])), 1e-12)
        elevation = np.radians(ELEVATION_DEG)
        target = np.array([*self.worst, height])
        back = np.array([*(-along * np.cos(elevation)), np.sin(elevation)])
        distance = max(self.length, 1e-6) / 3 / np.tan(np.radians(ANGLE_DEG / 2))
        return ViewPose(position=target + distance * back, focal_point=target, up=np.array([0.0, 0.0, 1.0]), angle_deg=ANGLE_DEG)


def seam_stops(scene: SfmScene, cloud_plan: CloudPlan, splats: Splats) -> tuple[SeamStop, ...]:
    """Return a stop per border, in the order of `border_figures`; BadInput for one region."""
    return tuple(SeamStop(figures=figures) for figures in border_figures(scene, cloud_plan, splats))
