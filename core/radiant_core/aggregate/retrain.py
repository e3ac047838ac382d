"""Retraining on synthetic views: Gaussians are fitted to what their teachers show, beside others
that stand still. Once per join or tile.

Gaussians are neither added nor densified: the paper densifies on devices, from step 500 of their
20,000 on.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radiant_core.aggregate.config import Join
from radiant_core.geometry.coverage import reached_by
from radiant_core.splats import Splats, concatenate_splats
from radiant_core.train.config import TrainConfig, train_preset, without_mean
from radiant_core.train.densify.policies import NoDensification
from radiant_core.train.results import TrainResult
from radiant_core.train.shapes import without_dead
from radiant_core.train.trainer import FitOptions, Steps, fit_splats
from radiant_core.train.views import TrainingViews

RATES_END = 0.3
"""Share of the rates left at the end of a retraining by `default`; centres' fall as in training."""
RATES = ("max_extent_per_distance", "means_lr", "means_lr_end", "scales_lr", "quats_lr", "opacities_lr", "sh0_lr")
"""Of a configuration, the rates that `paper` takes from 3DGS, and the limit of their unit."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Retrained:
    """The Gaussians of a retraining that any view can show, and which those are."""

    trained: TrainResult
    """Without the held ones and those that became invisible."""
    reached: NDArray[np.bool_]
    """(N,) Of the Gaussians given, those that were fitted; the others keep their bits."""

    @property
    def splats(self) -> Splats:
        """The fitted Gaussians."""
        return self.trained.splats


def retrain(
    moving: Splats,
    views: TrainingViews,
    train: TrainConfig,
    join: Join,
    options: FitOptions,
    frozen: Splats | None = None,
) -> Retrained:
    """Fit the Gaussians `moving` (N) to `views`, in the presence of those `frozen`, which are
    rendered and keep their bits.

    What no view can show takes no memory and no part, of either.
    """
    reached = reached_by(moving, views.cameras)
    start = moving.select(reached)
    steady = None
    if frozen is not None:
        around = frozen.select(reached_by(frozen, views.cameras))
        start = concatenate_splats([around, start])
        steady = np.arange(len(start)) < len(around)
    config = retraining_config(train, join, start, len(views))
    result = fit_splats(start, views, config, replace(options, frozen=steady, steps=Steps(end=RATES_END)))
    fitted = result.splats if steady is None else result.splats.select(~steady)
    return Retrained(trained=replace(result, splats=without_dead(fitted)[0]), reached=reached)


def retraining_config(train: TrainConfig, join: Join, merged: Splats, num_views: int) -> TrainConfig:
    """A device's settings for a join over so many synthetic views: nothing is
    added or grown, and rates fall as joining has it, not as a device's. `paper`
    retrains at the rates of 3DGS, however its devices were trained."""
    still = {
        "sh_degree_every": 0,
        "density": NoDensification(),
        "start_scale": 1.0,
        "background": "black",
        "drop_gaussians": "none",
        "settle_epochs": None,
        **without_mean(train),
    }
    rates = {name: getattr(train_preset("paper"), name) for name in RATES} if join.method == "paper" else {}
    return replace(train, num_steps=join.num_steps(num_views), sh_degree=merged.sh_degree, **{**still, **rates})
