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
from radiant_core.geometry.cleaning import SizeStep, keeps
from radiant_core.numerics import FloatArray
from radiant_core.plan.plans import CloudPlan
from radiant_core.render.trajectories import box_corners, middle_box
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from radiant_viewer.layers.layer import Layer, LegendEntry, at_height
from radiant_viewer.layers.palette import GREY
from radiant_viewer.layers.splat_layer import splat_layer
from radiant_viewer.pictures.turntable import HAZE_TIMES, haze_size_in, in_scene
from radiant_viewer.runs.cleaned_model import CleanedModel
from radiant_viewer.runs.run_view import RunView
from radiant_viewer.runs.unplanned import scene_box

MODEL, SURROUNDINGS = "Gaussians", "Surroundings"
"""Layers of a model: what is seen at first, and all else."""
HIGHEST_SHARE = 0.99
"""Of the points in the box: what stands higher is haze."""
STRIPS, GOES_ON = 20, 1 / 3
"""A model alone goes on beyond its middle where a strip, a twentieth of that wide, has a third of
the Gaussians. Of what the run's box shows, 9 to 11 % of caliterra and 13 % of a town of 400
photographs lie beyond the middle, 0 to 1 and 7 % beyond this."""
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
    holds roofs and pits too, which are few beside the ground; along the others it reaches as far as
    the ground goes on. BadInput without any Gaussian."""
    from radiant_core.geometry.open3d_ops import surface_points

    centers, chosen = surface_points(splats, np.inf)
    if chosen.mean() <= MIN_OPAQUE:
        centers, chosen = splats.means.astype(np.float64), np.ones(len(splats), bool)
    box = middle_box(centers)
    sides = np.ptp(box, axis=0)
    flattest, along = int(sides.argmin()), np.arange(3) != sides.argmin()
    ground = centers[keeps(SizeStep(at_most=haze_size_in(splats, box)), splats)[chosen]]
    within = (ground >= box[0]) & (ground <= box[1])
    grown = box.copy()
    for axis in np.flatnonzero(along).tolist():
        beside = within[:, np.arange(3) != axis].all(axis=1)
        grown[:, axis] = _as_far_as_it_goes_on(ground[beside, axis], box[:, axis])
    # Not farther than the scene is wide: a sky is over it too.
    middle, reach = box[:, flattest].mean(), sides.max() / 2
    near = ((centers >= box[0]) & (centers <= box[1]))[:, along].all(axis=1) & (np.abs(centers[:, flattest] - middle) <= reach)
    if near.any():
        low, high = np.quantile(centers[near, flattest], [1 - HIGHEST_SHARE, HIGHEST_SHARE])
        grown[:, flattest] = min(box[0, flattest], low), max(box[1, flattest], high)
    return grown


def _as_far_as_it_goes_on(places: FloatArray, ends: FloatArray) -> FloatArray:
    """Return ends (2,) moved outwards, strip by strip, at most by their distance, while a strip has
    `GOES_ON` of the places (N,) that a usual one between them has."""
    width = float(np.ptp(ends)) / STRIPS
    if not width > 0:
        return ends
    strips = np.floor((places - ends[0]) / width)
    counts = np.bincount(strips[np.abs(strips - STRIPS / 2) <= 1.5 * STRIPS].astype(np.int64) + STRIPS, minlength=3 * STRIPS + 1)
    goes_on = counts >= max(1.0, GOES_ON * float(np.median(counts[STRIPS : 2 * STRIPS])))
    before, after = goes_on[:STRIPS][::-1], goes_on[2 * STRIPS : 3 * STRIPS]
    lengths = [int(np.argmin(side)) if not side.all() else STRIPS for side in (before, after)]
    return np.array([ends[0] - lengths[0] * width, ends[1] + lengths[1] * width])


def framed_positions(scene: SfmScene, cloud_plan: CloudPlan) -> FloatArray:
    """Return places (K,3) that frame what was surveyed: the corners of the regions, low and high,
    or of the box."""
    box = framed_box(scene, cloud_plan)
    borders = [border for border in cloud_plan.borders if len(border) >= 3]
    if not borders:
        return box_corners(box)
    return np.concatenate([at_height(border, float(height)) for border in borders for height in box[:, 2]])
