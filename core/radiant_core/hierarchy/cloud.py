"""What the cloud does: join the edges' models into the scene (paper Sec. III-D). Once per run.

admit ─→ retrain     all models together, on what each shows at its edge's virtual cameras
      ├→ fade        each where others own the place, in no epoch: devices fit the scene next
      ├→ cut         at the borders of the regions, where memory, time or a count of cameras forbid
      │              that; a warning says so
      └→ crop-merge  where the settings ask for it, or the paper's preset meets its limits
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from radiant_core.aggregate.averaging import average_bytes
from radiant_core.aggregate.cloud_choice import choose_at_cloud, cloud_needs
from radiant_core.aggregate.config import CLOUD_EPOCHS
from radiant_core.aggregate.crop_merge import crop_merge
from radiant_core.aggregate.join import Joined, cut_at_borders, join_models
from radiant_core.aggregate.join_memory import JoinMemory, plan_join_memory
from radiant_core.aggregate.synthetic_views import Teacher
from radiant_core.hierarchy.decisions import join_decisions
from radiant_core.hierarchy.device import training_summary
from radiant_core.hierarchy.join_limits import CUT_AT_CLOUD_COSTS, JoinLimit, limit_of_machine, report_join_memory, ways_to_lift
from radiant_core.hierarchy.joining import Arrivals, admit, join_key
from radiant_core.hierarchy.messages import ONLY_FADED, CloudTask, EdgeModel, SceneModel
from radiant_core.hierarchy.reporter import Machine, Reporter, fit_options
from radiant_core.plan.regions.claims import Claims, claims_of_cells
from radiant_core.plan.system import Cloud
from radiant_core.train.trainer import FitOptions

RAISE_LIMIT = "raise that limit under [cloud] in the system file of the next run"


def join_cloud(task: CloudTask, models: Mapping[str, EdgeModel | str], reporter: Reporter, machine: Machine = Machine()) -> SceneModel:
    """Join the edges' models into the scene.

    Args:
        task: regions, settings and limits.
        models: by edge, in the order of the task; text where the transport refuses one, with the
            reason.
        reporter: hears decisions, warnings and progress.
        machine: free memory, which limits the join where the task does not, and checkpoints.

    Returns:
        The scene, or one without Gaussians where every edge was refused.
    """
    arrivals = admit(models, task.num_dealt, reporter, task.backend)
    arrival_fields = {"corrections": arrivals.corrections, "refused": arrivals.refused, "uncertainty": arrivals.uncertainty}
    if not arrivals.models:
        return SceneModel(splats=None, **arrival_fields)
    rows = [task.edges.index(name) for name in arrivals.senders]
    sites, weights = np.array(task.sites)[rows], np.array(task.weights)[rows]
    cut_for_memory = False
    if task.join.method != "crop_merge":
        if task.join.epochs == 0 and not _can_average(task, arrivals):
            # Nobody is going to refine what would only fade.
            task = replace(task, join=replace(task.join, epochs=CLOUD_EPOCHS))
        choice = _FADES if task.join.epochs == 0 else _choose(task, arrivals, rows, reporter, machine)
        cut_for_memory = choice.cut_for_memory
        if choice.retrains or task.join.method != "paper":
            options = fit_options(task.backend, reporter, machine, lambda: join_key(task, models))
            teachers = [Teacher(splats=model, cameras=cameras) for model, cameras in zip(arrivals.models, arrivals.cameras, strict=True)]
            joined = _join(task, teachers, claims_of_cells(sites, weights), options, choice, reporter)
            summary = training_summary(joined.trained) | {ONLY_FADED: int(joined.is_unfitted)}
            return SceneModel(splats=joined.splats, summary=summary, cut_for_memory=cut_for_memory, cut=joined.cut, **arrival_fields)
    merged = crop_merge(arrivals.models, sites, weights)
    counts = {"num_splats": len(merged), "num_dropped": sum(map(len, arrivals.models)) - len(merged)}
    return SceneModel(splats=merged, summary=counts, cut_for_memory=cut_for_memory, **arrival_fields)


@dataclass(frozen=True, kw_only=True)
class _Choice:
    """Whether and how the cloud retrains, and whether free memory alone forbids it."""

    retrains: bool
    memory: JoinMemory
    cut_for_memory: bool


_FADES = _Choice(retrains=True, memory=JoinMemory(num_tiles=1, needed_bytes=0.0, statistics_bytes=0, fits=True), cut_for_memory=False)


def _can_average(task: CloudTask, arrivals: Arrivals) -> bool:
    """Whether what devices refine of so many Gaussians can be averaged in the cloud's memory."""
    most_bytes = None if task.limits is None else task.limits.memory_bytes
    needed = average_bytes(sum(map(len, arrivals.models)), max(model.sh_degree for model in arrivals.models), renders=False)
    return most_bytes is None or needed <= most_bytes


def _choose(task: CloudTask, arrivals: Arrivals, rows: Sequence[int], reporter: Reporter, machine: Machine) -> _Choice:
    """Whether and how models are joined; without a limit, in a share of what is free."""
    times_s = None if task.edge_times_s is None else [task.edge_times_s[row] for row in rows]
    cloud = task.limits or Cloud()
    limits, memory_of = cloud, "the cloud's limit"
    if cloud.memory_bytes is not None:
        memory_limit = JoinLimit(num_bytes=cloud.memory_bytes, label="[cloud] memory_gb", lift=RAISE_LIMIT)
    else:
        memory_limit = limit_of_machine(machine)
        if np.isfinite(memory_limit.num_bytes):
            limits, memory_of = replace(cloud, memory_bytes=memory_limit.num_bytes), f"{memory_limit.label}, a limit"
    memory = plan_join_memory(arrivals.models, arrivals.cameras, task.train.long_side_px, memory_limit.num_bytes, task.join.most_tiles)
    needs = cloud_needs(arrivals.models, arrivals.cameras, memory, times_s)
    retrains, decision = choose_at_cloud(needs, limits, reporter.stage, memory_of=memory_of)
    reporter.decide(decision)
    lift = partial(ways_to_lift, can_join_again=arrivals.uncertainty is None)
    if retrains:
        if len(arrivals.models) > 1:
            # A join in tiles is finished: no --resume does it anew.
            report_join_memory(memory, replace(memory_limit, lift=lift(memory_limit.lift)), CUT_AT_CLOUD_COSTS, reporter)
        return _Choice(retrains=True, memory=memory, cut_for_memory=False)
    by_machine = choose_at_cloud(needs, cloud, reporter.stage)[0]
    ways = lift("free memory there and go on with --resume" if by_machine else RAISE_LIMIT)
    reporter.warn(f"{decision.choice}: {decision.reason}. {CUT_AT_CLOUD_COSTS} To join them {ways}.")
    return _Choice(retrains=False, memory=memory, cut_for_memory=by_machine)


def _join(
    task: CloudTask, teachers: list[Teacher], claims: Claims | None, options: FitOptions, choice: _Choice, reporter: Reporter
) -> Joined:
    """The teachers' models retrained together, or cut at the borders of the regions."""
    if not choice.retrains:
        return cut_at_borders(teachers, claims)
    options = replace(options, statistics_bytes=choice.memory.statistics_bytes)
    joined = join_models(teachers, task.train, task.join, options, claims, choice.memory.num_tiles)
    for decision in join_decisions(reporter.stage, task.join, len(teachers), joined):
        reporter.decide(decision)
    return joined
