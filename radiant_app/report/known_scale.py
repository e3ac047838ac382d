"""How well the scale of a run is known, and by what, for the σ of its measures. Once per run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from radiant_app.report.ground_control import survey_of_run
from radiant_app.report.survey import sampling_distance
from radiant_core.scene import SfmScene
from radiant_core.survey.measures import PLACE_GSD
from radiant_viewer.runs.run_layers import ground_height
from radiant_viewer.runs.run_view import RunView
from radiant_viewer.share.scene_page import PageScale


@dataclass(frozen=True, kw_only=True)
class KnownScale:
    """The relative standard deviation of a scale, 0 where it is not known or has none, and what
    there is to say of it."""

    sigma: float
    text: str


def scale_of_run(run: RunView) -> KnownScale:
    """The scale of a run by ground control, else by GPS; one that the user gave has no known σ, and
    where lengths have no unit there is nothing to know."""
    return known_scale(run.scene, survey_of_run(run.folder))


def page_scale(run: RunView) -> PageScale:
    """What the page of a run says of lengths that are measured on it."""
    scale, unit = scale_of_run(run), run.unit
    gsd = sampling_distance(run.scene)
    place = 0.0 if gsd is None else PLACE_GSD * gsd
    return PageScale(unit=unit, scale_sigma=scale.sigma, place_sigma=place, note=scale.text, ground=ground_height(run.scene))


def known_scale(scene: SfmScene, survey: Mapping[str, Any] | None) -> KnownScale:
    """The same of a scene and its fit to a survey, as `survey_of_run` has it."""
    if scene.frame.kind == "unscaled":
        return KnownScale(sigma=0.0, text="lengths in units of their own, for nothing gives the scale")
    sigma = None if survey is None else survey.get("scale_sigma")
    if survey is not None and sigma is not None:
        by = "camera positions" if survey["control"] is None else "ground control"
        return KnownScale(sigma=float(sigma), text=_scale_text(float(sigma), by))
    if scene.frame.residual_m is not None and len(scene.cameras) > 1:
        sigma = _scale_by_gps(scene, scene.frame.residual_m)
        return KnownScale(sigma=sigma, text=_scale_text(sigma, "GPS"))
    by = "--distance or --height" if scene.frame.kind == "scaled" and survey is None else "what placed this run, which did not record it"
    return KnownScale(sigma=0.0, text=f"σ is without that of the scale, which is as good as {by}")


def _scale_by_gps(scene: SfmScene, residual_m: float) -> float:
    """The residual over the spread of the cameras times √photographs."""
    centers = scene.cameras.centers
    return residual_m / max(float(np.linalg.norm(centers - centers.mean(axis=0))), 1e-12)


def _scale_text(sigma: float, by: str) -> str:
    return f"scale by {by}, σ {100 * sigma:.2g} %"
