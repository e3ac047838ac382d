"""What a run's settings, costs and memory make of the choice between together and joined."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiant_app.commands.machine.exchange_time import measure_exchange
from radiant_app.config.fields import config_of
from radiant_app.config.run_config import AggregateOptions, ExecutionOptions, PlanOptions, RunConfig, TrainOptions
from radiant_app.events import Decided, Event, Warned
from radiant_app.files.system_file import even_system, load_system
from radiant_app.run.foreseen import planned_makespan_s
from radiant_app.run.grouping import VIEW_S, choose_run_groups, group_rules, obstacle_of
from radiant_app.run.stages import costs_of_run
from radiant_app.together.places import LATE_S
from radiant_core.aggregate.config import AggregateConfig
from radiant_core.errors import BadInput
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_core.plan.system import System
from radiant_core.plan.together.groups import GroupPlan
from radiant_core.train.config import train_preset

CONFIG = RunConfig(source=Path("photos"), out=Path("run"), train=TrainOptions(long_side_px=384, num_steps=500))
TRAIN = replace(train_preset("default"), long_side_px=384, num_steps=500)
NUM_PHOTOGRAPHS = 60


def unequal_system(folder: Path, link_mbit: float, latency_ms: float = 0.1) -> System:
    """An edge with a laptop of the library and one 0.6 times as fast."""
    path = folder / "system.toml"
    path.write_text(
        f"""
[[edge]]
id = "a"
position_m = [0.0, 0.0]
latency_ms = {latency_ms}
[[edge.device]]
id = "a1"
profile = "laptop-cpu"
uplink_mbit_per_s = {link_mbit}
[[edge.device]]
id = "a2"
profile = "laptop-cpu"
relative_speed = 0.6
uplink_mbit_per_s = {link_mbit}
"""
    )
    return load_system(path)


def chosen(
    config: RunConfig, system: System, *, photographs_move: bool = True
) -> tuple[tuple[GroupPlan, ...], list[Decided], tuple[EdgePlan, ...]]:
    system, _ = costs_of_run(config, system, NUM_PHOTOGRAPHS)
    positions = np.random.default_rng(0).random((NUM_PHOTOGRAPHS, 2)) * 100
    plan = plan_regions(positions, system)
    assert isinstance(plan, CloudPlan)
    heard: list[Event] = []
    edges = split_edges(positions, plan, system)
    groups = choose_run_groups(config, system, edges, heard.append, photographs_move=photographs_move)
    # A step that is too long for them is said, and only such a one.
    late = [event.message for event in heard if isinstance(event, Warned)]
    assert len(late) == sum(group.step_s > LATE_S for group in groups)
    assert all("who says nothing for 60 s is left out: use --within-edge joined" in message for message in late)
    return groups, [event for event in heard if isinstance(event, Decided)], edges


def place_edges(system: System) -> System:
    return replace(system, edges=tuple(replace(edge, position=(100.0 * index, 0.0)) for index, edge in enumerate(system.edges)))


def with_plan(**options: str) -> RunConfig:
    return replace(CONFIG, plan=PlanOptions(**options))  # type: ignore[arg-type]


def test_photographs_are_dealt_nearly_in_the_ratio_of_views_where_devices_train_together(tmp_path: Path) -> None:
    config = with_plan(within_edge="together")
    (group,), (event,), (edge,) = chosen(config, unequal_system(tmp_path, 20.0))
    assert group.views == {"a1": 2, "a2": 1}
    assert [len(edge.cameras_of(name)) for name in ("a1", "a2")] == [38, 22]  # speeds 1 and 0.6
    # Two devices of 500 steps each show as many photographs as one machine in 1,000.
    assert group.num_steps == round(1000 / 3)
    assert event.decision.forced


@pytest.mark.parametrize(
    ("link_mbit", "latency_ms", "together"), [(20.0, 0.1, False), (1e4, 0.1, True), (1e4, 200.0, True), (1e4, 500.0, False)]
)
def test_links_decide_between_the_same_machines(tmp_path: Path, link_mbit: float, latency_ms: float, together: bool) -> None:
    """Joined: 152 to 157 s; together 482, 58, 178 and 378 s."""
    groups, (event,), _ = chosen(CONFIG, unequal_system(tmp_path, link_mbit, latency_ms))
    assert bool(groups) == together
    assert not event.decision.forced
    assert event.decision.unit.startswith("s together, ")


def test_a_step_that_is_longer_than_machines_wait_for_each_other_is_said(tmp_path: Path) -> None:
    config = with_plan(within_edge="together")
    (slow,), _, _ = chosen(config, unequal_system(tmp_path, 1e4, latency_ms=40_000.0))
    assert slow.step_s == pytest.approx(80.0, rel=0.1)
    (usual,), _, _ = chosen(config, unequal_system(tmp_path, 1e4))
    assert usual.step_s < 1.0


def test_a_device_without_memory_for_one_model_of_all_keeps_its_edge_joined(tmp_path: Path) -> None:
    system = unequal_system(tmp_path, 1e4)
    edge = system.edges[0]
    small = replace(system, edges=(replace(edge, devices=(edge.devices[0], replace(edge.devices[1], memory_bytes=2e8))),))
    groups, (event,), _ = chosen(CONFIG, small)
    assert not groups
    assert event.decision.reason == "the memory of a2 does not hold one model of all 60 photographs"
    roomy = replace(system, edges=(replace(edge, devices=(edge.devices[0], replace(edge.devices[1], memory_bytes=64e9))),))
    assert chosen(CONFIG, roomy)[0]


def test_machines_that_nobody_knows_go_by_their_links(tmp_path: Path) -> None:
    rules = group_rules(CONFIG, even_system(2, 2), TRAIN, NUM_PHOTOGRAPHS)
    assert rules.law.view_s == VIEW_S
    assert group_rules(CONFIG, unequal_system(tmp_path, 20.0), TRAIN, NUM_PHOTOGRAPHS).law.view_s is None
    groups, events, _ = chosen(CONFIG, place_edges(even_system(2, 2)))
    assert not groups
    assert all("the machines' times are not known" in event.decision.reason for event in events)


def test_a_views_time_and_the_views_of_all_follow_the_policy_of_steps(tmp_path: Path) -> None:
    system = unequal_system(tmp_path, 100.0)
    fixed = replace(CONFIG, train=replace(CONFIG.train, step_policy="fixed"))
    times_s = []
    for config in (CONFIG, fixed):
        costs, _ = costs_of_run(config, system, NUM_PHOTOGRAPHS)
        law = group_rules(config, costs, TRAIN, NUM_PHOTOGRAPHS).law
        assert law.views_per_photograph == pytest.approx(2 * 500 / NUM_PHOTOGRAPHS)
        times_s.append(law.device_view_s(costs.devices[0], NUM_PHOTOGRAPHS))
    # The same machine renders a view of the same model; the curves were fitted within some percent.
    assert times_s[0] == pytest.approx(times_s[1], rel=0.1)


@pytest.mark.parametrize(
    ("changes", "obstacle"),
    [
        ({}, None),
        ({"frames": "known"}, None),
        ({"emulate": Path("system.toml")}, None),
        ({"frames": "gps"}, "frames by GPS are not exact"),
        ({"frames": "gps", "execution": ExecutionOptions(executor="network")}, "machines of several owners"),
        ({"aggregate": AggregateOptions(preset="paper")}, "the paper joins models"),
    ],
)
def test_runs_in_which_nobody_can_train_together_join(changes: dict, obstacle: str | None, tmp_path: Path) -> None:
    config = replace(CONFIG, **changes)
    said = obstacle_of(config)
    assert said is None if obstacle is None else said is not None and said.startswith(obstacle)
    assert group_rules(config, unequal_system(tmp_path, 1e4), TRAIN, NUM_PHOTOGRAPHS).obstacle == said


@pytest.mark.parametrize("option", ["plan.within_edge", "plan.between_edges"])
@pytest.mark.parametrize("where", [{"frames": "gps"}, {"frames": "known", "execution.executor": "network"}])
def test_to_ask_for_it_there_is_refused(option: str, where: dict) -> None:
    with pytest.raises(BadInput, match="machines that train together need one exact frame"):
        config_of({"source": Path("photos"), "out": Path("run"), option: "together", **where})


def test_to_ask_for_it_of_emulated_machines_is_taken() -> None:
    asked = config_of({"source": Path("photos"), "out": Path("run"), "emulate": Path("s.toml"), "plan.between_edges": "together"})
    assert asked.emulated and asked.plan.asks_together and obstacle_of(asked) is None


def test_masks_are_asked_for_with_machines_that_train_together_alone() -> None:
    where = {"source": Path("photos"), "out": Path("run"), "plan.mask_gradients": True}
    assert config_of(where).plan.mask_gradients and not config_of({**where, "plan.mask_gradients": False}).plan.mask_gradients
    for joined in ({"plan.within_edge": "joined"}, {"preset": "paper"}):
        with pytest.raises(BadInput, match="--mask-gradients is for machines that train together, and --within-edge is joined"):
            config_of({**where, **joined})
    with pytest.raises(BadInput, match=r"with --frames gps their models are joined.*--mask-gradients out"):
        config_of({**where, "frames": "gps"})


def test_options_that_exclude_each_other_are_refused_and_the_paper_joins() -> None:
    where = {"source": Path("photos"), "out": Path("run")}
    with pytest.raises(BadInput, match="--between-edges together and --within-edge joined exclude each other"):
        config_of({**where, "plan.within_edge": "joined", "plan.between_edges": "together"})
    paper = config_of({**where, "preset": "paper"}).plan
    assert (paper.within_edge, paper.between_edges) == ("joined", "joined")


def test_an_exchange_between_two_processes_is_measured() -> None:
    measured = measure_exchange()
    # A thread that waits is not woken in less than a microsecond; a second is no exchange of 1 kB.
    assert 1e-6 < measured.latency_s < 1.0
    assert 1e-11 < measured.add_s_per_byte < 1e-5


def test_a_planned_makespan_is_of_the_steps_of_those_that_train_together_and_of_the_edges_that_do_not() -> None:
    system, positions = place_edges(even_system(2, 2)), np.random.default_rng(0).random((NUM_PHOTOGRAPHS, 2)) * 100
    plan = plan_regions(positions, system)
    assert isinstance(plan, CloudPlan)
    edges = split_edges(positions, plan, system)
    recipe = Recipe(system=system, cloud_plan=plan, edge_plans=edges, train=TRAIN, aggregate=AggregateConfig(), backend="native")
    first, second = system.edges
    views = {device.id: 1 for device in first.devices}
    group = GroupPlan(level="edge", edges=(first.id,), views=views, num_photographs=30, num_steps=100, step_s=1.0, start_s=5.0, end_s=2.0)
    assert planned_makespan_s(recipe, ()) == plan.makespan_s
    assert planned_makespan_s(recipe, (group,)) == max(107.0, plan.edge_time_s[1])
    assert planned_makespan_s(recipe, (replace(group, step_s=0.01),)) == plan.edge_time_s[1] > 8.0
    of_all = replace(group, level="cloud", edges=(first.id, second.id), step_s=0.01)
    assert planned_makespan_s(recipe, (of_all,)) == pytest.approx(8.0) != plan.makespan_s
