"""What an edge does: join its devices' models, or pool them for a cloud that joins everything
(paper Sec. III-D). Once per edge.

    admit ─→ pool     where the cloud will retrain: the models as one, with pictures of each at
          │           virtual cameras
          ├→ retrain  on what each model shows at its own cameras
          └→ cut      at the borders of the strips, where the edge's memory forbids retraining; a
                      warning says so

A device's model meets its neighbour's here; where the edge pools, the two are retrained together in
`join_cloud`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiant_core.aggregate.balance import balance_teachers, exposure_balance
from radiant_core.aggregate.cloud_choice import choose_at_cloud, cloud_needs, kept_statistics_bytes, pooled_needs
from radiant_core.aggregate.ownership import claims_of_polygons
from radiant_core.aggregate.pooling import pool_teachers, render_pictures
from radiant_core.aggregate.retrain import Joined, cut_at_borders, retrain_on_synthetic_views
from radiant_core.aggregate.synthetic_views import Teacher
from radiant_core.aggregate.virtual_cameras import virtual_cameras
from radiant_core.cameras import Cameras, concatenate_cameras
from radiant_core.decisions import Decision
from radiant_core.hierarchy.decisions import exposures_decision, faint_decision, join_decisions, join_memory_decision, teachers_decision
from radiant_core.hierarchy.device import training_summary
from radiant_core.hierarchy.joining import CUT_COSTS, JOIN_AGAIN, Arrivals, admit, join_key, received_files
from radiant_core.hierarchy.messages import NO_CAMERAS, DeviceModel, EdgeModel, EdgeTask
from radiant_core.hierarchy.reporter import Machine, Reporter, fit_options
from radiant_core.io.run_store import key_of_files
from radiant_core.splats import Splats, morton_order
from radiant_core.train.native_loss import STATISTICS_BUDGET_BYTES


def join_edge(task: EdgeTask, models: Mapping[str, DeviceModel | str], reporter: Reporter, machine: Machine = Machine()) -> EdgeModel:
    """Join the models of an edge's devices.

    Args:
        task: regions and settings.
        models: by device, in the order of the task; text where the transport refuses one, with the
            reason.
        reporter: hears decisions, warnings and progress.
        machine: checkpoints of the retraining.

    Returns:
        The model, or one without Gaussians where every device was refused.
    """
    arrivals = admit(models, task.num_dealt, reporter)
    if not arrivals.models:
        return EdgeModel(splats=None, corrections=arrivals.corrections, refused=arrivals.refused)
    left = _decide_to_leave(task, arrivals, reporter.stage)
    rendered = [_views_of(models[name]) for name in arrivals.senders]
    if len(arrivals.models) > 1 and left is None:
        reporter.decide(teachers_decision(reporter.stage, rendered, arrivals.cameras))
    asked = zip(arrivals.models, arrivals.cameras, rendered, strict=True)
    teachers = [Teacher(splats=model, cameras=own, rendered=ready) for model, own, ready in asked]
    strips = [np.array(task.strips[task.devices.index(name)]).reshape(-1, 2) for name in arrivals.senders]
    if left is not None:
        teachers, joined = _pool(task, teachers, strips, reporter)
        reporter.decide(left)
    else:
        options = fit_options(task.backend, reporter, machine, lambda: join_key(task, models))
        joined = _join(task, teachers, strips, options, reporter)
    # Along a Z curve the order of the Gaussians no longer says how many devices there were and
    # which is whose.
    splats = joined.trained.splats.select(morton_order(joined.trained.splats.means))
    cameras, views = NO_CAMERAS, ()
    if task.aggregate.cloud == "retrain" or arrivals.uncertainty is not None:
        cameras, near = virtual_cameras_of(models, arrivals.cameras, splats)
        shown = {} if left is None else render_pictures(teachers, cameras, near, task.train.long_side_px, task.backend)
        views = tuple(shown[index] for index in sorted(shown))
    return EdgeModel(
        splats=splats,
        cameras=cameras,
        views=views,
        uncertainty=arrivals.uncertainty,
        corrections=arrivals.corrections,
        refused=arrivals.refused,
        summary={**training_summary(joined.trained), "num_models": len(arrivals.models)},
    )


def _views_of(model: DeviceModel | str) -> Mapping[int, Any]:
    # A device's model shows the same at its own cameras wherever both were moved to.
    return {} if isinstance(model, str) else model.rendered


def _decide_to_leave(task: EdgeTask, arrivals: Arrivals, stage: str) -> Decision | None:
    """That the edge leaves joining to the cloud, with the figure; None where it joins.

    It does where the cloud is expected to retrain: by the edge's own models, the whole scene taken
    to be like them. Where frames are uncertain the models are fitted to each other first, and a
    cloud with a limit of time has to see what retraining takes.
    """
    cloud = task.cloud
    if cloud is None or len(arrivals.models) < 2 or arrivals.uncertainty is not None or cloud.limits.time_s is not None:
        return None
    needs = pooled_needs(arrivals.models, arrivals.cameras, task.train.long_side_px, cloud.share)
    retrains, decision = choose_at_cloud(needs, cloud.limits, stage)
    choice = "left to the cloud, with the devices' pictures"
    return replace(decision, topic="retraining", choice=choice) if retrains else None


def _pool(task: EdgeTask, teachers: list[Teacher], strips: Sequence[Any], reporter: Reporter) -> tuple[list[Teacher], Joined]:
    """The teachers in one exposure, and their models as one."""
    balance = exposure_balance(teachers, task.backend)
    teachers = balance_teachers(teachers, balance)
    joined = pool_teachers(teachers, task.aggregate, claims_of_polygons(strips))
    reporter.decide(exposures_decision(reporter.stage, balance))
    reporter.decide(faint_decision(reporter.stage, task.aggregate, joined))
    return teachers, joined


def _join(task: EdgeTask, teachers: list[Teacher], strips: Sequence[Any], options: Any, reporter: Reporter) -> Joined:
    """The teachers' models retrained together, or cut where the edge's memory forbids that."""
    claims = claims_of_polygons(strips)
    kept = _statistics_bytes(task, teachers, reporter)
    if kept is None:
        return cut_at_borders(teachers, claims)
    joined = retrain_on_synthetic_views(teachers, task.train, task.aggregate, replace(options, statistics_bytes=kept), claims)
    for decision in join_decisions(reporter.stage, task.aggregate, len(teachers), joined):
        reporter.decide(decision)
    return joined


def _statistics_bytes(task: EdgeTask, teachers: Sequence[Teacher], reporter: Reporter) -> int | None:
    """What the loss may keep of its views; None, with a warning, where memory is short."""
    if task.memory_bytes is None or len(teachers) < 2:
        return STATISTICS_BUDGET_BYTES
    models, cameras = [teacher.splats for teacher in teachers], [teacher.cameras for teacher in teachers]
    left = kept_statistics_bytes(models, cameras, task.train.long_side_px, task.memory_bytes)
    needed_bytes = cloud_needs(models, cameras, task.train.long_side_px, None).memory_bytes
    decision = join_memory_decision(reporter.stage, needed_bytes, left, task.memory_bytes)
    reporter.decide(decision)
    if left is None:
        allowed = f"memory_gb of this edge allows {task.memory_bytes / 1e6:,.0f} MB"
        lift = f"To join them raise it in the system file of the next run; or {JOIN_AGAIN}"
        reporter.warn(f"{decision.choice}: {decision.reason}, and {allowed}. {CUT_COSTS} {lift}.")
    return left


def virtual_cameras_of(
    models: Mapping[str, DeviceModel | str], cameras: Sequence[Cameras], splats: Splats
) -> tuple[Cameras, NDArray[np.int64]]:
    """Virtual cameras (C) of an edge for its devices' `cameras` and its own model; which camera
    each stands near (C,).

    They are drawn by a seed made of what the edge received: the same run gives the same cameras,
    and the cloud cannot undo the draw.
    """
    rng = np.random.default_rng(int(key_of_files(received_files(models))[:32], 16))
    return virtual_cameras(concatenate_cameras(cameras), splats.means, rng)
