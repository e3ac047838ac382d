"""How long the phases of a run are foreseen to take, before its photographs are placed and by its
plan. Twice per run.

Machines with cost curves of their own take what these say. Else all runs on this one, and seconds
are CPU seconds of one core, those of views and nodes over the number of cores:

    placing    LOAD, and what `sfm.time_left` says of photographs of these sizes
    training   LOAD, and the views of all devices · VIEW
    joining    START a node, and its epochs of all photographs · VIEW
    refining   START a node and round, and its epochs of all photographs · VIEW · 1.4
    scoring    START, and held-out photographs · SCORED
    report     REPORT

with VIEW and SCORED in proportion to the pixels of a photograph. Only the shares count: the run's
pace makes seconds of them (`whole_run.py`). `python -m tests.stress.time_left_of_runs RUN …` holds
what was foreseen beside what runs took.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from radiant_app.config.run_config import RunConfig
from radiant_app.events import Foreseen
from radiant_app.run.grouping import VIEW_PX, costs_are_nobodys
from radiant_app.run.predictions import KNOWN_POSES_SHARE, planned_training, refining_law_of
from radiant_app.run.source import Plan
from radiant_app.run.whole_run import UNIT_HERE, UNIT_PLANNED
from radiant_app.workers.sources import locate_source
from radiant_core.errors import RadiantError
from radiant_core.hierarchy.recipe import Recipe, trainings_of
from radiant_core.hierarchy.refining_plan import refining_steps
from radiant_core.io.photos.facts import HEAD_BYTES, file_facts
from radiant_core.io.photos.folders import photograph_names
from radiant_core.io.run_store import open_without_waiting
from radiant_core.plan.system import System
from radiant_core.plan.timeline.prediction import planned_stages
from radiant_core.plan.timeline.refining import STEP, predict_refining
from radiant_core.plan.together.groups import GroupPlan
from radiant_core.sfm.config import SfmConfig
from radiant_core.sfm.time_left import predict_phases
from radiant_core.train.config import TrainConfig
from radiant_core.train.needs import step_law_of

VIEW_CPU_S = 0.0063
"""Of a view at `VIEW_PX`: half of `grouping.VIEW_S`, which four devices had on two cores."""
LOAD_CPU_S, START_CPU_S = 3.0, 0.5
"""Of a process that loads its libraries, and of one that is forked from such."""
SCORED_CPU_S, REPORT_CPU_S = 0.35, 6.0
"""Of a held-out photograph at `VIEW_PX` with all of its figures, and of the report's pictures."""
HELD_OUT = 8
"""Every so many-th photograph is held out."""


@dataclass(frozen=True, kw_only=True)
class _Work:
    """What of a run its times depend on."""

    num_photographs: int
    """For training, held-out ones not counted."""
    num_held_out: int
    train: TrainConfig
    counts: Sequence[int]
    """Training photographs of each device."""
    num_edges: int
    joins: bool
    """Whether devices' models are joined and refined."""


def slowdown() -> float:
    """How many times as long as alone a process takes here now, by what else waits for a core."""
    try:
        waiting = os.getloadavg()[0]
    except OSError:
        return 1.0
    return max(1.0, (waiting + 1) / (os.cpu_count() or 1))


def foresee(config: RunConfig, system: System) -> Foreseen | None:
    """What a run will take whose photographs lie in one folder and are not placed yet; None where
    nobody has counted them."""
    sizes = _sizes_of(config)
    if not sizes:
        return None
    held_out = math.ceil(len(sizes) / HELD_OUT)
    num_trained, num_devices = max(1, len(sizes) - held_out), max(1, len(system.devices))
    work = _Work(
        num_photographs=num_trained,
        num_held_out=held_out,
        train=planned_training(config.train.preset, config.train.overrides),
        counts=[math.ceil(num_trained / num_devices)] * num_devices,
        num_edges=len(system.edges),
        joins=num_devices > 1,
    )
    return Foreseen(phases_s=(_placing_s(config, sizes), *_work_s(config, work)), units=(UNIT_HERE,) * 6)


def foresee_planned(config: RunConfig, plan: Plan, recipe: Recipe, num_workers: int) -> Foreseen:
    """What a run by this plan will take, `num_workers` processes at a time; photographs are placed
    before."""
    edge_plans = plan.edges
    counts = [len(edge_plan.cameras_of(device)) for edge_plan in edge_plans for device in edge_plan.device_ids]
    num_photographs = sum(counts)
    work = _Work(
        num_photographs=max(1, num_photographs),
        num_held_out=math.ceil(num_photographs / (HELD_OUT - 1)),
        train=recipe.train,
        counts=[count for count in counts if count],
        num_edges=sum(len(edge_plan.camera_indices) > 0 for edge_plan in edge_plans),
        joins=sum(count > 0 for count in counts) > 1 and "cloud" not in recipe.groups,
    )
    here = _work_s(config, work)
    placing_s = _placing_s(config, _sizes_of(config))
    if costs_are_nobodys(recipe.system):
        return Foreseen(phases_s=(placing_s, *here), units=(UNIT_HERE,) * 6)
    planned = _planned_s(config, plan, recipe, num_workers)
    return Foreseen(phases_s=(placing_s, *planned, *here[3:]), units=(UNIT_HERE, *(UNIT_PLANNED,) * 3, UNIT_HERE, UNIT_HERE))


def _planned_s(config: RunConfig, plan: Plan, recipe: Recipe, num_workers: int) -> tuple[float, float, float]:
    """Training, joining and refining of machines whose costs are known, `num_workers` at a time."""
    system, edge_plans = recipe.system, plan.edges
    stages = planned_stages(system, edge_plans)
    if (group := next((row for row in plan.groups if row.level == "cloud"), None)) is not None:
        return group.start_s + group.num_steps * group.step_s, group.end_s, 0.0
    counted = [row for row in stages if config.emulated or row.stage != "send"]
    seconds: dict[str, float] = {}
    for row in counted:
        seconds[row.node] = seconds.get(row.node, 0.0) + row.seconds
    devices = [value for node, value in seconds.items() if node.startswith("devices/")]
    edges = [value for node, value in seconds.items() if node.startswith("edges/")]
    joining_s = _side_by_side(edges, num_workers) + seconds.get("cloud", 0.0)
    fixed = config.train.step_policy == "fixed"
    num_photographs = sum(len(edge_plan.camera_indices) for edge_plan in edge_plans)
    num_devices = recipe.num_devices or len(system.devices)
    law = refining_law_of(recipe.train, recipe.aggregate, num_photographs, num_devices, fixed=fixed)
    refining_s = predict_refining(system, edge_plans, law, with_sending=config.emulated)
    return _side_by_side(devices, num_workers), joining_s, refining_s * max(1.0, len(devices) / num_workers)


def planned_makespan_s(recipe: Recipe, groups: Sequence[GroupPlan]) -> float:
    """When the last model is at the cloud, or the model of all is trained there, as predicted: of
    machines that train together by their steps."""
    plan, together = recipe.cloud_plan, {edge for group in groups for edge in group.edges}
    joined_s = [float(seconds) for edge, seconds in zip(plan.edge_ids, plan.edge_time_s, strict=True) if edge not in together]
    return max([*joined_s, *(group.seconds for group in groups)])


def _side_by_side(seconds: Sequence[float], num_workers: int) -> float:
    return max([*seconds, sum(seconds) / max(1, num_workers)], default=0.0)


def _work_s(config: RunConfig, work: _Work) -> tuple[float, float, float, float, float]:
    """Training, joining, refining, scoring and the report, here."""
    num_cores, train = os.cpu_count() or 1, work.train
    scale = (train.long_side_px / VIEW_PX) ** 2
    view_s = VIEW_CPU_S * scale
    fixed = config.train.step_policy == "fixed"
    law = step_law_of(train, work.num_photographs, len(work.counts))
    views = sum(train.num_steps if fixed else law.steps(count) for count in work.counts)
    training_s, joining_s, refining_s = LOAD_CPU_S + views * view_s / num_cores, START_CPU_S, 0.0
    if work.joins:
        trainings = trainings_of(train, work.num_photographs, len(work.counts))
        aggregate = config.joining
        at_edge, at_cloud = aggregate.epochs_after(trainings)
        epochs = at_edge + (at_cloud if work.num_edges > 1 else 0)
        joining_s = START_CPU_S * (work.num_edges + 1) + epochs * work.num_photographs * view_s
        if aggregate.refine.is_asked_for:
            steps = sum(refining_steps(aggregate.refine.epochs_after(trainings), count) for count in work.counts)
            nodes = len(work.counts) + work.num_edges + 1
            refining_s = aggregate.refine.rounds_after(trainings) * (START_CPU_S * nodes + STEP * steps * view_s)
    scoring_s = START_CPU_S + SCORED_CPU_S * scale * work.num_held_out
    return training_s, joining_s / num_cores, refining_s / num_cores, scoring_s, REPORT_CPU_S


def _placing_s(config: RunConfig, sizes: Sequence[tuple[int, int]]) -> float:
    """Structure from motion of one owner; devices that place their own do it as they train."""
    if config.frames != "shared" or not sizes:
        return 0.0
    has_poses = locate_source(config.source, config.sfm.poses)[0] in ("colmap", "alignment", "mill19")
    sfm = SfmConfig(matching=config.sfm.matching, effort=config.sfm.effort)
    return LOAD_CPU_S + sum(predict_phases(sizes, sfm).values()) * (KNOWN_POSES_SHARE if has_poses else 1.0)


def _sizes_of(config: RunConfig) -> list[tuple[int, int]]:
    """Width and height of the photographs in a source's folder, all as large as its first; none of
    a film, of devices that alone may open theirs, or where they cannot be read: the run itself says
    why."""
    if config.frames != "shared":
        return []
    try:
        kind, folder, _ = locate_source(config.source, config.sfm.poses)
        if kind == "film" or not folder.is_dir():
            return []
        names = photograph_names(folder)
        size_wh = _size_of(folder / names[0]) if names else None
    except (RadiantError, OSError):
        return []
    return [] if size_wh is None else [size_wh] * len(names)


def _size_of(path: Path) -> tuple[int, int] | None:
    with open(path, "rb", opener=open_without_waiting) as file:
        return file_facts(file.read(HEAD_BYTES))[0]
