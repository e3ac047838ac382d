"""Who refines a joined scene: those whose edges and cloud have memory for the average, and never one device alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from radiant_core.aggregate.averaging import average_bytes
from radiant_core.aggregate.config import Refine
from radiant_core.hierarchy.join_limits import UNREFINED_COSTS
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.hierarchy.refining_plan import choose_rounds, plan_refining
from radiant_core.plan.system import Cloud
from tests.app.test_faults import planned

NUM_SPLATS = 1_000_000
PRESENT = {"edge-1": ["edge-1-device-1", "edge-1-device-2"], "edge-2": ["edge-2-device-1"]}


@pytest.fixture
def recipe(tmp_path: Path) -> Recipe:
    return planned(tmp_path)[0].recipe


def with_limits(recipe: Recipe, cloud: float | None, edges: dict[str, float]) -> Recipe:
    owned = tuple(replace(edge, memory_bytes=edges.get(edge.id)) for edge in recipe.system.edges)
    return replace(recipe, system=replace(recipe.system, edges=owned, cloud=Cloud(memory_bytes=cloud)))


def test_without_limits_all_devices_in_the_scene_refine(recipe: Recipe) -> None:
    plan = plan_refining(recipe, {**PRESENT, "edge-3": []}, NUM_SPLATS)
    assert {edge: list(devices) for edge, devices in plan.devices.items()} == PRESENT
    assert [decision.topic for decision in plan.decisions] == ["rounds of refining"]
    idle = replace(recipe, aggregate=replace(recipe.aggregate, refine=Refine(epochs=0)))
    assert not plan_refining(idle, PRESENT, NUM_SPLATS).devices and not plan_refining(idle, PRESENT, NUM_SPLATS).decisions


@pytest.mark.parametrize("present", [{}, {"edge-1": []}, {"edge-1": [], "edge-2": ["edge-2-device-1"]}])
def test_fewer_than_two_devices_refine_nothing_and_it_is_told(recipe: Recipe, present: dict[str, list[str]]) -> None:
    plan = plan_refining(recipe, present, NUM_SPLATS)
    assert not plan.devices and [decision.choice for decision in plan.decisions] == ["no device refines the scene"]
    assert plan.decisions[0].figure == sum(map(len, present.values()))


def test_memory_of_the_cloud_and_of_edges_is_kept_to(recipe: Recipe) -> None:
    needed, of_edge = (average_bytes(NUM_SPLATS, recipe.train.sh_degree, renders=renders) for renders in (False, True))
    assert plan_refining(with_limits(recipe, needed, {"edge-1": of_edge}), PRESENT, NUM_SPLATS).devices.keys() == PRESENT.keys()
    none = plan_refining(with_limits(recipe, needed - 1, {}), PRESENT, NUM_SPLATS)
    assert not none.devices and [decision.figure for decision in none.decisions] == [pytest.approx(needed / 1e9)]
    assert "memory_gb of the cloud" in none.decisions[0].reason
    (warning,) = none.warnings
    assert (
        warning.startswith("the scene is not refined: ")
        and UNREFINED_COSTS in warning
        and "Raise that memory_gb in the system file" in warning
    )
    without = plan_refining(with_limits(recipe, None, {"edge-2": of_edge - 1}), PRESENT, NUM_SPLATS)
    assert list(without.devices) == ["edge-1"] and [decision.choice for decision in without.decisions] == [
        "the scene is not refined by edge-2-device-1",
        f"devices refine the scene in {choose_rounds(recipe)} {'round' if choose_rounds(recipe) == 1 else 'rounds'} of at most 8 epochs",
    ]
    (warning,) = without.warnings
    assert warning.startswith("the scene is not refined by edge-2-device-1: ") and "memory_gb of edge-2 allows" in warning
    alone = plan_refining(with_limits(recipe, None, {"edge-1": of_edge - 1}), PRESENT, NUM_SPLATS)
    assert not alone.devices and len(alone.decisions) == 2 and len(alone.warnings) == 1
    assert not plan_refining(recipe, PRESENT, NUM_SPLATS).warnings
