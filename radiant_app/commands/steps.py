"""The single steps of the main job as commands: each returns what the command line prints, as a plain dictionary."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from radiant_app.events import StageProgress, StageStarted
from radiant_app.files.run_folder import sfm_folder
from radiant_app.report.progress import ProgressDisplay
from radiant_app.workers.cloud_task import virtual_cameras_of
from radiant_app.workers.nodes import sfm_progress, sfm_record
from radiant_core.aggregate.config import AggregatePreset, aggregate_preset
from radiant_core.errors import BadInput
from radiant_core.evaluate.split import held_out_mask
from radiant_core.io.ply import save_ply
from radiant_core.io.records import load_cameras, load_plan, save_scene
from radiant_core.io.run_store import read_json, write_json
from radiant_core.io.transport.upload import load_upload
from radiant_core.scene import SfmScene


def sfm(  # noqa: PLR0913
    source: Path,
    out: Path,
    matching: Any,
    display: ProgressDisplay,
    masks: Path | None = None,
    placement: dict[str, Any] | None = None,
    *,
    resume: bool = False,
) -> dict[str, Any]:
    """Structure from motion of `source` into the new folder `out`, or with `resume` on with one that was interrupted there.

    `placement` has fields of `radiant_core.sfm.world_frame.placement.Placement`.
    """
    from radiant_app.run.sources import reconstruct_source, sfm_task

    task = sfm_task(source, {"matching": matching}, masks, placement or {})
    with sfm_folder(out, task, resume=resume), libraries_log_to(out / "log.txt"), stage_bar(display, "sfm"):
        result = reconstruct_source(task, out, lambda progress: display(sfm_progress("sfm", progress)))
    save_scene(out / "scene.safetensors", result.scene)
    write_json(out / "result.json", sfm_record(result, out))
    return {
        "cameras": len(result.scene.cameras),
        "points": len(result.scene.points),
        "frame": result.scene.frame.kind,
        "gps_residual_m": result.scene.frame.residual_m,
        "unregistered": list(result.unregistered),
        "warnings": "; ".join(result.warnings) or "none",
        "folder": str(out),
    }


def aggregate(run: Path, out: Path, preset: AggregatePreset, epochs: int | None, display: ProgressDisplay) -> dict[str, Any]:
    """Join the device models of a finished run with other settings; writes a PLY. No system file is read: the cloud has no limit."""
    from radiant_core.aggregate.balance import balanced, exposure_balance
    from radiant_core.aggregate.crop_merge import crop_merge
    from radiant_core.aggregate.ownership import claims_of_cells, claims_of_polygons
    from radiant_core.aggregate.pooling import pictures_of, pooled
    from radiant_core.aggregate.retrain import retrain_on_synthetic_views
    from radiant_core.aggregate.synthetic_views import Teacher
    from radiant_core.train.config import TrainConfig
    from radiant_core.train.trainer import FitOptions

    require_file_to_be(out)
    require_run(run)
    cloud_plan, edge_plans = load_plan(run / "plan.json")
    config = aggregate_preset(preset)
    config = config if epochs is None else replace(config, num_epochs=epochs)
    train = TrainConfig()
    asked: list[Teacher] = []
    rows, seconds = [], 0.0
    for row, edge_plan in enumerate(edge_plans):
        if not len(edge_plan.camera_indices):
            continue
        edge = edge_plan.edge_id
        task = read_json(run / "edges" / edge / "task.json", ("devices", "train"))
        train = TrainConfig(**task["train"])
        inbox = [run / "edges" / edge / "inbox" / device for device in task["devices"]]
        with stage_bar(display, f"edges/{edge}") as report:
            options = FitOptions(report=lambda p, report=report: report(p.step, p.num_steps, f"loss {p.loss:.4f}"))
            device_models = [load_upload(place / "model.safetensors") for place in inbox]
            device_cameras = [load_cameras(place / "cameras.safetensors") for place in inbox]
            claims = claims_of_polygons([edge_plan.strips[edge_plan.device_ids.index(device)] for device in task["devices"]])
            teachers = [Teacher(splats=model, cameras=own) for model, own in zip(device_models, device_cameras, strict=True)]
            pools = config.edges_pool and len(teachers) > 1
            if pools:
                teachers = balanced(teachers, exposure_balance(teachers))
            joined = pooled(teachers, config, claims) if pools else retrain_on_synthetic_views(teachers, train, config, options, claims)
        virtual, near = virtual_cameras_of(run / "edges" / edge, device_cameras, joined.splats)
        shown = pictures_of(teachers, virtual, near, train.long_side_px) if pools else {}
        asked.append(Teacher(splats=joined.splats, cameras=virtual, rendered=shown, pooled=pools))
        rows.append(row)
        seconds += joined.trained.seconds
    if config.cloud == "retrain" and asked:
        with stage_bar(display, "cloud") as report:
            options = FitOptions(report=lambda p: report(p.step, p.num_steps, f"loss {p.loss:.4f}"))
            claims = claims_of_cells(cloud_plan.sites[rows], cloud_plan.weights[rows])
            joined = retrain_on_synthetic_views(asked, train, config, options, claims)
        save_ply(out, joined.splats)
        return {"gaussians": len(joined.splats), "retrain_s": round(seconds + joined.trained.seconds, 2), "model": str(out)}
    merged = crop_merge(
        [edge.splats for edge in asked], cloud_plan.sites[rows], cloud_plan.weights[rows], fill_blind_spots=config.fill_blind_spots
    )
    save_ply(out, merged.splats)
    return {"gaussians": len(merged.splats), "retrain_s": round(seconds, 2), "filled": merged.num_filled, "model": str(out)}


def screenshot(run: Path, view: Any, path: Path, size_wh: tuple[int, int] = (1280, 900), camera: str | None = None) -> str:
    """Write one view of a run, a training or a scene as PNG."""
    from radiant_viewer.pictures.images import save_png
    from radiant_viewer.runs.run_pictures import screenshot as make_screenshot

    save_png(path, make_screenshot(run, view, size_wh, camera))
    return f"written: {path}"


def training_part(scene: SfmScene) -> SfmScene:
    """The scene without its held-out cameras."""
    return scene.restricted_to(np.flatnonzero(~held_out_mask(scene.cameras.names)))


def require_run(folder: Path, name: str = "plan.json") -> None:
    """Raise BadInput unless `folder` holds the file `name` of a run."""
    if not (folder / name).is_file():
        raise BadInput(f"{folder} holds no {name}: give the folder of a run that went that far, made by 'radiant run --out'.")


def require_model(model: Path) -> None:
    """Raise BadInput where a folder holds no model, with what makes one; a file is its reader's matter."""
    from radiant_viewer.runs.run_view import no_model_text

    if not model.exists():
        raise BadInput(f"there is no {model}: name the folder of a run or a training, or a .ply file.")
    if model.is_dir() and not (model / "scene.ply").is_file():
        raise BadInput(no_model_text(model))


def require_file_to_be(out: Path) -> None:
    """Raise BadInput when `out` exists already or its folder does not."""
    if out.exists():
        raise BadInput(f"{out} exists: choose another name.")
    if not out.parent.is_dir():
        raise BadInput(f"there is no folder {out.parent} to write {out.name} into: make it first.")


@contextmanager
def libraries_log_to(path: Path) -> Iterator[None]:
    """While open, what libraries in C++ write to standard error goes to a file, as in the processes of a run; what Python says is shown.

    Nothing changes where Python's standard error is not the process's own, since a test or another program listens to it.
    """
    told = sys.stderr
    try:
        own = told.fileno() == 2
    except (AttributeError, OSError, ValueError):
        own = False
    if not own:
        yield
        return
    with os.fdopen(os.dup(2), "w", buffering=1, encoding=told.encoding, errors=told.errors) as shown, path.open("a") as log:
        told.flush()
        os.dup2(log.fileno(), 2)
        sys.stderr = shown
        try:
            yield
        finally:
            sys.stderr = told
            os.dup2(shown.fileno(), 2)


@contextmanager
def stage_bar(display: ProgressDisplay, stage: str) -> Iterator[Any]:
    """A progress bar of its own for one step; yields `report(done, total, note)`."""
    with display:
        display(StageStarted(stage=stage))
        yield lambda done, total, note: display(StageProgress(stage=stage, done=done, total=total, note=note))
