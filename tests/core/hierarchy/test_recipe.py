"""The tasks of a run's devices: steps by photographs, whatever happens to the plan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.aggregate.config import AggregateConfig
from radiant_core.choices import StepPolicy
from radiant_core.hierarchy.decisions import step_decision
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.numerics import FloatArray
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_core.plan.revision.replan import FleetChange, ReplanInfeasible, replan
from radiant_core.plan.system import Device, Edge, System
from radiant_core.train.config import train_preset
from radiant_core.train.needs import step_law_of

NUM_STEPS = 800


def device(name: str, seconds_per_camera: float) -> Device:
    return Device(
        id=name,
        init_s=CostCurve(),
        train_s=CostCurve(linear=seconds_per_camera),
        model_bytes=CostCurve(linear=1e5),
        uplink_bytes_per_s=1e6,
    )


def unequal() -> System:
    """Two edges; the devices of each differ by a factor of four."""
    edges = [
        Edge(
            id=name,
            position=(x, 0.0),
            aggregate_s=CostCurve(linear=0.1),
            uplink_bytes_per_s=1e6,
            devices=(device(f"{name}-1", 1.0), device(f"{name}-2", 4.0)),
        )
        for name, x in (("a", 10.0), ("b", 90.0))
    ]
    return System(edges=tuple(edges))


def positions(count: int) -> FloatArray:
    return np.random.default_rng(0).random((count, 2)) * [100.0, 20.0]


def recipe_of(count: int, policy: StepPolicy = "per_photograph", num_steps: int = NUM_STEPS) -> Recipe:
    system, places = unequal(), positions(count)
    cloud = plan_regions(places, system)
    assert isinstance(cloud, CloudPlan)
    return Recipe(
        system=system,
        cloud_plan=cloud,
        edge_plans=split_edges(places, cloud, system),
        train=replace(train_preset("draft"), num_steps=num_steps, max_epochs=None),
        aggregate=AggregateConfig(),
        backend="native",
        step_policy=policy,
    )


def steps_of(recipe: Recipe) -> dict[str, int]:
    return {own.id: recipe.device_settings(own.id).train.num_steps for own in recipe.system.devices if len(recipe.cameras_of(own.id))}


def test_steps_follow_photographs_and_all_devices_take_as_many_as_by_a_fixed_number() -> None:
    recipe = recipe_of(200)
    quotas = {name: len(recipe.cameras_of(name)) for name in steps_of(recipe)}
    assert max(quotas.values()) > 3 * min(quotas.values()), "the devices are unequal"
    for name, steps in steps_of(recipe).items():
        assert steps == pytest.approx(NUM_STEPS * quotas[name] / 50, abs=0.5)
    # Rounded once per device.
    assert sum(steps_of(recipe).values()) == pytest.approx(4 * NUM_STEPS, abs=2)
    assert set(steps_of(recipe_of(200, "fixed")).values()) == {NUM_STEPS}


def test_everything_but_the_length_of_a_training_stays_and_joins_keep_their_own() -> None:
    recipe = recipe_of(200)
    for name, steps in steps_of(recipe).items():
        assert recipe.device_settings(name).train == replace(recipe.train, num_steps=steps, drop_gaussians="none")
    assert recipe.edge_task("a", {"a-1": 1}).train == recipe.train


def test_a_device_with_next_to_no_photographs_still_trains() -> None:
    law = step_law_of(replace(train_preset("draft"), num_steps=1_500), 1_000, 4)
    assert (law.steps(1), law.steps(250), law.steps(500)) == (100, 1_500, 3_000)
    short = step_law_of(replace(train_preset("draft"), num_steps=24), 40, 4)
    assert (short.steps(1), short.steps(10)) == (6, 24)


def test_few_photographs_shorten_all_devices_alike() -> None:
    """`max_epochs` holds for the mean device: each taken by itself would end the law where it matters."""
    recipe = replace(recipe_of(80), train=replace(train_preset("default"), num_steps=7_000))
    assert recipe.train.max_epochs == 120
    steps = steps_of(recipe)
    assert sum(steps.values()) == pytest.approx(4 * 120 * 20, abs=2)
    assert all(recipe.device_settings(name).train.max_epochs is None for name in steps)


def test_a_replanned_run_keeps_the_law() -> None:
    recipe, places = recipe_of(200), positions(200)
    fixed = np.zeros(200, bool)
    fixed[recipe.cameras_of("a-1")] = True
    change = FleetChange(dead=frozenset({"b-2"}), closed=frozenset({"a-1"}))
    new = replan(recipe.cloud_plan, recipe.edge_plans, places, recipe.system, change, captured=fixed)
    assert not isinstance(new, ReplanInfeasible)
    after = recipe.with_plan(new.cloud, new.edges)
    assert after.device_settings("a-1") == recipe.device_settings("a-1"), "it has begun"
    for name, steps in steps_of(after).items():
        assert steps == pytest.approx(NUM_STEPS * len(after.cameras_of(name)) / 50, abs=0.5)
    assert sum(steps_of(after).values()) == pytest.approx(4 * NUM_STEPS, abs=2)


def test_the_report_says_what_each_photograph_is_worth() -> None:
    decision = step_decision(recipe_of(200))
    assert decision is not None and decision.figure == pytest.approx(NUM_STEPS / 50) and not decision.changes_nothing
    assert step_decision(recipe_of(200, "fixed")) is None


def test_the_plans_cost_of_training_is_that_of_the_steps_it_takes() -> None:
    law = step_law_of(replace(train_preset("draft"), num_steps=800, max_epochs=None), 52, 4)
    # 800 steps take 8 s, and 0.1 s more for each photograph's Gaussians.
    of_fixed = CostCurve(constant=8.0, linear=0.1)
    curve = law.cost(of_fixed, 800, 52)
    for count in (7, 13, 26, 52):
        assert float(curve(count)) == pytest.approx(law.steps(count) * (8.0 + 0.1 * count) / 800, rel=0.03)
    assert law.cost(CostCurve(), 800, 52) == CostCurve()


def test_gaussians_are_left_out_at_random_by_a_device_alone_never_where_models_are_joined() -> None:
    several = recipe_of(60)
    first = several.edge_plans[0]
    alone = replace(several, edge_plans=(replace(first, device_of_camera=np.zeros_like(first.device_of_camera)),))
    assert several.training_of("a-1").drop_gaussians == "none"
    assert alone.training_of("a-1").drop_gaussians == "auto"
    asking = replace(several, train=replace(several.train, cross_validate="auto", drop_gaussians="always"))
    joined = asking.training_of("a-1")
    assert joined.cross_validate == "none" and joined.drop_gaussians == "always"
