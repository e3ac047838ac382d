"""Whether machines train one model together or each its own, which are joined: by predicted times.

    within an edge      together: start + steps · step_s + end     joined: T^m, and refining where
                        (`costs`)                                  this edge is the only one
    between edges       together: start + steps · step_s           joined: the last edge, each by
                        of one group of all                        its own choice, merge, refining

Together is chosen where it takes less than `WORTH` times as long as joined models, by at most
`MOST_VIEWS` views a step and with `LEAST_LOOKS` at each photograph. Where devices' times are
nobody's, links alone decide: joining and refining last about as long as the training before them,
so a step may last less than 2 · `WORTH` times its views. Both predicted times are in the decision,
also where a user forces it. Once per plan.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from radiant_core.choices import TrainedAs
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.numerics import figure_text
from radiant_core.plan.plans import EdgePlan
from radiant_core.plan.system import Cloud, Device, Edge, System
from radiant_core.plan.timeline.prediction import planned_stages
from radiant_core.plan.timeline.refining import RefiningLaw, predict_refining
from radiant_core.plan.together.costs import LATENCY_S, StepCost, TogetherLaw, end_cost, start_cost, step_cost
from radiant_core.plan.together.groups import GroupLevel, GroupPlan, choose_views, group_steps

STAGE = "plan"
WITHIN, BETWEEN = "training within an edge", "training between edges"
"""Topics of the decisions."""
_FASTEST, _SLOWEST = 1e6, 1e-6
"""Factors of today's links between which the one where together is just worth it is looked for."""
_HALVINGS = 45


WORTH = 2.0
"""How many times as long as joined models one that machines train together may take: by four
devices, with as many views, it was 1.4, 0.6 and 0.6 dB better, corrected, on the town, caliterra
and lewis (docs/experiments/together.md). In the town joined ones stay 1.0 dB behind one model of
all also after three times the steps (docs/experiments/aggregation.md)."""
MOST_VIEWS = 12
"""Views a step up to which that holds: by 12 the town is 0.9 dB ahead and caliterra 0.2 behind, by
24, of sixteen devices, 400 photographs are 0.3 dB behind (docs/experiments/together.md)."""
LEAST_LOOKS = 10
"""Times that a training shows each photograph, from which on that holds: the town with 12 has 26.7
dB. With 6 at each of 1,600 the model of eight devices fell apart, since it grew to more Gaussians
than its steps can fit (docs/experiments/together.md)."""


@dataclass(frozen=True, kw_only=True)
class GroupRules:
    """What a plan's choices go by."""

    law: TogetherLaw
    refining: RefiningLaw
    within: TrainedAs = "auto"
    between: TrainedAs = "auto"
    obstacle: str | None = None
    """Why nobody can train together, as a clause; None: nothing is in the way."""
    holds: Callable[[Device, int], bool] = lambda device, num_photographs: True
    """Whether a device's memory holds the model of so many photographs, its group's."""
    photographs_move: bool = True
    """Whether photographs are dealt by the plan. Else devices keep theirs, and their views follow
    these, not their speeds."""


@dataclass(frozen=True, kw_only=True)
class GroupChoice:
    """What was decided of one edge, or of all, and the group that follows."""

    decision: Decision
    group: GroupPlan | None = None
    """None: models are joined."""
    seconds: float = 0.0
    """Until what was chosen is at the cloud, as predicted; 0 where nobody trains."""


def choose_groups(system: System, edge_plans: Sequence[EdgePlan], rules: GroupRules) -> tuple[tuple[GroupPlan, ...], tuple[Decision, ...]]:
    """The groups of a plan, none where all models are joined, and the decisions about them.

    Raises BadInput where edges are to train together and what is below them is to be joined, and
    where the plan is of other edges.
    """
    if rules.between == "together" and rules.within == "joined":
        raise BadInput("between_edges is together and within_edge is joined: machines that train together across edges do so within them.")
    busy = [(edge, plan) for edge, plan in zip(system.edges, edge_plans, strict=True) if len(plan.camera_indices)]
    alone = len(busy) == 1
    within = [choose_within(edge, plan, rules, refining_s=_refining_s(edge, plan, rules) if alone else 0.0) for edge, plan in busy]
    if alone or not busy:
        return tuple(choice.group for choice in within if choice.group), tuple(choice.decision for choice in within)
    whole = choose_between(system, edge_plans, within, rules)
    if whole.group is not None:
        return (whole.group,), (whole.decision,)
    return tuple(choice.group for choice in within if choice.group), (*(choice.decision for choice in within), whole.decision)


def choose_within(edge: Edge, plan: EdgePlan, rules: GroupRules, *, refining_s: float = 0.0) -> GroupChoice:
    """How the devices of an edge train that the plan deals photographs to.

    `refining_s`: what refining the scene takes, where it is only needed if models are joined.
    """
    about = f"edge {edge.id}"
    joined_s = _joined_s(edge, plan) + refining_s
    reason = _reason_against([(edge, plan)], rules)
    if reason is not None:
        return GroupChoice(decision=_joined_by_rule(WITHIN, about, rules.within, joined_s, reason), seconds=joined_s)
    devices, num_photographs = _members([(edge, plan)], rules), len(plan.camera_indices)
    views = _views(devices, [(edge, plan)], rules)

    def group_at(factor: float) -> GroupPlan:
        at = _with_links(edge, factor)
        cost = step_cost([at], None, views, num_photographs, rules.law)
        return _group("edge", [at], views, num_photographs, rules.law, cost, start_cost([at], None, _shares(views), num_photographs))

    def difference_s(factor: float) -> float:
        return group_at(factor).seconds - WORTH * (_joined_s(_with_links(edge, factor), plan) + refining_s)

    links = [device.uplink_bytes_per_s for device in edge.devices if device.id in views]
    cost = step_cost([edge], None, views, num_photographs, rules.law)
    case = _Case(topic=WITHIN, about=about, wanted=rules.within, law=rules.law, assumed=_assumed([edge]))
    return _chosen(case, group_at(1.0), cost, joined_s, _level_links(difference_s, min(links)))


def choose_between(system: System, edge_plans: Sequence[EdgePlan], within: Sequence[GroupChoice], rules: GroupRules) -> GroupChoice:
    """Whether the devices of all edges train one model, where those of each edge train as chosen
    `within`; `auto` is joined where the user wants models of devices joined."""
    busy = [(edge, plan) for edge, plan in zip(system.edges, edge_plans, strict=True) if len(plan.camera_indices)]
    num_photographs = sum(len(plan.camera_indices) for _, plan in busy)
    joined_s = max((choice.seconds for choice in within), default=0.0) + predict_refining(system, edge_plans, rules.refining)
    if system.cloud.merge_s is not None:
        joined_s += float(system.cloud.merge_s(num_photographs))
    reason = _reason_against(busy, rules)
    if reason is None and len(busy) < 2:
        reason = "one edge alone has photographs"
    if reason is None and rules.within == "joined" and rules.between == "auto":
        reason = "within_edge is joined"
    if reason is not None:
        return GroupChoice(decision=_joined_by_rule(BETWEEN, "all edges", rules.between, joined_s, reason), seconds=joined_s)
    devices = _members(busy, rules)
    views = _views(devices, busy, rules)

    def group_at(factor: float) -> GroupPlan:
        edges = [replace(edge, uplink_bytes_per_s=edge.uplink_bytes_per_s * factor) for edge, _ in busy]
        cost = step_cost(edges, system.cloud, views, num_photographs, rules.law)
        start_s = start_cost(edges, system.cloud, _shares(views), num_photographs)
        return _group("cloud", edges, views, num_photographs, rules.law, cost, start_s)

    def difference_s(factor: float) -> float:
        # The links of edges send joined models once, which hardly counts beside every step.
        return group_at(factor).seconds - WORTH * joined_s

    cost = step_cost([edge for edge, _ in busy], system.cloud, views, num_photographs, rules.law)
    assumed = _assumed([*(edge for edge, _ in busy), system.cloud])
    case = _Case(topic=BETWEEN, about="all edges", wanted=rules.between, law=rules.law, assumed=assumed)
    return _chosen(case, group_at(1.0), cost, joined_s, _level_links(difference_s, min(edge.uplink_bytes_per_s for edge, _ in busy)))


@dataclass(frozen=True, kw_only=True)
class _Case:
    topic: str
    about: str
    wanted: TrainedAs
    law: TogetherLaw
    assumed: str
    """What was not measured, as the end of a reason."""


def _assumed(machines: Sequence[Edge | Cloud]) -> str:
    unknown = any(machine.latency_s is None for machine in machines)
    return f"; a latency of {1000 * LATENCY_S:g} ms is assumed, as none was measured" if unknown else ""


def _chosen(case: _Case, group: GroupPlan, cost: StepCost, joined_s: float, level_bytes_per_s: float | None) -> GroupChoice:
    by_links = case.law.view_s is not None
    is_short = cost.step_s < 2 * WORTH * cost.views_s if by_links else group.seconds < WORTH * joined_s
    looks = case.law.views_per_photograph
    worth_it = is_short and group.views_a_step <= MOST_VIEWS and looks >= LEAST_LOOKS
    together = case.wanted == "together" or (case.wanted == "auto" and worth_it)
    views_text = " + ".join(map(str, group.views.values())) if len(group.views) <= 8 else f"{group.views_a_step}"
    who = f"{case.about}: {len(group.views)} devices train together, {views_text} views a step"
    sent = f"a step sends {_megabytes(cost.up_bytes)} up and {_megabytes(cost.down_bytes)} down"
    figures: tuple[float, str] = group.seconds, f"s together, {joined_s:.1f} s joined"
    took = f"{sent}, {_ms(cost.exchange_s)} beside {_ms(cost.views_s)} of views"
    if by_links:
        figures = 1000 * cost.exchange_s, f"ms of exchange a step, {_ms(cost.views_s)} of views by an estimate"
        reason = f"{sent}; the machines' times are not known, and joining takes about as long as training: "
        reason += f"a step may last {2 * WORTH:g} times its views"
    elif level_bytes_per_s is None:
        reason = took
    else:
        links = "" if case.topic == WITHIN else " of the edges' links"
        at = f"at {figure_text(level_bytes_per_s * 8 / 1e6)} Mbit/s{links}"
        reason = f"{took}; {at} it would take {WORTH:g} times as long as joining, which its quality is worth"
    if group.views_a_step > MOST_VIEWS:
        reason += f"; with {group.views_a_step} views a step, more than {MOST_VIEWS}, joined models are the better ones"
    if looks < LEAST_LOOKS:
        reason += f"; with {looks:.1f} looks at each photograph, fewer than {LEAST_LOOKS}, joined models are the better ones"
    decision = Decision(
        stage=STAGE,
        topic=case.topic,
        choice=who if together else f"{case.about}: models are joined",
        figure=figures[0],
        unit=figures[1],
        reason=reason + case.assumed,
        forced=case.wanted != "auto",
    )
    return GroupChoice(decision=decision, group=group if together else None, seconds=group.seconds if together else joined_s)


def _joined_by_rule(topic: str, about: str, wanted: TrainedAs, joined_s: float, reason: str) -> Decision:
    return Decision(
        stage=STAGE,
        topic=topic,
        choice=f"{about}: models are joined",
        figure=joined_s,
        unit="s joined",
        reason=reason,
        forced=wanted == "joined",
        changes_nothing=wanted == "auto",
    )


def _reason_against(busy: Sequence[tuple[Edge, EdgePlan]], rules: GroupRules) -> str | None:
    """Why nothing else than joining comes into question, or None."""
    if rules.obstacle is not None:
        return rules.obstacle
    unknown = [edge.id for edge, _ in busy if not edge.devices]
    if unknown:
        return f"the devices of {unknown[0]} are not known here"
    members = _members(busy, rules)
    if len(members) < 2:
        return "one device trains, or none: there is nobody to exchange with"
    num_photographs = sum(len(plan.camera_indices) for _, plan in busy)
    small = [device.id for device in members if not rules.holds(device, num_photographs)]
    if small:
        return f"the memory of {small[0]} does not hold one model of all {num_photographs} photographs"
    if not all(_has_costs(device, rules.law, num_photographs) for device in members):
        return "the curves of its devices have no time of training or no size of a model, so that nothing can be predicted"
    return None


def _has_costs(device: Device, law: TogetherLaw, num_photographs: int) -> bool:
    return float(device.model_bytes(num_photographs)) > 0 and law.device_view_s(device, num_photographs) > 0


def _members(busy: Sequence[tuple[Edge, EdgePlan]], rules: GroupRules) -> list[Device]:
    """The devices that could train: where photographs move all that hold any, else those that have
    some."""

    def may(device: Device, plan: EdgePlan) -> bool:
        return device.max_cameras != 0 if rules.photographs_move else len(plan.cameras_of(device.id)) > 0

    return [device for edge, plan in busy for device in edge.devices if may(device, plan)]


def _views(devices: Sequence[Device], busy: Sequence[tuple[Edge, EdgePlan]], rules: GroupRules) -> dict[str, int]:
    """Views of each device that trains, by speed, or by the photographs that it keeps."""
    num_photographs = sum(len(plan.camera_indices) for _, plan in busy)
    if rules.photographs_move:
        weights = [1.0 / rules.law.device_view_s(device, num_photographs) for device in devices]
    else:
        plan_of = {name: plan for _, plan in busy for name in plan.device_ids}
        weights = [float(len(plan_of[device.id].cameras_of(device.id))) for device in devices]
    views = choose_views(weights, may_idle=rules.photographs_move)
    capacities = [inf if device.max_cameras is None else device.max_cameras for device, count in zip(devices, views, strict=True) if count]
    if sum(capacities) < num_photographs:
        views = choose_views(weights)
    return {device.id: count for device, count in zip(devices, views, strict=True) if count}


def _group(  # noqa: PLR0913
    level: GroupLevel, edges: Sequence[Edge], views: dict[str, int], num_photographs: int, law: TogetherLaw, cost: StepCost, start_s: float
) -> GroupPlan:
    return GroupPlan(
        level=level,
        edges=tuple(edge.id for edge in edges),
        views=views,
        num_photographs=num_photographs,
        num_steps=group_steps(law.views_per_photograph * num_photographs, sum(views.values())),
        step_s=cost.step_s,
        overlaps=cost.overlaps,
        start_s=start_s,
        end_s=end_cost(edges[0], num_photographs) if level == "edge" else 0.0,
    )


def _shares(views: dict[str, int]) -> dict[str, float]:
    total = sum(views.values())
    return {name: count / total for name, count in views.items()}


def _joined_s(edge: Edge, plan: EdgePlan) -> float:
    """T^m: until the edge's joined model is at the cloud."""
    return max((row.stop_s for row in planned_stages(System(edges=(edge,)), (plan,))), default=0.0)


def _refining_s(edge: Edge, plan: EdgePlan, rules: GroupRules) -> float:
    return predict_refining(System(edges=(edge,)), (plan,), rules.refining)


def _with_links(edge: Edge, factor: float) -> Edge:
    devices = (replace(device, uplink_bytes_per_s=device.uplink_bytes_per_s * factor) for device in edge.devices)
    return replace(edge, devices=tuple(devices))


def _level_links(difference_s: Callable[[float], float], slowest_bytes_per_s: float) -> float | None:
    """The slowest link's bytes per second if all links were so many times as fast that together
    takes `WORTH` times as long as joined; None where one way is chosen at any speed."""
    low, high = np.log(_SLOWEST), np.log(_FASTEST)
    if not difference_s(_SLOWEST) > 0 > difference_s(_FASTEST):
        return None
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if difference_s(float(np.exp(middle))) > 0 else (low, middle)
    return float(slowest_bytes_per_s * np.exp((low + high) / 2))


def _megabytes(count: float) -> str:
    return f"{figure_text(count / 1e6, 2)} MB"


def _ms(seconds: float) -> str:
    return f"{figure_text(1000 * seconds)} ms"
