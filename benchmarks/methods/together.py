"""Devices that train as one model, as arms of `radiant bench methods`; and how they scale.

together            all devices of all edges train the scene, in the sums of the cloud
together overlapped the same, a device renders while the sum of the step before is on its way
together per edge   each edge's devices train its model; the cloud joins, devices refine
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

from benchmarks.methods.arms import Arm, ArmModel
from benchmarks.methods.cells import Cell
from benchmarks.methods.comparing import comparisons
from benchmarks.methods.emulated_latency import NodeClock, NodeWork
from benchmarks.methods.group_latency import work_of
from benchmarks.training_pixels import training_pixels
from radiant_core.aggregate.tree import refines_for
from radiant_core.errors import StageFailed
from radiant_core.hierarchy.codec import refinement_bytes, sent_bytes
from radiant_core.hierarchy.group_in_process import GroupRun
from radiant_core.hierarchy.group_models import cameras_of_starts
from radiant_core.hierarchy.groups import GroupTraining
from radiant_core.hierarchy.in_process import run_in_process
from radiant_core.hierarchy.recipe import Recipe

MOST_VIEWS_PER_DEVICE = 2
"""Of a step, in the mean: more views make fewer steps."""
ENOUGH = 1.1
"""A step may take this many times what it would if views could be split."""


def views_of_speeds(speeds: Sequence[float]) -> list[int]:
    """Views that devices of such speeds give to a step, so that they end it together.

    The fewest with which max_k views_k / speed_k ≤ 1.1 Σ views / Σ speeds, each one at least and
    two in the mean at most; else those that come nearest. Speeds 1 and 0.6: 2 and 1.
    """
    views = [1] * len(speeds)
    best: tuple[float, list[int]] | None = None
    while sum(views) <= MOST_VIEWS_PER_DEVICE * len(speeds):
        ideal = sum(views) / sum(speeds)
        ratio = max(count / speed for count, speed in zip(views, speeds, strict=True)) / ideal
        if ratio <= ENOUGH:
            return views
        best = (ratio, list(views)) if best is None or ratio < best[0] else best
        views[min(range(len(views)), key=lambda k: (views[k] + 1) / speeds[k])] += 1
    assert best is not None
    return best[1]


def grouped(recipe: Recipe, at: Literal["cloud", "edges"], *, overlaps: bool = False) -> Recipe:
    """The recipe whose devices train as one model below the cloud, or below each edge."""
    speed = {device.id: device.speed or 1.0 for device in recipe.system.devices}
    dealt = {plan.edge_id: [device for device in plan.device_ids if len(plan.cameras_of(device))] for plan in recipe.edge_plans}
    dealt = {edge: devices for edge, devices in dealt.items() if devices}
    roots = {"cloud": dealt} if at == "cloud" else {f"edges/{edge}": {edge: devices} for edge, devices in dealt.items()}
    groups = {}
    for root, edges in roots.items():
        devices = [device for names in edges.values() for device in names]
        views = dict(zip(devices, views_of_speeds([speed[device] for device in devices]), strict=True))
        groups[root] = GroupTraining(
            root=root,
            views={edge: {device: views[device] for device in names} for edge, names in edges.items()},
            num_steps=sum(recipe.training_of(device).num_steps for device in devices),
            overlaps=overlaps,
        )
    return replace(recipe, groups=groups)


def make_together(cell: Cell, recipe: Recipe) -> ArmModel:
    """The scene of a run by a recipe with groups of all its devices."""
    scene, clock, begun_s = cell.scene, NodeClock(), time.process_time()
    run = run_in_process(recipe, scene.training, scene.views, clock.reporter_of)
    cpu_s, seconds = time.process_time() - begun_s, clock.seconds()
    if run.scene.splats is None:
        raise StageFailed(f"{cell.name}: every model was refused: {'; '.join(run.scene.refused.values())}")
    # An edge's own work is that of its group, whose time depends on links.
    nodes = [
        NodeWork(stage=root, cpu_s=0.0, sent_bytes=sent_bytes(run.edges[root.removeprefix("edges/")], recipe.upload))
        for root in run.groups
        if root != "cloud"
    ]
    nodes += [
        NodeWork(stage=stage, cpu_s=seconds[stage], sent_bytes=refinement_bytes(refinement, run.scene.splats, recipe.upload))
        for stage, refinement in run.refinements.items()
    ]
    if nodes:
        nodes += comparisons(cell, recipe, run)
        nodes += [NodeWork(stage=stage, cpu_s=spent_s) for stage, spent_s in seconds.items() if refines_for(stage) == "cloud"]
    return ArmModel(
        splats=run.scene.splats,
        cpu_s=cpu_s,
        training_px=float(sum(_training_px(group) for group in run.groups.values())),
        nodes=tuple(nodes),
        groups={root: work_of(group) for root, group in run.groups.items()},
    )


def _training_px(run: GroupRun) -> int:
    """As of one machine that shows as many views of all photographs."""
    config = run.start.group.config
    return training_pixels(cameras_of_starts(run.starts), config, config.num_steps)


TOGETHER: Sequence[Arm] = (
    Arm(name="together", make=make_together, recipe=lambda cell: grouped(cell.recipe, "cloud")),
    Arm(name="together overlapped", make=make_together, recipe=lambda cell: grouped(cell.recipe, "cloud", overlaps=True)),
    Arm(name="together per edge", make=make_together, recipe=lambda cell: grouped(cell.recipe, "edges")),
)
