"""A group of a recipe in one process: devices that train as one model, as plain calls.

The oracle of processes that train together (`train/together/fold.py` has its steps).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from radiant_core.cameras import Cameras
from radiant_core.hierarchy.groups import GroupPlan
from radiant_core.hierarchy.messages import device_task
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.hierarchy.reporter import Machine, Recorder, Reporter, fit_options
from radiant_core.hierarchy.together import begin_group, hold_share, prepare_share
from radiant_core.scene import SfmScene
from radiant_core.train.results import TrainResult
from radiant_core.train.together.fold import GroupCost, GroupMembers, fit_in_process
from radiant_core.train.views import TrainingViews


@dataclass(frozen=True, kw_only=True, eq=False)
class GroupRun:
    """The model of a group, the cameras (C) that it was trained on, and what its steps took."""

    result: TrainResult
    cameras: Cameras
    cost: GroupCost


def train_group(
    recipe: Recipe,
    plan: GroupPlan,
    scene: SfmScene,
    views: TrainingViews,
    reporter_of: Callable[[str], Reporter] = lambda stage: Recorder(stage=stage),
    machine: Machine = Machine(),
) -> GroupRun:
    """Train the model of a group from the planned cameras' scene and photographs."""
    prepared = {}
    for device in plan.of_devices:
        rows = recipe.cameras_of(device)
        task = device_task(recipe.device_settings(device), scene.restricted_to(rows))
        prepared[device] = prepare_share(task, views.select(rows), reporter_of(f"devices/{device}"), machine)
    reporter = reporter_of(plan.root)
    start = begin_group({device: each.start for device, each in prepared.items()}, plan, recipe.train, reporter)
    members = GroupMembers(
        holders={device: hold_share(each, device, start, plan.seat_of(device)) for device, each in prepared.items()},
        edges=plan.views,
        has_relays=plan.has_relays,
    )
    options = fit_options(recipe.backend, reporter, machine, lambda: "")
    result, cost = fit_in_process(start.initial, start.group, members, start.camera_centers, options, time.perf_counter)
    cameras = scene.cameras.select([row for device in plan.of_devices for row in recipe.cameras_of(device)])
    return GroupRun(result=result, cameras=cameras, cost=cost)
