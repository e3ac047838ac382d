"""Which machines of a run train together: what `plan.together` asks for, of a run's settings.

    plan (regions, strips) ─→ `choose_run_groups` ─→ groups

Once per plan, which stays as it is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from radiant_app.config.run_config import RunConfig
from radiant_app.events import Decided, Listener, Warned
from radiant_app.files.system_file import even_system
from radiant_app.run.predictions import planned_training, refining_law_of
from radiant_app.together.places import LATE_S
from radiant_core.io.transport.upload import BYTES_FACTORS
from radiant_core.plan.plans import EdgePlan
from radiant_core.plan.system import Device, System
from radiant_core.plan.together.choosing import GroupRules, choose_groups
from radiant_core.plan.together.costs import TogetherLaw
from radiant_core.plan.together.groups import GroupPlan
from radiant_core.splats import SH_BASES
from radiant_core.train.config import TrainConfig
from radiant_core.train.needs import step_law_of

VIEW_S, VIEW_PX = 0.0126, 384
"""Seconds of a view at a long side of so many pixels, where no machine's times are known: of four
devices that trained on the town side by side on two cores, 500 steps in 6.3 s."""


def choose_run_groups(
    config: RunConfig, system: System, edge_plans: Sequence[EdgePlan], listen: Listener, *, photographs_move: bool = True
) -> tuple[GroupPlan, ...]:
    """The groups of a run with this plan, of a system at `costs_of_run`; emits the decisions, and a
    warning where a step takes longer than machines wait for each other. None where models are
    joined.

    `photographs_move`: whether the plan deals photographs, or each device keeps its own.
    """
    num_photographs = sum(len(plan.camera_indices) for plan in edge_plans)
    if not num_photographs or not system.devices:
        return ()
    train = planned_training(config.train.preset, config.train.overrides)
    rules = group_rules(config, system, train, num_photographs, photographs_move=photographs_move)
    groups, decisions = choose_groups(system, edge_plans, rules)
    for decision in decisions:
        listen(Decided(decision=decision))
    for group in groups:
        if group.step_s > LATE_S:
            names = ", ".join(group.views)
            late = f"a step of {names} together takes {group.step_s:,.0f} s as predicted, and who says nothing for {LATE_S:g} s is left out"
            listen(Warned(stage="plan", message=f"{late}: use --within-edge joined, or faster links or machines."))
    return groups


def group_rules(
    config: RunConfig, system: System, train: TrainConfig, num_photographs: int, *, photographs_move: bool = True
) -> GroupRules:
    """What the choice goes by in a run of so many training photographs, 1 or more."""
    num_devices = len(system.devices)
    is_fixed = config.train.step_policy == "fixed"
    steps = step_law_of(train, num_photographs, num_devices)
    of_fixed = train.num_steps * num_devices / num_photographs
    num_floats = 11 + 3 * SH_BASES[train.sh_degree]
    law = TogetherLaw(
        views_per_photograph=of_fixed if is_fixed else steps.per_photograph,
        steps_of=(lambda count: float(train.num_steps)) if is_fixed else (lambda count: steps.per_photograph * count),
        num_floats=num_floats,
        splat_bytes=4 * num_floats * BYTES_FACTORS[config.upload],
        max_num_splats=train.max_num_splats,
        masked=config.plan.mask_gradients,
        view_s=VIEW_S * (train.long_side_px / VIEW_PX) ** 2 if costs_are_nobodys(system) else None,
    )
    return GroupRules(
        law=law,
        refining=refining_law_of(train, config.joining, num_photographs, num_devices, fixed=is_fixed),
        within=config.plan.within_edge,
        between=config.plan.between_edges,
        obstacle=obstacle_of(config),
        holds=_holds(train, law),
        photographs_move=photographs_move,
    )


def obstacle_of(config: RunConfig) -> str | None:
    """Why no machines of such a run can train together, or None."""
    if config.execution.executor == "network":
        return "machines of several owners exchange models, not every step"
    if config.frames == "gps":
        return "frames by GPS are not exact, so that devices do not see the same Gaussians"
    if config.aggregate.preset == "paper":
        return "the paper joins models"
    return None


def _holds(train: TrainConfig, law: TogetherLaw) -> Callable[[Device, int], bool]:
    def holds(device: Device, num_photographs: int) -> bool:
        from radiant_core.train.memory import most_cameras

        if device.memory_bytes is None:
            return True
        num_splats = law.num_splats([device], num_photographs)
        return most_cameras(train, device.memory_bytes, lambda count: num_splats, num_photographs) > 0

    return holds


def costs_are_nobodys(system: System) -> bool:
    """Whether all devices have a system file's default costs, which are no machine's."""
    default = even_system(1, 1).devices[0]
    return all(device.origin is None and (device.init_s, device.train_s) == (default.init_s, default.train_s) for device in system.devices)
