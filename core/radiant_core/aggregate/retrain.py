"""Retraining at an edge or the cloud: all models together, taught by their own synthetic views (paper Sec. III-D, Fig. 6). Once per node.

Gaussians move but are neither added nor pruned: the paper densifies on devices, from step 500 of their 20,000 on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from radiant_core.aggregate.config import AggregateConfig
from radiant_core.aggregate.synthetic_views import Rendered, synthetic_views
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.splats import Splats, concatenate_splats
from radiant_core.train.config import TrainConfig
from radiant_core.train.trainer import FitOptions, Steps, TrainResult, fit_splats
from radiant_core.train.views import TrainingViews, concatenate_views

_STEPS = {
    "paper": Steps(),
    "default": Steps(means=0.0, quats=0.1, log_scales=0.1),
}


def retrain_on_synthetic_views(
    models: Sequence[Splats],
    cameras: Sequence[Cameras],
    train: TrainConfig,
    aggregate: AggregateConfig,
    options: FitOptions,
    rendered: Sequence[Rendered] | None = None,
) -> TrainResult:
    """Concatenate `models`, or what they know, and retrain that on what each shows at its own `cameras` (one set per model).

    `rendered` holds per model the views that need not be rendered any more. A single model is its own teacher and comes back unchanged
    unless `aggregate.retrain_single`. Raises BadInput when the counts differ.
    """
    if len(models) != len(cameras) or not models:
        raise BadInput(f"{len(models)} models with {len(cameras)} sets of cameras: give one set per model, at least one.")
    if len(models) == 1 and not aggregate.retrain_single:
        return TrainResult(splats=models[0], num_steps=0, first_loss=0.0, last_loss=0.0, seconds=0.0)
    views = teacher_views(models, cameras, train.long_side_px, rendered)
    if not aggregate.weight_by_alpha:
        views = replace(views, weights=None)
    if aggregate.drop_unseen:
        models = [model.select(known) for model, known in zip(models, known_parts(models, cameras), strict=True)]
    merged = concatenate_splats(models)
    num_steps = aggregate.num_epochs * len(views)
    if aggregate.max_num_steps is not None:
        num_steps = min(num_steps, aggregate.max_num_steps)
    config = replace(
        train,
        num_steps=num_steps,
        sh_degree=merged.sh_degree,
        sh_degree_every=0,
        densify="none",
        start_scale=1.0,
        exposure="none",
        background="black",
    )
    return fit_splats(merged, views, config, replace(options, steps=_STEPS[aggregate.preset]))


def known_parts(models: Sequence[Splats], cameras: Sequence[Cameras]) -> list[NDArray[np.bool_]]:
    """Masks (N,) per model of what it may speak of: all that its own cameras see, and elsewhere what no other model's cameras see."""
    seen = [[views.any_sees(model.means) for views in cameras] for model in models]
    return [rows[own] | ~np.any(np.delete(rows, own, axis=0), axis=0) for own, rows in enumerate(seen)]


def teacher_views(
    models: Sequence[Splats],
    cameras: Sequence[Cameras],
    long_side_px: int,
    rendered: Sequence[Rendered] | None = None,
) -> TrainingViews:
    """Every model's synthetic views at its own cameras, reduced to `long_side_px`; those in `rendered` are taken as they are."""
    ready = [{}] * len(models) if rendered is None else rendered
    return concatenate_views(
        [synthetic_views(model, own.scaled(long_side_px), rendered=views) for model, own, views in zip(models, cameras, ready, strict=True)]
    )
