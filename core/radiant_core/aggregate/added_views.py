"""A model refined where new photographs show it; all else keeps its bits. Once per set of them.

    moving   Gaussians of which a new photograph shows `MIN_SHOWN_PX` pixels
    added    points that photographs agree on, or that are tied to them, where the model has nothing
             within `BLIND_FACTOR` of their size
    views    the new photographs, and the old ones in which enough of what moves is seen

All are fitted together among the rest, which is rendered and stands still. The photographs are
brought into the model's light first. N Gaussians of the model, V views.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import KDTree

from radiant_core.aggregate.extend import BLIND_FACTOR
from radiant_core.aggregate.join import TOUCHED_SHARE, contested_shares
from radiant_core.aggregate.retrain import RATES_END
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.evaluate.support import support_of
from radiant_core.geometry.coverage import reached_by
from radiant_core.light.canonical import light_decision
from radiant_core.light.lights import in_canonical_light
from radiant_core.light.solve import lights_from_model
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats, concatenate_splats
from radiant_core.train.config import TrainConfig, without_mean
from radiant_core.train.dense.points import dense_points
from radiant_core.train.dense.seeding import PIXELS_PER_POINT
from radiant_core.train.densify.policies import NoDensification
from radiant_core.train.initialize import first_splats
from radiant_core.train.trainer import FitOptions, Steps, fit_splats
from radiant_core.train.views import TrainingViews

VISIBLE_LOGIT = -2.2
"""Of opacity 0.1: what is fainter fills no place."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RefinedModel:
    """The model's N Gaussians in their order, those that did not move (N,) bit for bit, and behind
    them what was added; `views` (K,): rows of the views that it was fitted to."""

    splats: Splats
    moved: NDArray[np.bool_]
    views: NDArray[np.int64]
    num_steps: int
    decisions: tuple[Decision, ...]

    @property
    def num_added(self) -> int:
        """Gaussians that the model did not have."""
        return len(self.splats) - len(self.moved)


def refine_with_views(
    model: Splats, scene: SfmScene, views: TrainingViews, is_new: NDArray[np.bool_], config: TrainConfig, options: FitOptions
) -> RefinedModel:
    """`model` refined where the new ones of V training photographs show it.

    Args:
        model: the Gaussians, in the frame of the scene.
        scene: cameras and points, with the cameras of the views in their order.
        views: old and new photographs, as they were taken.
        is_new: which of them are new (V,).
        config: settings of training; `num_steps` are taken, at most `max_epochs` for each view
            that is fitted.
        options: renderer and progress.

    Returns:
        The refined model and what became of it.

    Raises:
        BadInput: no new photograph shows any of the model, or adds anything to it.
        StageFailed: the training diverges.
    """
    views, decisions = _in_light_of(model, views, config, options)
    new_rows = np.flatnonzero(is_new)
    moved = support_of(model, views.cameras.select(new_rows), options.backend).num_views > 0
    shares = contested_shares(views.cameras, model.means, moved)
    rows = np.flatnonzero(is_new | (shares > TOUCHED_SHARE))
    fitted_views, fitted_scene = views.select(rows), scene.restricted_to(rows)
    added = _seeds(model, fitted_scene, fitted_views, config)
    if not moved.any() and not len(added):
        raise BadInput("the new photographs show none of the model and agree on no point beside it: nothing is to be refined.")
    near = np.flatnonzero(moved | reached_by(model, fitted_views.cameras))
    start = concatenate_splats([model.select(near), added])
    frozen = np.concatenate([~moved[near], np.zeros(len(added), bool)])
    steady = replace(
        config, sh_degree=model.sh_degree, sh_degree_every=0, density=NoDensification(), start_scale=1.0, drop_gaussians="none",
        settle_epochs=None, **without_mean(config),
    )  # fmt: skip
    if config.max_epochs is not None:
        steady = replace(steady, num_steps=min(config.num_steps, config.max_epochs * len(fitted_views)), max_epochs=None)
    result = fit_splats(start, fitted_views, steady, replace(options, frozen=frozen, steps=Steps(end=RATES_END)))
    return RefinedModel(
        splats=_put_back(model, result.splats, near, moved), moved=moved, views=rows, num_steps=result.num_steps, decisions=decisions
    )


def _in_light_of(
    model: Splats, views: TrainingViews, config: TrainConfig, options: FitOptions
) -> tuple[TrainingViews, tuple[Decision, ...]]:
    """The views in the light of the model, where theirs differs from it, and the decision."""
    if config.light == "none":
        return views, ()
    lights = lights_from_model(model, views, options.backend).lights
    decision = light_decision(lights, config.light)
    is_wanted = lights.is_known.any() and (config.light == "always" or lights.is_worth_modelling)
    return (in_canonical_light(views, lights) if is_wanted else views), (decision,)


def _seeds(model: Splats, scene: SfmScene, views: TrainingViews, config: TrainConfig) -> Splats:
    """Gaussians on points of these views where the model has nothing."""
    if len(scene.points) < 4:
        return model.select(np.zeros(0, np.int64))
    num_pixels = int(views.cameras.sizes_wh.prod(axis=1).sum())
    dense = dense_points(scene, views, most=num_pixels // PIXELS_PER_POINT, seed=config.seed, num_threads=torch.get_num_threads())
    bare = replace(config, sh_degree=model.sh_degree, antialiased=model.antialiased, sky=False, fill_in=False)
    seeds, _ = first_splats(scene, views, bare, dense)
    standing = model.means[model.logit_opacities > VISIBLE_LOGIT]
    if not len(standing):
        return seeds
    away, _ = KDTree(standing).query(seeds.means)
    return seeds.select(away > BLIND_FACTOR * np.exp(seeds.log_scales.astype(np.float64).max(axis=1)))


def _put_back(model: Splats, fitted: Splats, near: NDArray[np.int64], moved: NDArray[np.bool_]) -> Splats:
    """The model with the fitted values of what moved, in its order, and what was added behind."""
    rows = np.arange(len(model) + len(fitted) - len(near))
    rows[near[moved[near]]] = len(model) + np.flatnonzero(moved[near])
    rows[len(model) :] = len(model) + np.arange(len(near), len(fitted))
    return concatenate_splats([model, fitted]).select(rows)
