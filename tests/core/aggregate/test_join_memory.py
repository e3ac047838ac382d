"""Joining within a limit of memory: views as large as fit, then only a cut; what is promised is what the model says."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.aggregate.cloud_choice import models_bytes, pixels_of, retrain_memory_bytes
from radiant_core.aggregate.join_memory import LEAST_SHARE, join_memory_decision, join_plan
from radiant_core.aggregate.retrain import Teacher, cut_at_borders
from tests.core.scenes import cameras_above, ground_splats

SIDE_PX = 1000


def two_models() -> tuple[list, list]:
    """Two models of 300 Gaussians with four cameras each."""
    models = [ground_splats(300, seed=seed) for seed in (0, 1)]
    cameras = [cameras_above([(x, float(y)) for y in range(4)], size_wh=(2000, 1500)) for x in (-5.0, 5.0)]
    return models, cameras


def test_what_is_planned_fits_and_more_memory_never_means_less() -> None:
    models, cameras = two_models()
    pixels = pixels_of(cameras, SIDE_PX)
    # 36 bytes a pixel for one view whose statistics are not kept.
    whole = retrain_memory_bytes(600, models[0].num_bytes / 300, pixels) + 36 * max(pixels)
    before = (0, 0)
    for share in np.linspace(0.5, 1.1, 61):
        plan = join_plan(models, cameras, SIDE_PX, share * whole)
        now = (plan.long_side_px or 0, plan.statistics_bytes)
        assert plan.long_side_px is None or plan.needed_bytes <= share * whole
        assert plan.long_side_px is None or LEAST_SHARE * SIDE_PX <= plan.long_side_px <= SIDE_PX
        # Statistics may fall where views become larger.
        assert now[0] >= before[0] and (now[0] > before[0] or now[1] >= before[1])
        before = now
    assert join_plan(models, cameras, SIDE_PX, whole).needed_bytes == pytest.approx(whole, rel=1e-9)
    assert join_plan(models, cameras, SIDE_PX, whole).long_side_px == SIDE_PX


def test_where_the_smallest_views_do_not_fit_models_are_cut_and_the_decision_says_so() -> None:
    models, cameras = two_models()
    limit = models_bytes(models) + 1e6
    plan = join_plan(models, cameras, SIDE_PX, limit)
    assert plan.long_side_px is None and plan.needed_bytes > limit
    decision = join_memory_decision("edges/a", plan, SIDE_PX, limit)
    assert decision.choice.startswith("models are cut at their borders") and decision.forced
    smaller = join_memory_decision("edges/a", join_plan(models, cameras, SIDE_PX, limit + 5e7), SIDE_PX, limit + 5e7)
    assert "px instead of 1,000 px" in smaller.choice
    joined = cut_at_borders([Teacher(splats=model, cameras=own) for model, own in zip(models, cameras, strict=True)])
    assert joined.trained.num_steps == 0 and 0 < len(joined.splats) < joined.num_given == 600
