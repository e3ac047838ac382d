"""What an edge does: join its devices' models (paper Sec. III-D). Once per edge.

    admit ─→ retrain  on what each model shows at its own cameras; by tiles where all of them at
          │           once exceed the edge's memory
          └→ cut      at the borders of the strips, where not even a tile fits; a warning says so

A device's model meets its neighbour's here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from radiant_core.aggregate.join import Joined, cut_at_borders, join_models
from radiant_core.aggregate.join_memory import plan_join_memory
from radiant_core.aggregate.synthetic_views import Teacher
from radiant_core.aggregate.virtual_cameras import virtual_cameras
from radiant_core.cameras import NO_CAMERAS, Cameras, concatenate_cameras
from radiant_core.hierarchy.decisions import join_decisions
from radiant_core.hierarchy.device import training_summary
from radiant_core.hierarchy.join_limits import CUT_AT_EDGE_COSTS, JoinLimit, limit_of_machine, report_join_memory, ways_to_lift
from radiant_core.hierarchy.joining import admit, join_key, received_files
from radiant_core.hierarchy.messages import DeviceModel, EdgeModel, EdgeTask
from radiant_core.hierarchy.reporter import Machine, Reporter, fit_options
from radiant_core.io.run_store import key_of_files
from radiant_core.plan.regions.claims import claims_of_polygons
from radiant_core.splats import Splats, morton_order
from radiant_core.train.trainer import FitOptions


def join_edge(task: EdgeTask, models: Mapping[str, DeviceModel | str], reporter: Reporter, machine: Machine = Machine()) -> EdgeModel:
    """Join the models of an edge's devices.

    Args:
        task: regions and settings.
        models: by device, in the order of the task; text where the transport refuses one, with the
            reason.
        reporter: hears decisions, warnings and progress.
        machine: checkpoints of the retraining, and a folder for its pictures.

    Returns:
        The model, or one without Gaussians where every device was refused.
    """
    arrivals = admit(models, task.num_dealt, reporter, task.backend)
    if not arrivals.models:
        return EdgeModel(splats=None, corrections=arrivals.corrections, refused=arrivals.refused)
    teachers = [Teacher(splats=model, cameras=cameras) for model, cameras in zip(arrivals.models, arrivals.cameras, strict=True)]
    strips = [np.array(task.strips[task.devices.index(name)]).reshape(-1, 2) for name in arrivals.senders]
    options = fit_options(task.backend, reporter, machine, lambda: join_key(task, models))
    lift = partial(ways_to_lift, can_join_again=arrivals.uncertainty is None)
    joined, fits = _join(task, teachers, strips, options, _limit(task, machine, lift), reporter)
    # Along a Z curve the order of the Gaussians no longer says how many devices there were and
    # which is whose.
    splats = joined.trained.splats.select(morton_order(joined.trained.splats.means))
    cameras = NO_CAMERAS
    if task.draws_cameras or arrivals.uncertainty is not None:
        cameras = virtual_cameras_of(models, arrivals.cameras, splats)
    return EdgeModel(
        splats=splats,
        cameras=cameras,
        uncertainty=arrivals.uncertainty,
        corrections=arrivals.corrections,
        refused=arrivals.refused,
        cut_for_memory=task.memory_bytes is None and not fits,
        summary={**training_summary(joined.trained), "num_models": len(arrivals.models)},
    )


def _limit(task: EdgeTask, machine: Machine, lift: Callable[[str], str]) -> JoinLimit:
    """What the join may hold: what the system file says, else a share of what is free."""
    if task.memory_bytes is None:
        limit = limit_of_machine(machine, machine.num_edges)
        return replace(limit, lift=lift(f"{limit.lift} (--resume tries a cut again), or give this edge memory_gb"))
    label = "memory_gb of this edge"
    return JoinLimit(num_bytes=task.memory_bytes, label=label, lift=lift(f"raise {label} for the next run"))


def _join(
    task: EdgeTask, teachers: list[Teacher], strips: Sequence[Any], options: FitOptions, limit: JoinLimit, reporter: Reporter
) -> tuple[Joined, bool]:
    """The models retrained together, or cut where the edge's memory holds no part of that; whether
    it does."""
    claims, num_tiles = claims_of_polygons(strips), 1
    if len(teachers) > 1:
        models, cameras = [teacher.splats for teacher in teachers], [teacher.cameras for teacher in teachers]
        memory = plan_join_memory(models, cameras, task.train.long_side_px, limit.num_bytes, task.join.most_tiles)
        report_join_memory(memory, limit, CUT_AT_EDGE_COSTS, reporter)
        if not memory.fits:
            return cut_at_borders(teachers, claims), False
        num_tiles, options = memory.num_tiles, replace(options, statistics_bytes=memory.statistics_bytes)
    joined = join_models(teachers, task.train, task.join, options, claims, num_tiles)
    for decision in join_decisions(reporter.stage, task.join, len(teachers), joined):
        reporter.decide(decision)
    return joined, True


def virtual_cameras_of(models: Mapping[str, DeviceModel | str], cameras: Sequence[Cameras], splats: Splats) -> Cameras:
    """Virtual cameras (C) of an edge, near its devices' `cameras` (C).

    They are drawn by a seed made of what the edge received: the same run gives the same cameras,
    and the cloud cannot undo the draw.
    """
    rng = np.random.default_rng(int(key_of_files(received_files(models))[:32], 16))
    return virtual_cameras(concatenate_cameras(cameras), splats.means, rng)
