"""What edges and the cloud decide when they join models, and the cloud's retraining, its task and node (paper Sec. III-D). Once per run.

The cloud gets virtual cameras of each edge with their pictures and how long its aggregation took, never a device's id, count or pose.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from radiant_app.events import Decided, Event, Warned
from radiant_app.workers.inbox import VIRTUAL_VIEWS, Inbox
from radiant_app.workers.memory import available_bytes
from radiant_core.aggregate.config import AggregateConfig
from radiant_core.cameras import Cameras, concatenate_cameras
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.io.run_store import SEAL_NAME, content_key, read_json
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.system import Cloud, System
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig

if TYPE_CHECKING:
    from radiant_core.aggregate.balance import Balance
    from radiant_core.aggregate.retrain import Joined
    from radiant_core.aggregate.synthetic_views import Rendered, Teacher
    from radiant_core.train.trainer import FitOptions

MACHINE_SHARE = 0.8
"""Of the memory that is free where the cloud runs, what joining may take unless the system file sets a limit: the rest is others'."""
CUT_COSTS = "On two scenes that were joined both ways a cut came out 0.5 to 0.8 dB lower."
JOIN_AGAIN = "`radiant aggregate RUN --out JOINED.ply` joins the models of a run without a limit, on any machine"
CUT_NAME = "cut_for_memory"
"""An empty file in the cloud's folder: its models are cut because its machine had too little memory."""
BY_PRESET = "the preset follows 3DGS and the paper, which add and skip nothing here"


def virtual_cameras_of(folder: Path, cameras: Sequence[Cameras], splats: Splats) -> tuple[Cameras, NDArray[np.int64]]:
    """Virtual cameras (C) of the edge in `folder` for its devices' `cameras` and its own model; which camera each stands near (C,).

    They are drawn by a seed made of what the edge was sent: the same run gives the same cameras, and the cloud cannot undo the draw.
    """
    from radiant_core.aggregate.virtual_cameras import virtual_cameras

    rng = np.random.default_rng(int(content_key(folder / "inbox")[:32], 16))
    return virtual_cameras(concatenate_cameras(cameras), splats.means, rng)


def pool_settings(edge: str, plan: CloudPlan, system: System, aggregate: AggregateConfig) -> dict[str, Any] | None:
    """What an edge's task says of the cloud, where edges leave joining to it: its limits, and the edge's share of all cameras."""
    # A lone edge joins its models as the cloud would.
    if not aggregate.edges_pool or np.count_nonzero(plan.counts) < 2:
        return None
    return {"limits": asdict(system.cloud), "share": float(plan.counts[plan.edge_ids.index(edge)] / plan.counts.sum())}


def edge_pools(task: dict[str, Any], inbox: Inbox, stage: str) -> Decision | None:
    """That an edge leaves joining to the cloud, with the figure; None where it retrains.

    It does where the cloud is expected to retrain: by an edge's own memory, the whole scene taken to be like it. Where frames are
    uncertain the models are fitted to each other first, and a cloud with a limit of time wants to know what retraining takes.
    """
    from radiant_core.aggregate.cloud_choice import choose_at_cloud, pooled_needs

    cloud = task.get("cloud")
    if cloud is None or len(inbox.models) < 2 or inbox.uncertainty is not None or cloud["limits"]["time_s"] is not None:
        return None
    needs = pooled_needs(inbox.models, inbox.cameras, task["train"]["long_side_px"], cloud["share"])
    retrains, decision = choose_at_cloud(needs, Cloud(**cloud["limits"]), stage)
    choice = "left to the cloud, with the devices' pictures"
    return replace(decision, topic="retraining", choice=choice) if retrains else None


def retrain_settings(run: Path, edges: Sequence[str], plan: CloudPlan, system: System, aggregate: AggregateConfig) -> dict[str, Any]:
    """What the cloud's task says besides the plan: how to aggregate, its limits and, where time is limited, seconds of each edge."""
    settings: dict[str, Any] = {"aggregate": asdict(aggregate)}
    if aggregate.cloud == "retrain":
        settings["limits"] = asdict(system.cloud)
        # Measured times differ from run to run: they are dealt only where they decide.
        settings["edge_times_s"] = None if system.cloud.time_s is None else [_edge_time_s(run, edge, plan, system) for edge in edges]
    return settings


def sent_pictures(path: Path, model: Splats, cameras: Cameras) -> tuple[Rendered, str | None]:
    """The pictures at virtual cameras that an edge sent beside its model, by index of the camera; none, and why, where they are broken or
    show something else than the model does."""
    from radiant_core.aggregate.agreement import MIN_AGREEMENT_DB, measure_agreement_db
    from radiant_core.io.view_file import load_views

    if not path.is_file():
        return {}, None
    try:
        views = load_views(path, [(int(width), int(height)) for width, height in cameras.sizes_wh])
    except BadInput as error:
        return {}, str(error)
    if views and (agreement_db := measure_agreement_db(model, cameras, views)) < MIN_AGREEMENT_DB:
        return {}, f"they differ from what its model shows ({agreement_db:.1f} dB, expected {MIN_AGREEMENT_DB:g} or more)."
    return dict(enumerate(views)), None


def joined_at_cloud(folder: Path, task: dict[str, Any], inbox: Inbox, emit: Callable[[Event], None], options: FitOptions) -> Joined | None:
    """The models in the inbox of the cloud in `folder` as one: retrained together, or cut at their borders where its limits forbid that,
    which is a warning. None where they do and the paper's preset crop-merges. The choice is emitted as a decision.

    Without a limit of memory in the system file the cloud takes `MACHINE_SHARE` of what is free on its machine.
    """
    from radiant_core.aggregate.cloud_choice import choose_at_cloud, cloud_needs, kept_statistics_bytes
    from radiant_core.aggregate.ownership import claims_of_cells
    from radiant_core.aggregate.retrain import cut_at_borders, retrain_on_synthetic_views

    stage = folder.name
    train, aggregate = TrainConfig(**task["train"]), AggregateConfig(**task["aggregate"])
    rows = [task["edges"].index(name) for name in inbox.senders]
    times_s = task["edge_times_s"]
    needs = cloud_needs(inbox.models, inbox.cameras, train.long_side_px, None if times_s is None else [times_s[row] for row in rows])
    given = Cloud(**task["limits"])
    limits, memory_of = _within_machine(given)
    retrains, decision = choose_at_cloud(needs, limits, stage, memory_of=memory_of)
    emit(Decided(decision=decision))
    (folder / CUT_NAME).unlink(missing_ok=True)
    if not retrains:
        by_machine = choose_at_cloud(needs, given, stage)[0]
        if by_machine:
            (folder / CUT_NAME).touch()
        lift = (
            "free memory there and go on with --resume"
            if by_machine
            else "raise that limit under [cloud] in the system file of the next run"
        )
        again = f"; or {JOIN_AGAIN}" if inbox.uncertainty is None else ""
        emit(Warned(stage=stage, message=f"{decision.choice}: {decision.reason}. {CUT_COSTS} To join them {lift}{again}."))
    if not retrains and aggregate.preset == "paper":
        return None
    teachers = cloud_teachers(folder, inbox, train.long_side_px, emit)
    claims = claims_of_cells(np.array(task["sites"])[rows], np.array(task["weights"])[rows])

    def statistics_bytes(chosen: Sequence[Teacher]) -> int | None:
        models, cameras = [teacher.splats for teacher in chosen], [teacher.cameras for teacher in chosen]
        return kept_statistics_bytes(models, cameras, train.long_side_px, limits.memory_bytes or 0.0)

    if retrains:
        whole = replace(options, statistics_bytes=statistics_bytes(teachers) or 0)
        joined = retrain_on_synthetic_views(teachers, train, aggregate, whole, claims)
        for decided in join_decisions(stage, aggregate, len(teachers), joined):
            emit(Decided(decision=decided))
        return joined
    # What an edge only pooled, for a cloud that was expected to join, is still joined by itself where that fits.
    alone = replace(options, checkpoints=None)
    for index, teacher in enumerate(teachers):
        if teacher.pooled and (left := statistics_bytes([teacher])) is not None:
            joined = retrain_on_synthetic_views([teacher], train, aggregate, replace(alone, statistics_bytes=left))
            teachers[index] = replace(teacher, splats=joined.splats)
    return cut_at_borders(teachers, claims)


def forget_cut(folder: Path) -> None:
    """Unseal a cloud that cut its models for want of its machine's memory: there may be more by now."""
    if (folder / CUT_NAME).is_file():
        (folder / SEAL_NAME).unlink(missing_ok=True)


def _within_machine(cloud: Cloud) -> tuple[Cloud, str]:
    """The cloud's limits, that of memory taken from the machine where the system sets none; whose limit of memory it is, in words."""
    if cloud.memory_bytes is not None:
        return cloud, "the cloud's limit"
    return replace(cloud, memory_bytes=MACHINE_SHARE * available_bytes()), f"{MACHINE_SHARE:.0%} of what this machine has free, a limit"


def cloud_teachers(folder: Path, inbox: Inbox, long_side_px: int, emit: Callable[[Event], None]) -> list[Teacher]:
    """The edges' models with their virtual cameras and the pictures there that they sent; what is wrong with those is a warning."""
    from radiant_core.aggregate.synthetic_views import Teacher

    teachers = []
    for name, model, own in zip(inbox.senders, inbox.models, inbox.cameras, strict=True):
        pictures, refusal = sent_pictures(folder / "inbox" / name / VIRTUAL_VIEWS, model, own.scaled(long_side_px))
        if refusal is not None:
            message = f"the pictures of {name} are left out, its model's are shown instead: {refusal}"
            emit(Warned(stage=folder.name, message=message))
        teachers.append(Teacher(splats=model, cameras=own, rendered=pictures, pooled=bool(pictures) or refusal is not None))
    return teachers


def join_decisions(stage: str, aggregate: AggregateConfig, num_models: int, joined: Joined) -> list[Decision]:
    """What was retrained of the joined models and what was skipped, with the figures that decided."""

    def decided(choice: str, figure: float, unit: str, reason: str) -> Decision:
        forced = aggregate.preset == "paper"
        return Decision(stage=stage, topic="retraining", choice=choice, figure=figure, unit=unit, reason=reason, forced=forced)

    steps = joined.trained.num_steps
    if num_models == 1 and not steps:
        return [decided("skipped", 1.0, "models", "a single model would only learn from its own pictures")]
    if aggregate.preset == "paper":
        return [decided(f"{steps:,} steps on all Gaussians and whole pictures", float(steps), "steps", BY_PRESET)]
    exposures = [] if joined.balance is None else [exposures_decision(stage, joined.balance)]
    if not joined.num_shown:
        reason = "no view shows enough that a second model knows: models are cut at their borders"
        return [*exposures, decided("skipped", 0.0, "% contested", reason)]
    if not steps:
        reason = f"models that agree to {aggregate.agreement_db:g} dB have no seam that could be seen: they are cut at their borders"
        return [*exposures, decided("skipped", joined.agreement_db or 0.0, "dB", reason)]
    shown = f"{joined.num_shown} of {joined.num_views} views"
    share = 100 * joined.contested_share
    left = f"{joined.num_given:,} Gaussians became {len(joined.splats):,}"
    reason = "only what a second model knows too can be joined better"
    return [*exposures, decided(f"{steps:,} steps on {shown}; {left}", share, "% contested", reason)]


def exposures_decision(stage: str, balance: Balance) -> Decision:
    """Whether models were balanced, with how far the one that differs most is off."""
    choice = "models are balanced by a gain and an offset per channel" if balance.needed else "left as they are"
    if not balance.num_pairs:
        reason = "no two models show the same place"
    else:
        reason = f"{'more' if balance.needed else 'no more'} than models of one exposure differ by"
    unit = "of 255 from the mean of all models, at mid grey"
    unchanged = not balance.needed
    topic = "exposures of the models"
    return Decision(stage=stage, topic=topic, choice=choice, figure=balance.levels, unit=unit, reason=reason, changes_nothing=unchanged)


def faint_decision(stage: str, aggregate: AggregateConfig, pooled: Joined) -> Decision:
    """How many of the Gaussians were left out where another model owns the place."""
    num_left_out = pooled.num_given - len(pooled.splats)
    share = 100 * num_left_out / max(pooled.num_given, 1)
    choice = f"{num_left_out:,} of {pooled.num_given:,} left out" if num_left_out else "all are kept"
    reason = f"another model owns their place, and faded they would be fainter than {aggregate.faint_opacity:g}"
    kept = not num_left_out
    return Decision(stage=stage, topic="faint Gaussians", choice=choice, figure=share, unit="% of all", reason=reason, changes_nothing=kept)


def _edge_time_s(run: Path, edge: str, plan: CloudPlan, system: System) -> float:
    """Seconds that the edge's retraining took; by its cost curve where it did none."""
    summary = read_json(run / "edges" / edge / "summary.json", ("train_s", "num_steps"))
    if summary["num_steps"]:
        return float(summary["train_s"])
    row = plan.edge_ids.index(edge)
    return float(system.edges[row].aggregate_s(int(plan.counts[row])))
