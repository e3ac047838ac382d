"""What a worker computes in its folder: one function per kind of node. Each reads only files below the folder it is given.

| kind     | reads                                               | writes                                   |
|----------|-----------------------------------------------------|------------------------------------------|
| sfm      | task.json, the source it names                      | scene.safetensors, result.json, undistorted/ |
| device   | task.json, scene.safetensors, photos/               | model.safetensors, summary.json          |
| edge     | task.json, inbox/<device>/{model,cameras}.safetensors | model.safetensors, summary.json        |
| cloud    | task.json, inbox/<edge>/model.safetensors           | scene.ply, summary.json                  |
| evaluate | task.json, scene.ply, plan.json, photos/ …          | result.json, renders/, photographs/, differences/ |
| run      | task.json, a whole run's source                     | that run's folder: a job of a batch      |
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiant_app.events import Decided, Event, StageProgress, Warned
from radiant_core.cameras import Cameras
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.io.photos import load_photograph
from radiant_core.io.ply import save_ply
from radiant_core.io.records import load_cameras, load_scene, load_splats, save_scene, save_splats
from radiant_core.io.run_store import read_json, write_json

Emit = Callable[[Event], None]


def run_node(kind: str, folder: Path, stage: str, emit: Emit) -> Sequence[str]:
    """Run one node and return the names of the files it made, relative to `folder`; decisions and warnings also go to notes.json."""
    from radiant_app.batch import run_job
    from radiant_app.evaluation import run_evaluate

    runners = {"sfm": run_sfm, "device": run_device, "edge": run_edge, "cloud": run_cloud, "evaluate": run_evaluate, "run": run_job}
    if kind not in runners:
        raise BadInput(f"worker kind {kind!r} is unknown: use one of {', '.join(runners)}.")
    notes: dict[str, list[Any]] = {"decisions": [], "warnings": []}

    def emit_and_note(event: Event) -> None:
        if isinstance(event, Decided):
            notes["decisions"].append(asdict(event.decision))
        elif isinstance(event, Warned):
            notes["warnings"].append(event.message)
        emit(event)

    outputs = runners[kind](folder, stage, emit_and_note)
    write_json(folder / "notes.json", notes)
    return [*outputs, "notes.json"]


def read_notes(folder: Path, stage: str) -> list[Event]:
    """The decisions and warnings that a finished node left behind."""
    notes = read_json(folder / "notes.json", ("decisions", "warnings"))
    decided = [Decided(decision=Decision(**fields)) for fields in notes["decisions"]]
    return [*decided, *(Warned(stage=stage, message=message) for message in notes["warnings"])]


def run_sfm(folder: Path, stage: str, emit: Emit) -> Sequence[str]:
    """Structure from motion on the source that task.json names."""
    from radiant_app.sources import reconstruct_source

    task = read_json(folder / "task.json")
    result = reconstruct_source(task, folder, lambda progress: emit(_sfm_progress(stage, progress)))
    for decision in result.decisions:
        emit(Decided(decision=decision))
    for message in result.warnings:
        emit(Warned(stage=stage, message=message))
    save_scene(folder / "scene.safetensors", result.scene)
    write_json(folder / "result.json", {"images": place_of(result.undistorted_folder, folder), "unregistered": list(result.unregistered)})
    # Images that were pinhole already stay where they are, outside of this folder: they are the owner's and not sealed.
    own = [path for path in sorted((folder / "undistorted").rglob("*")) if path.is_file()]
    return ["scene.safetensors", "result.json", *(str(path.relative_to(folder)) for path in own)]


def run_device(folder: Path, stage: str, emit: Emit) -> Sequence[str]:
    """Train one model from the folder's own photographs and points."""
    from radiant_core.train.config import TrainConfig
    from radiant_core.train.initialize import first_splats, sky_share
    from radiant_core.train.trainer import fit_splats
    from radiant_core.train.views import TrainingViews

    task = read_json(folder / "task.json")
    config = TrainConfig(**task["train"])
    scene = load_scene(folder / "scene.safetensors")
    cameras = scene.cameras.scaled(config.long_side_px)
    emit(Decided(decision=_sky_decision(stage, sky_share(cameras))))
    views = TrainingViews(cameras=cameras, images=load_images(folder / "photos", cameras))
    initial, num_filled = first_splats(scene, views, config)
    emit(Decided(decision=_fill_decision(stage, num_filled, len(scene.points))))
    result = fit_splats(initial, views, config, _fit_options(stage, task["backend"], emit))
    save_splats(folder / "model.safetensors", result.splats)
    summary = {**_training_summary(result), "num_photographs": len(cameras), "num_points": len(scene.points)}
    write_json(folder / "summary.json", summary)
    return ["model.safetensors", "summary.json"]


def run_edge(folder: Path, stage: str, emit: Emit) -> Sequence[str]:
    """Join the devices' models by retraining on what each shows at its own cameras."""
    from radiant_core.aggregate.config import AggregateConfig
    from radiant_core.aggregate.retrain import retrain_on_synthetic_views
    from radiant_core.train.config import TrainConfig

    task = read_json(folder / "task.json")
    inbox = [folder / "inbox" / name for name in task["devices"]]
    models = [load_splats(place / "model.safetensors") for place in inbox]
    cameras = [load_cameras(place / "cameras.safetensors") for place in inbox]
    if len(models) == 1:
        emit(Decided(decision=_single_device_decision(stage)))
    options = _fit_options(stage, task["backend"], emit)
    result = retrain_on_synthetic_views(models, cameras, TrainConfig(**task["train"]), AggregateConfig(**task["aggregate"]), options)
    save_splats(folder / "model.safetensors", result.splats)
    write_json(folder / "summary.json", {**_training_summary(result), "num_models": len(models)})
    return ["model.safetensors", "summary.json"]


def run_cloud(folder: Path, stage: str, emit: Emit) -> Sequence[str]:
    """Join the edges' models by cutting them at the plan's borders."""
    from radiant_core.aggregate.crop_merge import crop_merge

    task = read_json(folder / "task.json")
    models = [load_splats(folder / "inbox" / name / "model.safetensors") for name in task["edges"]]
    merged = crop_merge(models, np.array(task["sites"]), np.array(task["weights"]))
    share = merged.num_filled / max(1, len(merged.splats))
    emit(
        Decided(
            decision=Decision(
                stage=stage,
                topic="blind spots",
                choice=f"kept {merged.num_filled:,} Gaussians outside their own region and dropped {merged.num_dropped:,}",
                figure=100 * share,
                unit="% of the scene",
                reason="the owner of that place has no Gaussian near it",
            )
        )
    )
    save_ply(folder / "scene.ply", merged.splats)
    counts = {"num_splats": len(merged.splats), "num_filled": merged.num_filled, "num_dropped": merged.num_dropped}
    write_json(folder / "summary.json", counts)
    return ["scene.ply", "summary.json"]


def place_of(images: Path, folder: Path) -> str:
    """The images' folder relative to `folder` where it lies inside, so that a run can be moved; absolute otherwise."""
    images, folder = images.resolve(), folder.resolve()
    return str(images.relative_to(folder) if images.is_relative_to(folder) else images)


def load_images(folder: Path, cameras: Cameras) -> tuple[NDArray[np.uint8], ...]:
    """The photographs (H,W,3) of `cameras` by name, reduced to the cameras' sizes."""
    return tuple(
        (load_photograph(folder / name, (int(width), int(height))) * 255).round().astype(np.uint8)
        for name, (width, height) in zip(cameras.names, cameras.sizes_wh, strict=True)
    )


def _fit_options(stage: str, backend: Any, emit: Emit):  # noqa: ANN202 - FitOptions, imported late for a quick start
    from radiant_core.train.trainer import FitOptions

    def report(progress: Any) -> None:
        emit(StageProgress(stage=stage, done=progress.step, total=progress.num_steps, note=f"loss {progress.loss:.4f}"))

    return FitOptions(backend=backend, report=report)


def _training_summary(result: Any) -> dict[str, float | int]:
    return {
        "num_splats": len(result.splats),
        "model_bytes": result.splats.num_bytes,
        "num_steps": result.num_steps,
        "train_s": result.seconds,
        "first_loss": result.first_loss,
        "last_loss": result.last_loss,
    }


def _sfm_progress(stage: str, progress: Any) -> StageProgress:
    return StageProgress(stage=stage, done=progress.done, total=progress.total, note=progress.phase)


def _sky_decision(stage: str, share: float) -> Decision:
    from radiant_core.train.initialize import MIN_SKY_SHARE

    looks_up = share >= MIN_SKY_SHARE
    return Decision(
        stage=stage,
        topic="sky",
        choice="Gaussians on a far half sphere were added" if looks_up else "no sky was added",
        figure=100 * share,
        unit="% above the horizon in the image that has most",
        reason=f"a sky is modelled from {100 * MIN_SKY_SHARE:.0f} % of one image on",
    )


def _fill_decision(stage: str, num_filled: int, num_points: int) -> Decision:
    return Decision(
        stage=stage,
        topic="fill-in points",
        choice=f"{num_filled:,} points were added to {num_points:,} sparse ones",
        figure=float(num_filled),
        unit="image cells without a sparse point",
        reason="places without sparse points would start empty",
    )


def _single_device_decision(stage: str) -> Decision:
    return Decision(
        stage=stage,
        topic="retraining",
        choice="skipped",
        figure=1.0,
        unit="device models",
        reason="a single model would only learn from its own pictures",
    )
