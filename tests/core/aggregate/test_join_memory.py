"""Joining within a limit of memory: at once, else in as few tiles as fit, else not at all."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.aggregate.config import MAX_TILES, Join, aggregate_preset
from radiant_core.aggregate.join import cut_at_borders
from radiant_core.aggregate.join_memory import MOST_STATISTICS_BYTES, JoinMemory, join_bytes, pixels_of, plan_join_memory
from radiant_core.aggregate.synthetic_views import Teacher
from radiant_core.aggregate.tiles import most_fitted, tiles_of
from radiant_core.cameras import Cameras, concatenate_cameras
from radiant_core.hierarchy.join_limits import CUT_AT_EDGE_COSTS, TILES_COST, JoinLimit, report_join_memory
from radiant_core.hierarchy.reporter import Recorder
from radiant_core.splats import Splats, concatenate_splats
from tests.core.scenes import cameras_above, ground_splats

SIDE_PX = 200
COUNT = 6_000


def two_models(num_views: int = 4) -> tuple[list[Splats], list[Cameras]]:
    """Two models of a ground of 32 m, each with cameras along it that see some 7 m."""
    models = [ground_splats(COUNT // 2, seed=seed, half_side_m=16.0) for seed in (0, 1)]
    ends = np.linspace(-14, 14, num_views)
    return models, [cameras_above([(x, float(y)) for y in ends], size_wh=(400, 300)) for x in (-7.0, 7.0)]


def planned(memory_bytes: float, num_views: int = 4) -> JoinMemory:
    models, cameras = two_models(num_views)
    return plan_join_memory(models, cameras, SIDE_PX, memory_bytes)


def at_once_bytes() -> float:
    models, cameras = two_models()
    return join_bytes(COUNT, COUNT, models[0].num_bytes / len(models[0]), pixels_of(cameras, SIDE_PX))


def test_what_is_left_is_kept_for_the_loss_and_never_more_than_it_can_use() -> None:
    least, wanted = at_once_bytes(), 24 * sum(pixels_of(two_models()[1], SIDE_PX))
    plans = [planned(least + more) for more in (0, 1000, wanted, 1e12)]
    assert [plan.statistics_bytes for plan in plans] == [0, 1000, wanted, wanted]
    assert all(plan.fits and plan.num_tiles == 1 and plan.needed_bytes == least for plan in plans)
    models, cameras = two_models(200)
    assert plan_join_memory(models, cameras, 2000, np.inf).statistics_bytes == MOST_STATISTICS_BYTES
    asked = 2 * MOST_STATISTICS_BYTES
    assert plan_join_memory(models, cameras, 2000, np.inf, most_statistics_bytes=asked).statistics_bytes == asked


def test_below_the_need_of_all_at_once_there_are_the_fewest_tiles_that_fit() -> None:
    models, cameras = two_models()
    merged, views = concatenate_splats(models), concatenate_cameras(cameras).scaled(SIDE_PX)
    fitted = {num: most_fitted(merged, views, tiles_of(merged.means, views, num)) for num in (2, 4, 8, 16)}
    each, pixels = models[0].num_bytes / len(models[0]), pixels_of(cameras, SIDE_PX)
    needs = {1: at_once_bytes(), **{num: join_bytes(COUNT, count, each, pixels, by_tiles=True) for num, count in fitted.items()}}
    assert needs[1] > needs[2] > needs[4] > needs[8] > needs[16], "memory falls with the number of tiles"
    for fewer, num in ((1, 2), (2, 4), (4, 8), (8, 16)):
        plan = planned(needs[num])
        assert (plan.num_tiles, plan.needed_bytes, plan.fits) == (num, needs[num], True)
        assert planned(needs[fewer] - 1).num_tiles == num


def test_where_not_even_tiles_fit_the_least_need_is_told() -> None:
    plan = planned(1e8)
    assert not plan.fits and plan.num_tiles == MAX_TILES and plan.statistics_bytes == 0
    assert 1e8 < plan.needed_bytes < at_once_bytes()


def test_the_paper_knows_no_tiles() -> None:
    models, cameras = two_models()
    assert (aggregate_preset("paper").edge.most_tiles, Join().most_tiles) == (1, MAX_TILES)
    plan = plan_join_memory(models, cameras, SIDE_PX, at_once_bytes() - 1, most_tiles=1)
    assert (plan.fits, plan.num_tiles, plan.needed_bytes) == (False, 1, at_once_bytes())


def test_models_without_gaussians_take_what_a_process_takes() -> None:
    models, cameras = two_models()
    nothing = [model.select(np.arange(0)) for model in models]
    plan = plan_join_memory(nothing, cameras, SIDE_PX, 1e8)
    assert not plan.fits and plan.num_tiles == 1
    assert plan.needed_bytes == join_bytes(0, 0, 0.0, pixels_of(cameras, SIDE_PX))
    assert plan_join_memory([], [], SIDE_PX, 1e9).fits


def test_more_of_anything_never_takes_less() -> None:
    base = join_bytes(1000, 1000, 236, [1000] * 10)
    assert join_bytes(1001, 1000, 236, [1000] * 10) > base and join_bytes(1000, 1001, 236, [1000] * 10) > base
    assert join_bytes(1000, 1000, 237, [1000] * 10) > base and join_bytes(1000, 1000, 236, [1001]) > base
    assert join_bytes(1000, 1000, 236, [1000] * 400) == base, "views lie in a file"
    assert join_bytes(0, 0, 236, []) > 0


def limit_of(num_bytes: float) -> JoinLimit:
    return JoinLimit(num_bytes=num_bytes, label="memory_gb of this edge", lift="raise memory_gb of this edge")


@pytest.mark.parametrize(("num_tiles", "fits", "costs"), [(4, True, TILES_COST), (MAX_TILES, False, CUT_AT_EDGE_COSTS)])
def test_a_limit_that_bites_is_decided_and_warned_of(num_tiles: int, fits: bool, costs: str) -> None:
    reporter = Recorder(stage="edges/a")
    memory = JoinMemory(num_tiles=num_tiles, needed_bytes=9e8, statistics_bytes=0, fits=fits)
    report_join_memory(memory, limit_of(1e8), CUT_AT_EDGE_COSTS, reporter)
    (decision,), (warning,) = reporter.decisions, reporter.warnings
    assert decision.choice.startswith("models are joined in 4 tiles" if fits else "models are cut at their borders")
    assert (decision.stage, decision.topic, decision.figure, decision.forced) == ("edges/a", "memory", 100, True)
    assert "predicted to take 900 MB, where memory_gb of this edge allows 100 MB" in warning
    assert costs in warning and "raise memory_gb of this edge" in warning


def test_all_at_once_is_no_decision() -> None:
    reporter = Recorder()
    report_join_memory(planned(1e12), limit_of(1e12), CUT_AT_EDGE_COSTS, reporter)
    assert not reporter.decisions and not reporter.warnings


def test_a_cut_keeps_of_each_model_what_it_owns() -> None:
    models, cameras = two_models()
    joined = cut_at_borders([Teacher(splats=model, cameras=own) for model, own in zip(models, cameras, strict=True)])
    assert joined.trained.num_steps == 0 and 0 < len(joined.splats) < joined.num_given == COUNT
