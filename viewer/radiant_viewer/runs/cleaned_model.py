"""`CleanedModel`: a model as it was trained, and without what its cleaning leaves out. Once per
reading and change.

Surfaces, pictures, films, exports, the report and the window have it from here (`model_file`,
`run_view`); scores are those of the model as it was trained.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.geometry.cleaning import Cleaned, Cleaning, Surroundings, clean
from radiant_core.geometry.support import SUPPORT_NAME, Support, load_support
from radiant_core.plan.plans import CloudPlan
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats

OWN_SUPPORT = "cleaning_support.safetensors"
"""The support that `radiant clean` measured, where the evaluation of the run did not."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CleanedModel:
    """whole: as trained; splats: what the cleaning keeps of it, the same object where that is all;
    notes: what of a file was left out or changed when it was read."""

    whole: Splats
    splats: Splats
    cleaning: Cleaning
    cleaned: Cleaned
    notes: tuple[str, ...] = ()


def cleaned_model(whole: Splats, cleaning: Cleaning, around: Surroundings, notes: tuple[str, ...] = ()) -> CleanedModel:
    """Apply a cleaning; BadInput where a step needs what is not there, or nothing is left."""
    cleaned = clean(whole, cleaning, around)
    if cleaning.steps and not cleaned.kept.any():
        raise BadInput("the cleaning leaves nothing of the model: take its last step back, 'radiant clean --undo' without a window.")
    splats = whole if cleaned.kept.all() else whole.select(cleaned.kept)
    return CleanedModel(whole=whole, splats=splats, cleaning=cleaning, cleaned=cleaned, notes=notes)


def surroundings(folder: Path, scene: SfmScene, cloud_plan: CloudPlan, num_gaussians: int) -> Surroundings:
    """What a cleaning of a run's or a training's model of so many Gaussians may refer to."""
    return Surroundings(
        regions=tuple(border for border in cloud_plan.borders if len(border) >= 3),
        points=scene.points if len(scene.observations) else np.zeros((0, 3)),
        support=cache(lambda: require_support(folder, num_gaussians)),
    )


def require_support(folder: Path, num_gaussians: int) -> Support:
    """The measured support of a folder's model; BadInput with the command that measures it."""
    support = find_support(folder, num_gaussians)
    if support is None:
        raise BadInput(
            f"which photographs support each Gaussian of {folder} was not measured: run 'radiant clean {folder} --measure', "
            "or take that step of the cleaning back by 'radiant clean --undo'."
        )
    return support


def find_support(folder: Path, num_gaussians: int) -> Support | None:
    """The measured support of a folder's model; None where there is none, or of another model.
    StoreDamaged for a broken file."""
    for path in (folder / "evaluation" / SUPPORT_NAME, folder / OWN_SUPPORT):
        if path.is_file() and len(support := load_support(path)) == num_gaussians:
            return support
    return None
