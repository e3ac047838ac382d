"""Whether a training begins from dense points, and what follows for its growth. Per training."""

from __future__ import annotations

from dataclasses import replace

import torch

from radiant_core.decisions import Decision
from radiant_core.scene import SfmScene
from radiant_core.train.config import TrainConfig
from radiant_core.train.dense.fuse import DensePoints
from radiant_core.train.dense.points import dense_points
from radiant_core.train.densify.policies import NoDensification
from radiant_core.train.views import TrainingViews

PIXELS_PER_POINT = 120
"""Training pixels for each dense point: growth is planned to one Gaussian per 40 to 80."""
MIN_POINTS = 100
"""Fewer points than this seed nothing."""
MAX_SHARE = 0.9
"""Of the limit of Gaussians; the rest is for what photographs do not agree on, and the sky."""


def seed_densely(
    config: TrainConfig, scene: SfmScene, views: TrainingViews
) -> tuple[TrainConfig, DensePoints | None, tuple[Decision, ...]]:
    """Match the photographs against each other where `config.dense_points` asks for it.

    Args:
        config: settings of training, already fitted to the scene.
        scene: cameras and sparse points.
        views: the photographs, whose cameras are the scene's in the same order.

    Returns:
        The configuration, whose growth is off where there are dense points; the points or None;
        the decision.
    """
    if config.dense_points == "none":
        return config, None, ()
    num_pixels = int(views.cameras.sizes_wh.prod(axis=1).sum())
    most = min(num_pixels // PIXELS_PER_POINT, int(MAX_SHARE * config.max_num_splats))
    points = dense_points(scene, views, most=most, seed=config.seed, num_threads=torch.get_num_threads())
    seeds = len(points) >= MIN_POINTS
    decision = Decision(
        stage="train",
        topic="dense points",
        choice=f"{len(points):,} points start the model, which does not grow" if seeds else "no dense points",
        figure=float(len(points)),
        unit="points that three photographs agree on",
        reason="asked for on the command line" if seeds else f"fewer than {MIN_POINTS} points would cover almost nothing",
        forced=True,
        changes_nothing=not seeds,
    )
    return (replace(config, density=NoDensification()), points, (decision,)) if seeds else (config, None, (decision,))
