"""Which devices refine a joined scene, by whose edges, and by how many steps. Once per run.

Those whose models are in the scene, below edges whose memory holds its average; none where the
settings ask for none, the cloud's memory does not hold it, or fewer than two are left: one device
alone has fitted its model to all of its photographs before, as have devices that trained one model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from radiant_core.aggregate.averaging import average_bytes
from radiant_core.aggregate.config import Refine
from radiant_core.decisions import Decision
from radiant_core.hierarchy.join_limits import UNREFINED_COSTS
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.plan.timeline.refining import LEAST_DEVICES

MAX_STEPS = 200
"""Devices that take many steps between two means drift apart (docs/experiments/aggregation.md): no
more than were measured to gain, but each photograph once."""
STAGE = "refining"
"""No node's name: notes of a node are dropped when it starts."""


@dataclass(frozen=True, kw_only=True)
class RefiningPlan:
    """Who refines, and why others with a model in the scene do not."""

    devices: Mapping[str, Sequence[str]]
    """Edge → its devices that refine; empty where the scene stays as it was joined."""
    decisions: tuple[Decision, ...] = ()
    warnings: tuple[str, ...] = ()
    """Of decisions that a limit of memory forced: what it costs, and how to lift it."""


def plan_refining(recipe: Recipe, present: Mapping[str, Sequence[str]], num_splats: int) -> RefiningPlan:
    """Plan the refining of a scene.

    Args:
        recipe: settings, and the limits of memory of its system.
        present: edge → its devices whose models are in the scene.
        num_splats: Gaussians of the scene.

    Returns:
        The devices by edge, and a decision wherever the settings ask for more.
    """
    if not recipe.aggregate.refine.is_asked_for:
        return RefiningPlan(devices={})
    num_present = sum(map(len, present.values()))
    if num_present < LEAST_DEVICES:
        return RefiningPlan(devices={}, decisions=(_too_few(num_present),))
    if any(devices_of(present) <= set(group.of_devices) for group in recipe.groups.values()):
        return RefiningPlan(devices={}, decisions=(_ALL_TOGETHER,))
    degree = recipe.train.sh_degree
    needed, of_edge = (average_bytes(num_splats, degree, renders=renders) for renders in (False, True))
    cloud, limits = recipe.system.cloud, {edge.id: edge.memory_bytes for edge in recipe.system.edges}
    if cloud.memory_bytes is not None and cloud.memory_bytes < needed:
        decision = _too_large("the scene is not refined", needed, "the cloud", cloud.memory_bytes)
        return RefiningPlan(devices={}, decisions=(decision,), warnings=(warning_of(decision),))
    devices_by_edge, decisions = {}, []
    for edge, devices in present.items():
        limit = limits.get(edge)
        if devices and limit is not None and limit < of_edge:
            decisions.append(_too_large(f"the scene is not refined by {', '.join(devices)}", of_edge, edge, limit))
        elif devices:
            devices_by_edge[edge] = tuple(devices)
    warnings = tuple(map(warning_of, decisions))
    if (num_left := sum(map(len, devices_by_edge.values()))) < LEAST_DEVICES:
        return RefiningPlan(devices={}, decisions=(*decisions, _too_few(num_left)), warnings=warnings)
    return RefiningPlan(devices=devices_by_edge, decisions=(*decisions, _rounds(recipe)), warnings=warnings)


def choose_rounds(recipe: Recipe) -> int:
    """In how many rounds devices refine a scene."""
    return recipe.aggregate.refine.rounds_after(recipe.trainings)


def refining_steps(epochs: int, num_views: int) -> int:
    """Steps of a device with so many photographs: their epochs within `MAX_STEPS`, at least one."""
    return max(num_views, min(epochs * num_views, MAX_STEPS))


def warning_of(decision: Decision) -> str:
    """What a decision that a limit of memory forced costs, and how to lift the limit."""
    message = f"{decision.choice}: {decision.figure:.2f} {decision.unit}, {decision.reason}."
    return f"{message} {UNREFINED_COSTS} Raise that memory_gb in the system file of the next run."


def _rounds(recipe: Recipe) -> Decision:
    number, trainings = choose_rounds(recipe), recipe.trainings
    case = trainings.refining
    usual = case.values["rounds"]
    by_steps = "steps" in case.limits
    epochs, settings = recipe.refining_epochs, recipe.aggregate.refine
    return Decision(
        stage=STAGE,
        topic="rounds of refining",
        choice=f"devices refine the scene in {_counted(number, 'round')} of at most {_counted(epochs, 'epoch')}",
        figure=trainings.num_steps if by_steps else trainings.photograph_shows,
        unit="steps of a training" if by_steps else "times a training shows each photograph",
        reason=case.reason if number == usual else f"asked for; the default after such trainings is {usual}",
        row=case.row,
        forced=settings != Refine(),
    )


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' * (number != 1)}"


def _too_large(choice: str, needed_bytes: float, where: str, limit_bytes: float) -> Decision:
    return Decision(
        stage=STAGE,
        topic="refinement",
        choice=choice,
        figure=needed_bytes / 1e9,
        unit="GB needed to average what devices refine",
        reason=f"memory_gb of {where} allows {limit_bytes / 1e9:.2f}",
    )


def devices_of(edges: Mapping[str, Sequence[str]]) -> set[str]:
    """The devices of all edges."""
    return {device for devices in edges.values() for device in devices}


_ALL_TOGETHER = Decision(
    stage=STAGE,
    topic="refinement",
    choice="no device refines the scene",
    figure=1.0,
    unit="model of all devices",
    reason="devices that train one model have already fitted it to all their photographs",
    changes_nothing=True,
)


def _too_few(num_devices: int) -> Decision:
    return Decision(
        stage=STAGE,
        topic="refinement",
        choice="no device refines the scene",
        figure=float(num_devices),
        unit="devices could refine it",
        reason=f"a single device has already fitted its model to its photographs: refining needs {LEAST_DEVICES} devices",
    )
