"""Views of a step by speed, their number, and photographs dealt in their ratio."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.io.records import load_plan, load_plan_groups, save_plan
from radiant_core.plan.together.groups import GroupPlan, choose_views, group_of, group_steps, slowest_s, views_of_step
from tests.core.plan.test_prediction import planned
from tests.seeds import for_seeds

GROUP = GroupPlan(level="edge", edges=("a",), views={"a1": 2, "a2": 1}, num_photographs=30, num_steps=100, step_s=0.5)


def test_devices_of_speeds_1_and_0_6_give_5_and_3_of_eight_views() -> None:
    assert views_of_step([1.0, 0.6], 8) == (5, 3)


@for_seeds(60)
def test_no_other_deal_of_the_views_ends_a_step_sooner(seed: int) -> None:
    rng = np.random.default_rng(seed)
    speeds = rng.uniform(0.1, 1.0, int(rng.integers(1, 5))).tolist()
    num_views = len(speeds) + int(rng.integers(0, 6))
    views = views_of_step(speeds, num_views)
    assert sum(views) == num_views
    assert min(views) >= 1
    every = (deal for deal in itertools.product(range(1, num_views + 1), repeat=len(speeds)) if sum(deal) == num_views)
    assert slowest_s(views, speeds) == min(slowest_s(deal, speeds) for deal in every)


def test_of_equal_devices_the_first_gets_what_is_left_over() -> None:
    assert views_of_step([0.5, 0.5, 0.5], 5) == (2, 2, 1)


@pytest.mark.parametrize(
    ("speeds", "views"),
    [
        ([1.0] * 4, (1, 1, 1, 1)),
        ([7.0], (1,)),
        ([1.0, 0.95], (1, 1)),  # a step lasts 1.03 times what it would if views could be divided
        ([1.0, 0.6], (2, 1)),  # 1.07 times; one each would be 1.33
        ([1.0, 0.5, 0.5], (2, 1, 1)),
    ],
)
def test_a_step_has_no_more_views_than_keep_all_devices_busy(speeds: list[float], views: tuple[int, ...]) -> None:
    assert choose_views(speeds) == views


@for_seeds(60)
def test_the_number_of_views_is_the_least_that_is_balanced_or_the_best_balanced_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    speeds = rng.uniform(0.2, 1.0, int(rng.integers(1, 6))).tolist()
    chosen = choose_views(speeds)
    unbalance = [slowest_s(dealt, speeds) * sum(speeds) / sum(dealt) for dealt in all_deals(speeds)]
    at = sum(chosen) - len(speeds)
    is_best = unbalance[at] <= min(unbalance) * (1 + 1e-9)  # of equal ones, the last digit does not decide
    assert is_best or (unbalance[at] <= 1.1 and min(unbalance[:at], default=2.0) > 1.1)


def all_deals(speeds: list[float]) -> list[tuple[int, ...]]:
    return [views_of_step(speeds, count) for count in range(len(speeds), 2 * len(speeds) + 1)]


def test_who_would_hold_the_others_up_stays_idle_where_photographs_move() -> None:
    assert choose_views([1.0, 0.05, 1.0], may_idle=True) == (1, 0, 1)
    assert choose_views([1.0, 0.05, 1.0]) == (3, 1, 2)
    assert choose_views([1.0, 0.05], may_idle=True) == (3, 1)  # two always work


@pytest.mark.parametrize("speeds", [[], [1.0, 0.0], [1.0, -1.0], [float("nan")], [float("inf"), 1.0]])
def test_speeds_that_are_none_are_refused(speeds: list[float]) -> None:
    with pytest.raises(BadInput, match="give each a positive number of views a second"):
        choose_views(speeds)


def test_a_step_needs_a_view_of_each_device() -> None:
    with pytest.raises(BadInput, match="2 views a step are too few for 3 devices"):
        views_of_step([1.0, 1.0, 1.0], 2)


def test_a_group_takes_as_many_views_as_one_machine() -> None:
    assert (group_steps(2000, 4), group_steps(2000, 3), group_steps(1, 8)) == (500, 667, 1)
    for views, step in ((0.0, 1), (float("inf"), 1), (10.0, 0)):
        with pytest.raises(BadInput, match="make no training"):
            group_steps(views, step)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"views": {"a1": 1}}, "two devices or more"),
        ({"views": {"a1": 1, "a2": 0}}, "at least one view each"),
        ({"edges": ("a", "b")}, "expected one edge, or the cloud and its edges"),
        ({"edges": ()}, "expected one edge"),
        ({"num_steps": 0}, "at least one of each"),
        ({"num_photographs": 0}, "at least one of each"),
        ({"step_s": 0.0}, "a positive time"),
        ({"step_s": float("inf")}, "a positive time"),
        ({"start_s": -1.0}, "expected times of at least 0"),
        ({"end_s": float("nan")}, "expected times of at least 0"),
    ],
)
def test_a_group_that_cannot_train_is_refused(changes: dict, message: str) -> None:
    with pytest.raises(BadInput, match=message):
        replace(GROUP, **changes)


def test_a_groups_time_and_shares() -> None:
    group = replace(GROUP, start_s=3.0, end_s=4.0)
    assert (group.views_a_step, group.seconds, group.share("a1"), group.share("b1")) == (3, 57.0, 2 / 3, 0.0)
    assert group_of([group], "a2") is group
    assert group_of([group], "b1") is None


def test_groups_stand_in_a_plans_file_to_the_bit(tmp_path: Path) -> None:
    cloud, edges, _ = planned()
    other = replace(GROUP, edges=("b",), views={"b1": 1, "b2": 1}, start_s=0.1 + 0.2)
    save_plan(tmp_path / "plan.json", cloud, edges, groups=(GROUP, other))
    assert load_plan_groups(tmp_path / "plan.json") == (GROUP, other)
    assert load_plan(tmp_path / "plan.json")[0].counts.tolist() == cloud.counts.tolist()
    save_plan(tmp_path / "plan.json", cloud, edges)
    assert load_plan_groups(tmp_path / "plan.json") == ()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"a2": 1', '"a2": 0', r"together\[0\].views.a2 is 0; expected"),
        ('"level": "edge"', '"level": "sky"', r"together\[0\].level is 'sky'"),
        ('"num_steps": 100', '"num_steps": 1.5', r"together\[0\].num_steps is 1.5"),
        ('"step_s": 0.5', '"step_s": 0.5, "more": 1', r"together\[0\].more is not a key"),
        ('"a1": 2', '"b1": 2', "device 'b1' trains in two groups"),
    ],
)
def test_a_plans_file_with_wrong_groups_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    cloud, edges, _ = planned()
    path = tmp_path / "plan.json"
    save_plan(path, cloud, edges, groups=(GROUP, replace(GROUP, edges=("b",), views={"b1": 1, "b2": 1})))
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(BadInput, match=message):
        load_plan_groups(path)
