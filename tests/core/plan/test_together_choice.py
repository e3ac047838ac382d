"""Together or joined: together up to twice as long by predicted times, and what stands against it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.choices import TrainedAs
from radiant_core.errors import BadInput
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_core.plan.system import Cloud, Device, Edge, System
from radiant_core.plan.timeline.prediction import planned_stages
from radiant_core.plan.timeline.refining import RefiningLaw, predict_refining
from radiant_core.plan.together.choosing import BETWEEN, WITHIN, GroupChoice, GroupRules, choose_groups, choose_within
from radiant_core.plan.together.costs import TogetherLaw, end_cost, start_cost, step_cost
from radiant_core.plan.together.groups import GroupPlan
from tests.core.plan.instances import random_system
from tests.seeds import for_seeds

MBIT = 1e6 / 8
NUM_PHOTOGRAPHS = 64
LAW = TogetherLaw(views_per_photograph=40.0, steps_of=lambda count: 40.0 * count, num_floats=23, splat_bytes=100.0)
RULES = GroupRules(law=LAW, refining=RefiningLaw(num_rounds=0, share_of_training=lambda count: 0.0))
REFINED = replace(RULES, refining=RefiningLaw(num_rounds=2, share_of_training=lambda count: 0.5))


def device(name: str, link_mbit: float, speed: float = 1.0) -> Device:
    """10 ms a view; a model of 64 photographs has 121,212 Gaussians, of which a view shows a quarter,
    a megabyte a step at 33 bytes a row."""
    return Device(
        id=name,
        init_s=CostCurve(constant=2.0),
        train_s=CostCurve(linear=0.4 / speed),
        model_bytes=CostCurve(linear=100 * 4e6 / 33 / NUM_PHOTOGRAPHS),
        uplink_bytes_per_s=link_mbit * MBIT,
    )


def edge(name: str, link_mbit: float, *, num_devices: int = 2, latency_s: float = 1e-4, x: float = 0.0) -> Edge:
    return Edge(
        id=name,
        position=(x, 0.0),
        aggregate_s=CostCurve(linear=1.0),
        aggregate_alone_s=CostCurve(constant=1.0),
        uplink_bytes_per_s=link_mbit * MBIT,
        devices=tuple(device(f"{name}{index}", link_mbit) for index in range(num_devices)),
        latency_s=latency_s,
    )


def planned(system: System, num_photographs: int = NUM_PHOTOGRAPHS) -> tuple[EdgePlan, ...]:
    positions = np.random.default_rng(0).random((num_photographs, 2)) * 100
    cloud = plan_regions(positions, system)
    assert isinstance(cloud, CloudPlan)
    return split_edges(positions, cloud, system)


def within(at: Edge, rules: GroupRules = RULES, num_photographs: int = NUM_PHOTOGRAPHS) -> GroupChoice:
    return choose_within(at, planned(System(edges=(at,)), num_photographs)[0], rules)


@pytest.mark.parametrize(("link_mbit", "together", "seconds"), [(20.0, False, 1426.073), (1000.0, True, 36.7301)])
def test_a_megabyte_a_step_is_joined_at_20_mbit_and_trained_together_at_1_gbit(link_mbit: float, together: bool, seconds: float) -> None:
    """1,280 steps of 1.1042 or 0.0262 s of exchange, which hides 0.01 s of views, 3 s and a model of
    12.1 MB down and up; joined 86.1 or 78.9 s, of which 2 + 12.8 + 64 s are not the links'."""
    at = edge("a", link_mbit)
    choice = within(at)
    cost = step_cost([at], None, {"a0": 1, "a1": 1}, NUM_PHOTOGRAPHS, LAW)
    assert cost.up_bytes == pytest.approx(1e6, rel=1e-12)
    assert (choice.group is not None) == together
    assert choice.decision.figure == pytest.approx(seconds, rel=1e-5)
    assert choice.decision.unit == f"s together, {78.9 if together else 86.1} s joined"
    assert "1 MB up and 1.8 MB down" in choice.decision.reason
    assert not choice.decision.forced


def test_where_together_takes_twice_as_long_is_the_bandwidth_of_curves_that_cross() -> None:
    """Of two equal devices with half of the photographs each, seconds are a + b / bandwidth, since
    the exchange is longer than the views and hides them."""
    at = edge("a", 200.0)
    model, half = 100 * 4e6 / 33, 100 * 4e6 / 33 / 2
    steps, sent = 40 * NUM_PHOTOGRAPHS / 2, 1e6 + 4e6 * (1 - 0.75**2)
    beside_s = 2e-4 + 2e-9 * 2e6  # the way there and back, adding
    sending_s = model / at.uplink_bytes_per_s  # the edge's model, either way
    together_s = 2.0 + 2e-4 + steps * beside_s + 1.0 + sending_s
    joined_s = 2.0 + 0.4 * NUM_PHOTOGRAPHS / 2 + 1.0 * NUM_PHOTOGRAPHS + sending_s
    level = (model + steps * sent - 2 * half) / (2 * joined_s - together_s)
    choice = within(at)
    assert f"at {level / MBIT:,.3g} Mbit/s it would take 2 times as long as joining" in choice.decision.reason
    for factor, together in ((0.99, False), (1.01, True)):
        linked = replace(at, devices=tuple(replace(each, uplink_bytes_per_s=level * factor) for each in at.devices))
        assert (within(linked).group is not None) == together


@pytest.mark.parametrize(
    ("latency_s", "together", "seconds"),
    [
        (0.03, True, 85.2635),  # later than joined
        (0.058, True, 156.9995),
        (0.0585, False, 158.2805),
    ],
)
def test_a_group_may_take_twice_the_time_of_joined_models_and_no_more(latency_s: float, together: bool, seconds: float) -> None:
    """Joined: 2 + 12.8 + 64 s and 1.5 ms of links, so 157.60 s at most; together: 3.00194 s at the
    ends, 1,280 steps of 4.22 ms, and two latencies 1,281 times."""
    choice = within(edge("a", 1e5, latency_s=latency_s))
    assert choice.decision.figure == pytest.approx(seconds, abs=1e-3)
    assert choice.decision.unit == "s together, 78.8 s joined"
    assert (choice.group is not None) == together
    assert choice.seconds == pytest.approx(seconds if together else 78.80145, abs=1e-3)


@pytest.mark.parametrize(("link_mbit", "overlaps", "step_s"), [(1e5, False, 0.01442), (5000.0, True, 0.01), (1000.0, True, 0.0262)])
def test_a_group_overlaps_where_its_exchange_is_longer_than_half_of_its_views(link_mbit: float, overlaps: bool, step_s: float) -> None:
    """10 ms of views; the exchange takes 4.2 ms and those of 2.75 MB."""
    group = within(edge("a", link_mbit)).group
    assert group is not None
    assert group.overlaps == overlaps
    assert group.step_s == pytest.approx(step_s, rel=1e-9)


def test_a_link_of_any_width_is_joined_where_every_message_is_late() -> None:
    assert within(edge("a", 1e6)).group is not None
    late = within(edge("a", 1e6, latency_s=0.1))
    assert late.group is None
    assert late.decision.reason.startswith("a step sends 1 MB up")
    assert "times as long as joining" not in late.decision.reason


def test_the_group_has_the_views_steps_and_times_that_it_was_chosen_by() -> None:
    at = replace(edge("a", 1000.0), devices=(device("a0", 1000.0), device("a1", 1000.0, speed=0.6)))
    choice = within(at)
    assert choice.group is not None
    assert choice.group.views == {"a0": 2, "a1": 1}
    assert (choice.group.level, choice.group.edges, choice.group.num_photographs) == ("edge", ("a",), NUM_PHOTOGRAPHS)
    assert choice.group.num_steps == round(40 * NUM_PHOTOGRAPHS / 3)
    # 1.75 MB up, 2.3125 MB down, two latencies, 2.75 MB to add: more than half of 20 ms of views.
    assert choice.group.step_s == pytest.approx(0.014 + 0.0185 + 2e-4 + 0.0055, rel=1e-12)
    assert choice.group.overlaps
    assert choice.group.start_s == start_cost([at], None, {"a0": 2 / 3, "a1": 1 / 3}, NUM_PHOTOGRAPHS)
    assert choice.group.end_s == end_cost(at, NUM_PHOTOGRAPHS)
    assert choice.seconds == choice.decision.figure == choice.group.seconds
    assert choice.decision.choice == "edge a: 2 devices train together, 2 + 1 views a step"
    assert choice.decision.topic == WITHIN


def is_worth_it(group: GroupPlan, joined_s: float) -> bool:
    return group.seconds < 2 * joined_s and sum(group.views.values()) <= 12


@for_seeds(60)
def test_together_is_chosen_up_to_twice_the_time_of_joined_by_its_own_times(seed: int) -> None:
    rng = np.random.default_rng(seed)
    system = random_system(rng, int(rng.integers(1, 4)))
    system = replace(
        system,
        cloud=Cloud(latency_s=rng.uniform(0, 0.05), merge_s=CostCurve(linear=rng.random()) if rng.random() < 0.5 else None),
        edges=tuple(replace(each, latency_s=rng.uniform(0, 0.01)) for each in system.edges),
    )
    law = replace(LAW, splat_bytes=10 ** rng.uniform(2, 5), views_per_photograph=10 ** rng.uniform(1, 3))
    rules = replace(REFINED if rng.random() < 0.5 else RULES, law=law)
    plans = planned(system, 40)
    groups, decisions = choose_groups(system, plans, rules)
    busy = [(at, plan) for at, plan in zip(system.edges, plans, strict=True) if len(plan.camera_indices)]
    alone_s = predict_refining(system, plans, rules.refining)
    each_s = []
    for at, plan in busy:
        own = max(row.stop_s for row in planned_stages(System(edges=(at,)), (plan,))) + (alone_s if len(busy) == 1 else 0.0)
        together = choose_within(at, plan, replace(rules, within="together")).group
        group = next((group for group in groups if group.edges == (at.id,) and group.level == "edge"), None)
        if group is not None:
            assert group == together and is_worth_it(group, own)
        elif not groups or groups[0].level == "edge":
            assert together is None or not is_worth_it(together, own)
        each_s.append(together.seconds if together is not None and is_worth_it(together, own) else own)
    if len(busy) > 1:
        merge_s = 0.0 if system.cloud.merge_s is None else float(system.cloud.merge_s(40))
        whole, _ = choose_groups(system, plans, replace(rules, between="together"))
        is_whole = bool(groups) and groups[0].level == "cloud"
        worth = bool(whole) and whole[0].level == "cloud" and is_worth_it(whole[0], max(each_s) + merge_s + alone_s)
        assert is_whole == worth
        assert decisions[-1].topic == BETWEEN


@pytest.mark.parametrize(("num_devices", "together"), [(12, True), (13, False)])
def test_more_than_twelve_views_a_step_are_joined_unless_asked_for(num_devices: int, together: bool) -> None:
    at = edge("a", 1e5, num_devices=num_devices)
    choice, asked = within(at), within(at, replace(RULES, within="together"))
    assert asked.group is not None and sum(asked.group.views.values()) == num_devices
    assert (choice.group is not None) == together
    assert ("with 13 views a step, more than 12, joined models are the better ones" in choice.decision.reason) != together


@pytest.mark.parametrize(("looks", "together"), [(10.0, True), (9.9, False)])
def test_fewer_than_ten_looks_at_each_photograph_are_joined_unless_asked_for(looks: float, together: bool) -> None:
    at, rules = edge("a", 1e5, num_devices=2), replace(RULES, law=replace(LAW, views_per_photograph=looks))
    choice, asked = within(at, rules), within(at, replace(rules, within="together"))
    assert asked.group is not None and (choice.group is not None) == together
    assert ("with 9.9 looks at each photograph, fewer than 10, joined models are the better ones" in choice.decision.reason) != together


@pytest.mark.parametrize("link_mbit", [20.0, 1000.0])
@pytest.mark.parametrize("wanted", ["together", "joined"])
def test_what_a_user_asks_for_is_done_marked_and_has_both_times(link_mbit: float, wanted: TrainedAs) -> None:
    at = edge("a", link_mbit)
    asked, free = within(at, replace(RULES, within=wanted)), within(at)
    assert (asked.group is not None) == (wanted == "together")
    assert asked.decision.forced
    assert (asked.decision.figure, asked.decision.unit, asked.decision.reason) == (
        free.decision.figure,
        free.decision.unit,
        free.decision.reason,
    )
    assert asked.decision.unit.startswith("s together, ") and asked.decision.unit.endswith(" s joined")


def test_edges_train_one_model_where_the_clouds_links_allow() -> None:
    fast = System(edges=(edge("a", 1e5), edge("b", 1e5, x=100.0)), cloud=Cloud(latency_s=1e-4, merge_s=CostCurve(linear=1.0)))
    groups, decisions = choose_groups(fast, planned(fast), REFINED)
    assert [group.level for group in groups] == ["cloud"]
    assert groups[0].views == {"a0": 1, "a1": 1, "b0": 1, "b1": 1}
    assert [decision.topic for decision in decisions] == [BETWEEN]
    slow = replace(fast, edges=tuple(replace(at, uplink_bytes_per_s=5 * MBIT) for at in fast.edges))
    groups, decisions = choose_groups(slow, planned(slow), REFINED)
    assert [(group.level, group.edges) for group in groups] == [("edge", ("a",)), ("edge", ("b",))]
    assert [decision.topic for decision in decisions] == [WITHIN, WITHIN, BETWEEN]
    forced, (decision,) = choose_groups(slow, planned(slow), replace(REFINED, between="together"))
    assert forced[0].level == "cloud" and decision.forced
    none, decisions = choose_groups(fast, planned(fast), replace(REFINED, within="joined"))
    assert not none
    assert "within_edge is joined" in decisions[-1].reason


def test_to_train_together_across_edges_and_not_within_them_is_refused() -> None:
    system = System(edges=(edge("a", 100.0),))
    with pytest.raises(BadInput, match="between_edges is together and within_edge is joined"):
        choose_groups(system, planned(system), replace(RULES, within="joined", between="together"))


@pytest.mark.parametrize(
    ("at", "rules", "reason"),
    [
        (edge("a", 1e5, num_devices=1), RULES, "one device trains"),
        (edge("a", 1e5), replace(RULES, obstacle="frames by GPS are not exact"), "frames by GPS are not exact"),
        (
            edge("a", 1e5),
            replace(RULES, holds=lambda device, count: device.id != "a1"),
            "the memory of a1 does not hold one model of all 64",
        ),
        (
            replace(edge("a", 1e5), devices=tuple(replace(each, train_s=CostCurve()) for each in edge("a", 1e5).devices)),
            RULES,
            "no time of training",
        ),
    ],
)
@pytest.mark.parametrize("wanted", ["auto", "together"])
def test_what_stands_against_it_is_named_even_where_it_is_asked_for(at: Edge, rules: GroupRules, reason: str, wanted: TrainedAs) -> None:
    choice = within(at, replace(rules, within=wanted))
    assert choice.group is None
    assert reason in choice.decision.reason
    assert not choice.decision.forced  # nobody asked for what is done
    assert choice.decision.figure == choice.seconds


def test_a_latency_that_nobody_measured_is_named() -> None:
    at = edge("a", 1000.0)
    assert "assumed" not in within(at).decision.reason
    unknown = within(replace(at, latency_s=None)).decision.reason
    assert unknown.endswith("; a latency of 1 ms is assumed, as none was measured")


def test_no_photographs_no_decision() -> None:
    system = System(edges=(edge("a", 100.0), edge("b", 100.0)))
    nothing = tuple(
        EdgePlan(
            edge_id=at.id,
            device_ids=tuple(each.id for each in at.devices),
            camera_indices=np.zeros(0, np.int64),
            device_of_camera=np.zeros(0, np.int64),
            strips=(np.zeros((0, 2)),) * 2,
            device_time_s=np.zeros(2),
        )
        for at in system.edges
    )
    assert choose_groups(system, nothing, RULES) == ((), ())


def test_an_edge_known_by_its_curve_alone_joins() -> None:
    bare = Edge(id="b", position=(9.0, 0.0), aggregate_s=CostCurve(), uplink_bytes_per_s=1e7, devices=(), time_s=CostCurve(linear=1.0))
    system = System(edges=(edge("a", 1e5), bare))
    groups, decisions = choose_groups(system, planned(system), RULES)
    assert all(group.edges == ("a",) for group in groups)
    assert "the devices of b are not known here" in decisions[-1].reason


def test_devices_that_keep_their_photographs_show_all_of_them_equally_often() -> None:
    at = replace(edge("a", 1e5), devices=(device("a0", 1e5), device("a1", 1e5, speed=0.5), device("a2", 1e5)))
    plan = planned(System(edges=(at,)))[0]
    unmoved = replace(plan, device_of_camera=np.repeat([0, 1], [20, 44]))
    choice = choose_within(at, unmoved, replace(RULES, within="together", photographs_move=False))
    assert choice.group is not None
    assert choice.group.views == {"a0": 1, "a1": 2}  # of 20 and 44; a2 has none
    assert choice_of_all(at, plan).group is not None


def choice_of_all(at: Edge, plan: EdgePlan) -> GroupChoice:
    return choose_within(at, plan, replace(RULES, within="together"))


def test_a_slow_device_works_where_the_others_cannot_hold_all() -> None:
    slow = device("a2", 1e5, speed=0.02)
    at = replace(edge("a", 1e5), devices=(device("a0", 1e5), device("a1", 1e5), slow))
    forced = replace(RULES, within="together")
    choice = within(at, forced)
    assert choice.group is not None and set(choice.group.views) == {"a0", "a1"}
    full = replace(at, devices=(*(replace(each, max_cameras=25) for each in at.devices[:2]), slow))
    choice = within(full, forced)
    assert choice.group is not None and set(choice.group.views) == {"a0", "a1", "a2"}


@pytest.mark.parametrize(("link_mbit", "together"), [(20.0, False), (105.0, False), (120.0, True), (1e5, True)])
def test_links_alone_decide_where_nobody_knows_the_machines(link_mbit: float, together: bool) -> None:
    """A step may last 4 · 50 ms: 4.2 ms and 2.75 MB take 214 ms at 105 Mbit/s, 188 ms at 120."""
    choice = within(edge("a", link_mbit), replace(RULES, law=replace(LAW, view_s=0.05)))
    assert (choice.group is not None) == together
    assert choice.decision.unit == "ms of exchange a step, 50 ms of views by an estimate"
    assert "the machines' times are not known" in choice.decision.reason
