"""`ShownModel`: what of a run's model is seen at first, in window, page, report, films and pictures
alike: the scene without its surroundings.

    scene = middle in the box of the regions, and no wider than what counts as haze there
            (`pictures.turntable.in_scene`)

Photographs look past a scene: what they saw there once is haze, through which one looks from where
nobody took a photograph. Nothing is left out of the model. Once per reading and cleaning; some 10
ns a Gaussian.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radiant_core.decisions import Decision
from radiant_core.numerics import FloatArray
from radiant_core.plan.plans import CloudPlan
from radiant_core.render.trajectories import box_corners, middle_box
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from radiant_viewer.layers.layer import Layer, LegendEntry, at_height
from radiant_viewer.layers.palette import GREY
from radiant_viewer.layers.splat_layer import splat_layer
from radiant_viewer.pictures.turntable import HAZE_TIMES, in_scene
from radiant_viewer.runs.cleaned_model import CleanedModel
from radiant_viewer.runs.run_view import RunView
from radiant_viewer.runs.unplanned import scene_box

MODEL, SURROUNDINGS = "Gaussians", "Surroundings"
"""Layers of a model: what is seen at first, and all else."""
HIGHEST_SHARE = 0.99
"""Of the points in the box: what stands higher is haze."""
MIN_OPAQUE = 0.1
"""Share of a model's Gaussians from which on the opaque ones alone say where it is."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ShownModel:
    """around: which Gaussians (N,) of what the cleaning keeps are hidden at first; splats: all
    others; decision: how many that are, and why."""

    around: NDArray[np.bool_]
    splats: Splats
    decision: Decision

    @property
    def sentence(self) -> str:
        """What is hidden, for a page; empty where that is nothing."""
        return f"the {int(self.around.sum()):,} around the scene ({100 * self.around.mean():.0f} %) are hidden" if self.around.any() else ""


def shown_model(splats: Splats, box: FloatArray) -> ShownModel:
    """Of a model as it is cleaned, the scene in a box (2,3); all of it where nothing lies there."""
    scene = in_scene(splats, box, HAZE_TIMES)
    around = ~scene if scene.any() else np.zeros(len(splats), bool)
    share = 100 * float(around.mean()) if len(splats) else 0.0
    decision = Decision(
        stage="view",
        topic=SURROUNDINGS,
        choice="what lies around the scene is hidden" if around.any() else "nothing lies around the scene",
        figure=round(share, 1),
        unit=f"% of {len(splats):,} Gaussians",
        reason="from where nobody took photographs one looks through the haze around the scene",
        changes_nothing=not around.any(),
    )
    return ShownModel(around=around, splats=splats.select(~around) if around.any() else splats, decision=decision)


def shown_of_run(run: RunView) -> ShownModel:
    """What of a run's model is seen at first; the run has one."""
    assert run.splats is not None, "there is no model to show"
    return shown_model(run.splats, framed_box(run.scene, run.cloud_plan))


def seen_of(model: CleanedModel, box: FloatArray | None, is_visible: Callable[[str], bool]) -> NDArray[np.bool_]:
    """Which Gaussians (N,) of the whole model are seen where the layers of `model_layers` can be
    shown each: the scene in a box (2,3), what lies around it, or both. Without a box there is
    nothing around it."""
    around = np.zeros(len(model.whole), bool)
    if box is not None and len(model.splats):
        around[np.flatnonzero(model.cleaned.kept)] = shown_model(model.splats, box).around
    return model.cleaned.kept & np.where(around, is_visible(SURROUNDINGS), is_visible(MODEL))


def model_layers(splats: Splats, box: FloatArray | None) -> list[Layer]:
    """The scene and its surroundings as points, to show each by its box; "Gaussians" first."""
    if box is None or not len(splats):
        return [splat_layer(splats)]
    model = shown_model(splats, box)
    around = splat_layer(splats.select(model.around))
    text = f"{int(model.around.sum()):,} Gaussians, {model.decision.figure:g} %"
    return [splat_layer(model.splats), replace(around, name=SURROUNDINGS, legend=(LegendEntry(text=text, color=GREY, marker="dot"),))]


def framed_box(scene: SfmScene, cloud_plan: CloudPlan) -> FloatArray:
    """Return lower and upper corner (2,3) of what was surveyed: the regions of a plan, from the
    ground to the highest points, or without a border the ground below the cameras and most
    points."""
    corners = np.concatenate([border.reshape(-1, 2) for border in cloud_plan.borders if len(border)] or [np.zeros((0, 2))])
    if not len(corners):
        return scene_box(scene)
    points = scene.points if len(scene.points) else scene.cameras.centers
    box = middle_box(points)
    box[:, :2] = corners.min(axis=0), corners.max(axis=0)
    inside = ((points[:, :2] >= box[0, :2]) & (points[:, :2] <= box[1, :2])).all(axis=1)
    if inside.any():
        box[:, 2] = np.quantile(points[inside, 2], [1 - HIGHEST_SHARE, HIGHEST_SHARE])
    return box


def model_box(splats: Splats) -> FloatArray:
    """Return lower and upper corner (2,3) of where a model alone has most of its surfaces: haze and
    sky are thin or far, and neither moves the middle of what is opaque. Along the flattest side it
    holds roofs and pits too, which are few beside the ground. BadInput without any Gaussian."""
    from radiant_core.geometry.open3d_ops import surface_points

    centers, chosen = surface_points(splats, np.inf)
    places = centers if chosen.mean() > MIN_OPAQUE else splats.means.astype(np.float64)
    box = middle_box(places)
    sides = np.ptp(box, axis=0)
    flattest, along = int(sides.argmin()), np.arange(3) != sides.argmin()
    # Not farther than the scene is wide: a sky is over it too.
    middle, reach = box[:, flattest].mean(), sides.max() / 2
    near = ((places >= box[0]) & (places <= box[1]))[:, along].all(axis=1) & (np.abs(places[:, flattest] - middle) <= reach)
    if near.any():
        low, high = np.quantile(places[near, flattest], [1 - HIGHEST_SHARE, HIGHEST_SHARE])
        box[:, flattest] = min(box[0, flattest], low), max(box[1, flattest], high)
    return box


def framed_positions(scene: SfmScene, cloud_plan: CloudPlan) -> FloatArray:
    """Return places (K,3) that frame what was surveyed: the corners of the regions, low and high,
    or of the box."""
    box = framed_box(scene, cloud_plan)
    borders = [border for border in cloud_plan.borders if len(border) >= 3]
    if not borders:
        return box_corners(box)
    return np.concatenate([at_height(border, float(height)) for border in borders for height in box[:, 2]])
