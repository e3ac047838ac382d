"""`radiant join`: join a run's device models again, with other settings and without limits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from radiant_app.commands.run.steps import require_file_to_be, require_run, stage_bar
from radiant_app.events import Warned
from radiant_app.files.out_folder import folder_made_for
from radiant_app.files.run_folder import require_current
from radiant_app.report.progress import ProgressDisplay
from radiant_app.reporting import EventReporter
from radiant_app.workers.inbox import receive_device_models
from radiant_core.aggregate.config import AggregateConfig, AggregatePreset, Join, aggregate_preset
from radiant_core.errors import BadInput
from radiant_core.hierarchy.cloud import join_cloud
from radiant_core.hierarchy.codec import load_task, passed_on
from radiant_core.hierarchy.edge import join_edge
from radiant_core.hierarchy.messages import CloudTask, EdgeModel, EdgeTask, SceneModel
from radiant_core.io.ply import save_ply
from radiant_core.io.records import load_plan
from radiant_core.plan.plans import CloudPlan


def aggregate(run: Path, out: Path, preset: AggregatePreset, epochs: int | None, display: ProgressDisplay) -> dict[str, Any]:
    """Join the device models of a finished run into a PLY; neither tier has a limit.

    Args:
        run: folder of the run.
        out: the PLY, which must not exist.
        preset: how models are joined.
        epochs: how often each view is shown; None: as often as the preset says.
        display: shows progress.

    Returns:
        Figures of the joined model, for the command line.

    Raises:
        BadInput: the run is of an earlier version, or none of its models can be joined.
    """
    require_file_to_be(out)
    require_run(run)
    require_current(run)
    config = aggregate_preset(preset)
    if epochs is not None:
        config = replace(config, edge=replace(config.edge, epochs=epochs), cloud=replace(config.cloud, epochs=epochs))
    scene, joined_s = join_run(run, config.joining_after(None), display)
    if scene.splats is None:
        raise BadInput(f"no model of {run} can be joined: {'; '.join(scene.refused.values()) or 'no edge has one'}.")
    with folder_made_for(out):
        save_ply(out, scene.splats)
    seconds = joined_s + scene.summary.get("train_s", 0.0)
    return {"gaussians": len(scene.splats), "retrain_s": round(seconds, 2), "model": str(out)}


def join_run(run: Path, config: AggregateConfig, display: ProgressDisplay) -> tuple[SceneModel, float]:
    """The scene that a run's tiers make of its device models, and the seconds edges retrained."""
    cloud_plan, edge_plans = load_plan(run / "plan.json")
    folders = [run / "edges" / plan.edge_id for plan in edge_plans if len(plan.camera_indices)]
    tasks = {folder.name: load_task(EdgeTask, folder) for folder in folders if (folder / "inbox").is_dir()}
    if not tasks:
        raise BadInput(f"{run} has no edge that received models: give a run whose devices have trained.")
    for folder in folders:
        if folder.name not in tasks:
            display(Warned(stage=f"edges/{folder.name}", message="it received no model, so its region is left out."))
    models: dict[str, EdgeModel | str] = {}
    joined_s = 0.0
    for edge, edge_task in tasks.items():
        task = replace(edge_task, join=config.edge, draws_cameras=True, memory_bytes=None)
        arrived = receive_device_models(run / "edges" / edge, task.devices)
        stage = f"edges/{edge}"
        with stage_bar(display, stage):
            model = join_edge(task, arrived, EventReporter(stage=stage, emit=display))
        if model.splats is not None:
            models[edge] = passed_on(model, task.upload)
            joined_s += float(model.summary["train_s"])
    if not models:
        return SceneModel(splats=None), joined_s
    with stage_bar(display, "cloud"):
        scene = join_cloud(_cloud_task(cloud_plan, tasks, tuple(models), config.cloud), models, EventReporter(stage="cloud", emit=display))
    return scene, joined_s


def _cloud_task(plan: CloudPlan, tasks: dict[str, EdgeTask], edges: tuple[str, ...], join: Join) -> CloudTask:
    rows = [plan.edge_ids.index(edge) for edge in edges]
    first = tasks[edges[0]]
    return CloudTask(
        edges=edges,
        num_dealt=tuple(sum(tasks[edge].num_dealt) for edge in edges),
        sites=tuple((float(x), float(y)) for x, y in plan.sites[rows]),
        weights=tuple(float(weight) for weight in plan.weights[rows]),
        train=first.train,
        backend=first.backend,
        join=join,
    )
