"""Joining within a memory limit: beyond the least need the loss has it; below, models are cut."""

from __future__ import annotations

from radiant_core.aggregate.cloud_choice import cloud_needs, kept_statistics_bytes, pixels_of, retrain_memory_bytes
from radiant_core.aggregate.retrain import Teacher, cut_at_borders
from radiant_core.cameras import Cameras
from radiant_core.hierarchy.decisions import join_memory_decision
from radiant_core.splats import Splats
from radiant_core.train.native_loss import STATISTICS_BUDGET_BYTES
from tests.core.scenes import cameras_above, ground_splats

SIDE_PX = 1000


def two_models(num_views: int = 4) -> tuple[list[Splats], list[Cameras]]:
    """Two models of 300 Gaussians with some cameras each."""
    models = [ground_splats(300, seed=seed) for seed in (0, 1)]
    cameras = [cameras_above([(x, float(y)) for y in range(num_views)], size_wh=(2000, 1500)) for x in (-5.0, 5.0)]
    return models, cameras


def test_what_is_left_is_kept_for_the_loss_and_never_more_than_it_can_use() -> None:
    models, cameras = two_models()
    pixels = pixels_of(cameras, SIDE_PX)
    least = retrain_memory_bytes(600, models[0].num_bytes / 300, pixels)
    assert least == cloud_needs(models, cameras, SIDE_PX, None).memory_bytes
    kept = [kept_statistics_bytes(models, cameras, SIDE_PX, least + more) for more in (-1, 0, 1000, 36 * sum(pixels), 1e12)]
    assert kept == [None, 0, 1000, 36 * sum(pixels), 36 * sum(pixels)]
    many, views = two_models(40)
    assert kept_statistics_bytes(many, views, 2000, 1e12) == STATISTICS_BUDGET_BYTES


def test_below_the_least_need_models_are_cut_and_the_decision_says_so() -> None:
    models, cameras = two_models()
    needed = cloud_needs(models, cameras, SIDE_PX, None).memory_bytes
    cut = join_memory_decision("edges/a", needed, None, 1e8)
    assert cut.choice.startswith("models are cut at their borders") and cut.figure == 100 and cut.forced
    assert f"predicted to take {needed / 1e6:,.0f} MB" in cut.reason
    assert "12 MB for what the loss keeps" in join_memory_decision("edges/a", needed, 12_000_000, 1e9).choice
    joined = cut_at_borders([Teacher(splats=model, cameras=own) for model, own in zip(models, cameras, strict=True)])
    assert joined.trained.num_steps == 0 and 0 < len(joined.splats) < joined.num_given == 600
