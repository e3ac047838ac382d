"""A group of a recipe in one process: devices that train as one model, as plain calls.

The oracle of processes that train together (`train/together/fold.py` has its steps).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from radiant_core.errors import BadInput
from radiant_core.hierarchy.device import report_result
from radiant_core.hierarchy.groups import GroupTraining
from radiant_core.hierarchy.messages import device_task
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.hierarchy.reporter import Machine, Recorder, Reporter, fit_options
from radiant_core.hierarchy.together import GroupStart, ShareStart, begin_group, hold_share, prepare_share
from radiant_core.scene import SfmScene
from radiant_core.train.results import TrainResult
from radiant_core.train.together.fold import GroupCost, GroupMembers, fit_in_process
from radiant_core.train.together.masking import MaskKeys
from radiant_core.train.views import TrainingViews


@dataclass(frozen=True, kw_only=True, eq=False)
class GroupRun:
    """The training of a group."""

    plan: GroupTraining
    starts: Mapping[str, ShareStart]
    """By device."""
    start: GroupStart
    result: TrainResult
    cost: GroupCost
    """CPU seconds and bytes of its steps."""
    before_s: Mapping[str, float]
    """CPU seconds before the first step: of each device, and of the root for the start."""


def train_group(
    recipe: Recipe,
    plan: GroupTraining,
    scene: SfmScene,
    views: TrainingViews,
    reporter_of: Callable[[str], Reporter] = lambda stage: Recorder(stage=stage),
    machine: Machine = Machine(),
) -> GroupRun:
    """Train the model of a group from the planned cameras' scene and photographs.

    A device's reporter hears of its photographs, the root's of everything that follows. BadInput
    unless the group has all devices with photographs below its root.
    """
    _require_all(recipe, plan)
    prepared, before_s = {}, {}
    for device in plan.of_devices:
        begun_s, rows = time.process_time(), recipe.cameras_of(device)
        task = device_task(recipe.device_settings(device), scene.restricted_to(rows))
        prepared[device] = prepare_share(task, views.select(rows), reporter_of(f"devices/{device}"), machine)
        before_s[device] = time.process_time() - begun_s
    reporter, begun_s = reporter_of(plan.root), time.process_time()
    starts = {device: share.start for device, share in prepared.items()}
    start = begin_group(starts, plan, recipe.train, reporter)
    before_s[plan.root] = time.process_time() - begun_s
    holders, masks = {}, _masks(plan)
    for device, share in prepared.items():
        begun_s = time.process_time()
        holders[device] = hold_share(share, device, start, plan.seat_of(device), masks.get(device))
        before_s[device] += time.process_time() - begun_s
    members = GroupMembers(holders=holders, edges=plan.views, has_relays=plan.has_relays)
    options = fit_options(recipe.backend, reporter, machine, lambda: "")
    result, cost = fit_in_process(start.initial, start.group, members, start.camera_centers, options, time.process_time)
    for warning in cost.warnings:
        reporter.warn(warning)
    report_result(start.group.config, start.initial, result, reporter)
    return GroupRun(plan=plan, starts=starts, start=start, result=result, cost=cost, before_s=before_s)


def _masks(plan: GroupTraining) -> dict[str, MaskKeys]:
    """Keys by device, as devices make them that meet at an edge; none where nothing is masked."""
    masks = dict[str, MaskKeys]()
    for edge, devices in plan.views.items() if plan.masked else ():
        privates = {device: X25519PrivateKey.generate() for device in devices}
        publics = {device: private.public_key().public_bytes_raw() for device, private in privates.items()}
        masks |= {device: MaskKeys.agree(device, private, publics, f"edges/{edge}") for device, private in privates.items()}
    return masks


def _require_all(recipe: Recipe, plan: GroupTraining) -> None:
    edges = [edge for edge in recipe.edge_plans if plan.has_relays or plan.root == f"edges/{edge.edge_id}"]
    dealt = {device for edge in edges for device in edge.device_ids if len(edge.cameras_of(device))}
    if dealt != set(plan.of_devices):
        raise BadInput(
            f"the group of {plan.root} has {', '.join(plan.of_devices)}, expected all that have photographs: {', '.join(sorted(dealt))}."
        )
