"""What edges and the cloud decide when they join models, and the cloud's retraining, its task and node (paper Sec. III-D). Once per run.

The cloud gets virtual cameras of each edge and how long its aggregation took, never a device's id, count or pose.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from radiant_app.events import Decided, Event
from radiant_app.inbox import Inbox
from radiant_core.aggregate.config import AggregateConfig
from radiant_core.cameras import Cameras, concatenate_cameras
from radiant_core.decisions import Decision
from radiant_core.io.run_store import content_key, read_json
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.system import System
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig

if TYPE_CHECKING:
    from radiant_core.aggregate.retrain import Joined

CLOUD_BYTES = 1e9
"""Memory that the default joining may take at a cloud whose system file sets no limit: beyond it a scene is cut, however large it is."""
BY_PRESET = "the preset follows 3DGS and the paper, which add and skip nothing here"


def virtual_cameras_of(folder: Path, cameras: Sequence[Cameras], splats: Splats) -> Cameras:
    """Virtual cameras of the edge in `folder` for its devices' `cameras` and its own model.

    They are drawn by a seed made of what the edge was sent: the same run gives the same cameras, and the cloud cannot undo the draw.
    """
    from radiant_core.aggregate.virtual_cameras import virtual_cameras

    rng = np.random.default_rng(int(content_key(folder / "inbox")[:32], 16))
    return virtual_cameras(concatenate_cameras(cameras), splats.means, rng)


def retrain_settings(run: Path, edges: Sequence[str], plan: CloudPlan, system: System, aggregate: AggregateConfig) -> dict[str, Any]:
    """What the cloud's task says besides the plan: how to aggregate, its limits and, where time is limited, seconds of each edge."""
    settings: dict[str, Any] = {"aggregate": asdict(aggregate)}
    if aggregate.cloud == "retrain":
        settings["limits"] = asdict(system.cloud)
        # Measured times differ from run to run: they are dealt only where they decide.
        settings["edge_times_s"] = None if system.cloud.time_s is None else [_edge_time_s(run, edge, plan, system) for edge in edges]
    return settings


def retrained_at_cloud(task: dict[str, Any], inbox: Inbox, stage: str, emit: Callable[[Event], None], options: Any) -> Any:
    """`Joined` of retraining at the cloud, or None where its limits forbid it; the choice is emitted as a decision."""
    from radiant_core.aggregate.cloud_choice import choose_at_cloud, cloud_needs
    from radiant_core.aggregate.ownership import claims_of_cells
    from radiant_core.aggregate.retrain import Teacher, retrain_on_synthetic_views
    from radiant_core.plan.system import Cloud

    train, aggregate = TrainConfig(**task["train"]), AggregateConfig(**task["aggregate"])
    times_s = task["edge_times_s"]
    own_times_s = None if times_s is None else [times_s[task["edges"].index(name)] for name in inbox.senders]
    needs = cloud_needs(inbox.models, inbox.cameras, train.long_side_px, own_times_s)
    limits = Cloud(**task["limits"])
    if aggregate.preset == "default" and limits.memory_bytes is None:
        limits = replace(limits, memory_bytes=CLOUD_BYTES)
    retrains, decision = choose_at_cloud(needs, limits, stage)
    emit(Decided(decision=decision))
    if not retrains:
        return None
    rows = [task["edges"].index(name) for name in inbox.senders]
    claims = claims_of_cells(np.array(task["sites"])[rows], np.array(task["weights"])[rows])
    teachers = [Teacher(splats=model, cameras=own) for model, own in zip(inbox.models, inbox.cameras, strict=True)]
    return retrain_on_synthetic_views(teachers, train, aggregate, options, claims)


def join_decisions(stage: str, aggregate: AggregateConfig, num_models: int, joined: Joined) -> list[Decision]:
    """What was retrained of the joined models and what was skipped, with the figures that decided."""

    def decided(choice: str, figure: float, unit: str, reason: str) -> Decision:
        forced = aggregate.preset == "paper"
        return Decision(stage=stage, topic="retraining", choice=choice, figure=figure, unit=unit, reason=reason, forced=forced)

    steps = joined.trained.num_steps
    if num_models == 1 and not aggregate.retrain_single:
        return [decided("skipped", 1.0, "models", "a single model would only learn from its own pictures")]
    if aggregate.preset == "paper":
        return [decided(f"{steps:,} steps on all Gaussians and whole pictures", float(steps), "steps", BY_PRESET)]
    if not joined.num_shown:
        return [decided("skipped", 0.0, "% contested", "no view shows enough that a second model knows: models are cut at their borders")]
    if not steps:
        reason = f"models that agree to {aggregate.agreement_db:g} dB have no seam that could be seen: they are cut at their borders"
        return [decided("skipped", joined.agreement_db or 0.0, "dB", reason)]
    shown = f"{joined.num_shown} of {joined.num_views} views"
    share = 100 * joined.contested_share
    left = f"{joined.num_given:,} Gaussians became {len(joined.splats):,}"
    return [decided(f"{steps:,} steps on {shown}; {left}", share, "% contested", "only what a second model knows too can be joined better")]


def _edge_time_s(run: Path, edge: str, plan: CloudPlan, system: System) -> float:
    """Seconds that the edge's retraining took; by its cost curve where it did none."""
    summary = read_json(run / "edges" / edge / "summary.json", ("train_s", "num_steps"))
    if summary["num_steps"]:
        return float(summary["train_s"])
    row = plan.edge_ids.index(edge)
    return float(system.edges[row].aggregate_s(int(plan.counts[row])))
