"""What a worker computes in its folder: one function per kind of node. Each reads only files below the folder it is given.

| kind     | reads                                               | writes                                   |
|----------|-----------------------------------------------------|------------------------------------------|
| sfm      | task.json, the source it names                      | scene.safetensors, result.json, undistorted/ |
| device   | task.json, scene.safetensors, photos/, masks/       | model.safetensors, upload.safetensors (unless float32), summary.json |
| teacher  | task.json, inbox/{model,cameras}.safetensors        | views/<number>.safetensors               |
| edge     | task.json, inbox/<device>/{model,cameras}.safetensors, teachers/<device>/ | as device, virtual_{cameras,views}.safetensors |
| cloud    | task.json, inbox/<edge>/{model,virtual_cameras,virtual_views}.safetensors | scene.ply, summary.json |
| evaluate | task.json, scene.ply, plan.json, photos/ …          | result.json, renders/, photographs/, differences/ |
| run      | task.json, a whole run's source                     | that run's folder: a job of a batch      |
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from radiant_app.events import Decided, Event, StageProgress, Warned
from radiant_app.workers.cloud_task import (
    CUT_COSTS,
    JOIN_AGAIN,
    edge_pools,
    exposures_decision,
    faint_decision,
    join_decisions,
    joined_at_cloud,
    virtual_cameras_of,
)
from radiant_app.workers.delivering import refusals, signed_upload
from radiant_app.workers.inbox import NOTHING, VIRTUAL_CAMERAS, VIRTUAL_VIEWS, Inbox, dealt_to, read_inbox, save_frames, too_many_cameras
from radiant_app.workers.memory import base_bytes_in, resident_bytes
from radiant_app.workers.node_decisions import (
    blind_spots_decision,
    density_decision,
    fill_decision,
    join_memory_decision,
    shapes_decision,
    sky_decision,
    teachers_decision,
)
from radiant_app.workers.own_names import own_names
from radiant_core import __version__
from radiant_core.cameras import Cameras
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.io.photos.listing import load_photograph
from radiant_core.io.photos.masks import pixel_weights
from radiant_core.io.ply import save_ply
from radiant_core.io.records import load_cameras, load_scene, save_cameras, save_scene, save_splats
from radiant_core.io.run_store import content_key, read_json, write_json
from radiant_core.io.transport.upload import UploadFormat, save_upload, upload_problem
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats, morton_order

if TYPE_CHECKING:
    from radiant_core.aggregate.synthetic_views import Rendered
    from radiant_core.sfm.config import SfmProgress
    from radiant_core.train.checkpoint import CheckpointFolder
    from radiant_core.train.config import TrainConfig
    from radiant_core.train.trainer import FitOptions, TrainResult
    from radiant_core.train.views import TrainingViews

Emit = Callable[[Event], None]
CHECKPOINTS = "checkpoints"
"""Folder of a training's checkpoints inside its node's; gone when the node is done."""
CHECKPOINT_EVERY_S = 10.0
UNKEYED = ("teachers", "checkpoint_every_s")
"""What a task.json says that changes no bit of the result: who rendered a view, how often a training is saved."""
_OTHER_KINDS = ("positions", "field", "score", "regions", "evaluate", "run")
MASKS = "masks"
"""Folder of masks beside a node's photographs, where there are any."""


def run_node(kind: str, folder: Path, stage: str, emit: Emit) -> Sequence[str]:
    """Run one node and return the names of the files it made, relative to `folder`; decisions and warnings also go to notes.json.

    What a device says of photographs of its own is told without their names.
    """
    runner = _runner_of(kind)
    notes: dict[str, list[Any]] = {"decisions": [], "warnings": []}
    names = own_names(kind, folder)

    def emit_and_note(event: Event) -> None:
        event = names.without_in(event)
        if isinstance(event, Decided):
            notes["decisions"].append(asdict(event.decision))
        elif isinstance(event, Warned):
            notes["warnings"].append(event.message)
        emit(event)

    outputs = runner(folder, stage, emit_and_note)
    write_json(folder / "notes.json", notes)
    return [*outputs, "notes.json"]


def _runner_of(kind: str) -> Callable[[Path, str, Emit], Sequence[str]]:
    """What runs nodes of a kind; imports no more than that needs: most nodes are short, and starting a process is most of their time."""
    own = {"sfm": run_sfm, "device": run_device, "teacher": run_teacher, "edge": run_edge, "cloud": run_cloud}
    if kind in own:
        return own[kind]
    if kind in ("positions", "field", "score"):
        from radiant_app.workers.field_nodes import run_field, run_positions, run_score

        return {"positions": run_positions, "field": run_field, "score": run_score}[kind]
    if kind == "regions":
        from radiant_app.run.cloud_planning import run_regions

        return run_regions
    if kind == "evaluate":
        from radiant_app.workers.evaluation import run_evaluate

        return run_evaluate
    if kind == "run":
        from radiant_app.commands.batch import run_job

        return run_job
    raise BadInput(f"worker kind {kind!r} is unknown: use one of {', '.join((*own, *_OTHER_KINDS))}.")


def read_notes(folder: Path, stage: str) -> list[Event]:
    """The decisions and warnings that a finished node left behind."""
    notes = read_json(folder / "notes.json", ("decisions", "warnings"))
    decided = [Decided(decision=Decision(**fields)) for fields in notes["decisions"]]
    return [*decided, *(Warned(stage=stage, message=message) for message in notes["warnings"])]


def run_sfm(folder: Path, stage: str, emit: Emit) -> Sequence[str]:
    """Structure from motion on the source that task.json names."""
    from radiant_app.run.sources import reconstruct_source

    task = read_json(folder / "task.json")
    result = reconstruct_source(task, folder, lambda progress: emit(sfm_progress(stage, progress)))
    for decision in result.decisions:
        emit(Decided(decision=decision))
    for message in result.warnings:
        emit(Warned(stage=stage, message=message))
    save_scene(folder / "scene.safetensors", result.scene)
    write_json(folder / "result.json", sfm_record(result, folder))
    # Images that were pinhole already stay where they are, outside of this folder: they are the owner's and not sealed.
    own = [path for name in ("undistorted", "masks") for path in sorted((folder / name).rglob("*")) if path.is_file()]
    return ["scene.safetensors", "result.json", *(str(path.relative_to(folder)) for path in own)]


def run_device(folder: Path, stage: str, emit: Emit) -> Sequence[str]:
    """Train one model from the folder's own photographs and points."""
    task = read_json(folder / "task.json", ("train", "backend", "upload"))
    scene = load_scene(folder / "scene.safetensors")
    outputs = train_device(folder, scene, folder / "photos", task, (stage, emit))[1]
    save_cameras(folder / "cameras.safetensors", scene.cameras)
    return [*outputs, "cameras.safetensors", *signed_upload(folder, task)]


def train_device(folder: Path, scene: SfmScene, images: Path, task: dict[str, Any], running: tuple[str, Emit]) -> tuple[Splats, list[str]]:
    """Train a model from a scene and its photographs by the settings of a task; `running` is stage and listener.

    Returns the Gaussians before training and the names of the files written.
    """
    from radiant_core.train.checkpoint import training_key
    from radiant_core.train.config import TrainConfig
    from radiant_core.train.memory import memory_plan, within_memory

    stage, emit = running
    config, options = TrainConfig(**task["train"]), fit_options(stage, task["backend"], emit)
    cameras = scene.cameras.scaled(config.long_side_px)
    if task["memory_bytes"] is not None:
        base_bytes = base_bytes_in(folder, resident_bytes())
        plan = memory_plan(config, cameras, int(task["memory_bytes"]), base_bytes, masked=(folder / MASKS).is_dir())
        config, decision = within_memory(config, plan, int(task["memory_bytes"]), stage, config.max_num_splats)
        emit(Decided(decision=decision))
        options = replace(options, statistics_bytes=plan.statistics_bytes)
    views = load_training_views(images, cameras, folder / MASKS)
    scene, views = without_useless(scene, views, config, running)
    config = needed(scene, views, config, task["backend"], running)
    initial = first_model(scene, views, config, running)
    checkpoints = checkpoints_in(folder, training_key(initial, views, config, options), task, running)
    result = fit(initial, views, config, replace(options, checkpoints=checkpoints), running)
    save_splats(folder / "model.safetensors", result.splats)
    summary = {**training_summary(result), "num_photographs": len(views), "num_points": len(scene.points)}
    write_json(folder / "summary.json", summary)
    uploaded = _save_upload(folder, result.splats, task["upload"], stage, emit)
    checkpoints.remove()
    return initial, ["model.safetensors", "summary.json", *uploaded]


def checkpoints_in(folder: Path, key: str, task: Mapping[str, Any], running: tuple[str, Emit]) -> CheckpointFolder:
    """Checkpoints of the training with this key in a node's folder, without those that an older plan or other settings left there."""
    from radiant_core.train.checkpoint import CheckpointFolder

    stage, emit = running
    checkpoints = CheckpointFolder(
        folder / CHECKPOINTS,
        key,
        every_s=task.get("checkpoint_every_s", CHECKPOINT_EVERY_S),
        warn=lambda message: emit(Warned(stage=stage, message=message)),
    )
    checkpoints.remove_foreign()
    return checkpoints


def without_useless(
    scene: SfmScene, views: TrainingViews, config: TrainConfig, running: tuple[str, Emit]
) -> tuple[SfmScene, TrainingViews]:
    """Scene and views without the photographs that add nothing; tells which were left out."""
    from radiant_core.train.worth import worth_training

    stage, emit = running
    scene, views, decisions = worth_training(scene, views, config)
    for decision in decisions:
        emit(Decided(decision=replace(decision, stage=stage)))
    return scene, views


def needed(scene: SfmScene, views: TrainingViews, config: TrainConfig, backend: Any, running: tuple[str, Emit]) -> TrainConfig:
    """The configuration as this scene needs it and a CUDA device can hold it; tells what was decided."""
    from radiant_core.render.contract import resolve_backend
    from radiant_core.render.gsplat_backend import free_vram_bytes
    from radiant_core.train.memory import within_vram
    from radiant_core.train.needs import fit_to_scene

    stage, emit = running
    config, decisions = fit_to_scene(config, scene, views)
    free_bytes = free_vram_bytes(resolve_backend(backend))
    if free_bytes is not None:
        config, more = within_vram(config, views.cameras, free_bytes, stage)
        decisions = (*decisions, *more)
    for decision in decisions:
        emit(Decided(decision=replace(decision, stage=stage)))
    return config


def first_model(scene: SfmScene, views: TrainingViews, config: TrainConfig, running: tuple[str, Emit]) -> Splats:
    """The Gaussians before training; tells what was added to the sparse points and why."""
    from radiant_core.train.initialize import first_splats, sky_share

    stage, emit = running
    emit(Decided(decision=sky_decision(stage, sky_share(views.cameras), wanted=config.sky)))
    initial, num_filled = first_splats(scene, views, config)
    emit(Decided(decision=fill_decision(stage, num_filled, len(scene.points), wanted=config.fill_in)))
    return initial


def fit(initial: Splats, views: TrainingViews, config: TrainConfig, options: FitOptions, running: tuple[str, Emit]) -> TrainResult:
    """`fit_splats`; tells what density control did and which steps could not be taken."""
    from radiant_core.train.trainer import fit_splats

    stage, emit = running
    result = fit_splats(initial, views, config, options)
    if config.densify != "none":
        emit(Decided(decision=density_decision(stage, result.density, len(initial), len(result.splats))))
    if any(asdict(result.shapes).values()):
        emit(Decided(decision=shapes_decision(stage, config, result.shapes)))
    if result.num_rolled_back:
        message = f"{result.num_rolled_back} of {result.num_steps:,} steps ended in something not finite and were not taken"
        emit(Warned(stage=stage, message=message))
    return result


def run_teacher(folder: Path, stage: str, emit: Emit) -> Sequence[str]:
    """Render what one device's model shows at its cameras, for the retraining of its edge; may be stopped at any time."""
    from radiant_core.aggregate.arrival import load_arrived
    from radiant_core.aggregate.synthetic_views import views_in_bytes
    from radiant_core.io.view_file import save_view

    task = read_json(folder / "task.json", ("long_side_px", "backend"))
    if task.get("signed") and refusals(folder, [folder.name], {folder.name: folder / "inbox"}):
        # Its edge refuses it too, and says why.
        return []
    cameras = load_cameras(folder / "inbox" / "cameras.safetensors").scaled(task["long_side_px"])
    if too_many_cameras(cameras, task.get("num_dealt")):
        # Its edge refuses it too, and says why.
        return []
    model = load_arrived(folder / "inbox" / "model.safetensors", cameras)
    if isinstance(model, str):
        # Its edge refuses it too, and says why.
        return []
    (folder / "views").mkdir(exist_ok=True)
    names = []
    for name, (image, weight) in zip(cameras.names, views_in_bytes(model, cameras, task["backend"]), strict=True):
        names.append(_view_name(len(names)))
        save_view(folder / names[-1], image, weight)
        emit(StageProgress(stage=stage, done=len(names), total=len(cameras), note=name))
    return names


def run_edge(folder: Path, stage: str, emit: Emit) -> Sequence[str]:
    """Join the devices' models by retraining on what each shows at its own cameras, or leave that to the cloud."""
    from radiant_core.aggregate.balance import balanced, exposure_balance
    from radiant_core.aggregate.config import AggregateConfig
    from radiant_core.aggregate.ownership import claims_of_polygons
    from radiant_core.aggregate.pooling import pictures_of, pooled
    from radiant_core.aggregate.retrain import cut_at_borders, retrain_on_synthetic_views
    from radiant_core.aggregate.synthetic_views import Teacher
    from radiant_core.io.view_file import save_views
    from radiant_core.train.config import TrainConfig

    task = read_json(folder / "task.json")
    signed, dealt = task.get("signed", False), dealt_to(task["devices"], task)
    inbox = read_inbox(folder, task["devices"], stage, emit, signed=signed, dealt=dealt)
    if not inbox.models:
        return _nothing_placed(folder, inbox)
    train, aggregate = TrainConfig(**task["train"]), AggregateConfig(**task["aggregate"])
    left = edge_pools(task, inbox, stage)
    # A device's model shows the same at its own cameras wherever both were moved to.
    rendered = [
        load_views(folder / "teachers" / name, own.scaled(train.long_side_px)) if name in task["teachers"] else {}
        for name, own in zip(inbox.senders, inbox.cameras, strict=True)
    ]
    if len(inbox.models) > 1 and left is None:
        emit(Decided(decision=teachers_decision(stage, rendered, inbox.cameras)))
    checkpoints = checkpoints_in(folder, _inbox_key(folder, task), task, (stage, emit))
    options = replace(fit_options(stage, task["backend"], emit), checkpoints=checkpoints)
    strips = [np.array(task["strips"][task["devices"].index(name)]).reshape(-1, 2) for name in inbox.senders]
    asked = zip(inbox.models, inbox.cameras, rendered, strict=True)
    teachers = [Teacher(splats=model, cameras=own, rendered=ready) for model, own, ready in asked]
    claims = claims_of_polygons(strips)
    if left is not None:
        balance = exposure_balance(teachers, task["backend"])
        teachers = balanced(teachers, balance)
        joined = pooled(teachers, aggregate, claims)
        decisions = [exposures_decision(stage, balance), faint_decision(stage, aggregate, joined), left]
    elif (kept := _edge_statistics_bytes(inbox, train, task.get("memory_bytes"), (stage, emit))) is None:
        joined, decisions = cut_at_borders(teachers, claims), []
    else:
        options = replace(options, statistics_bytes=kept)
        joined = retrain_on_synthetic_views(teachers, train, aggregate, options, claims)
        decisions = join_decisions(stage, aggregate, len(inbox.models), joined)
    for decision in decisions:
        emit(Decided(decision=decision))
    result = joined.trained
    # Along a Z curve the order of the Gaussians no longer says how many devices there were and which is whose.
    splats = result.splats.select(morton_order(result.splats.means))
    save_splats(folder / "model.safetensors", splats)
    write_json(folder / "summary.json", {**training_summary(result), "num_models": len(inbox.models)})
    virtual, near = virtual_cameras_of(folder, inbox.cameras, splats)
    save_cameras(folder / VIRTUAL_CAMERAS, virtual)
    shown = {} if left is None else pictures_of(teachers, virtual, near, train.long_side_px, task["backend"])
    save_views(folder / VIRTUAL_VIEWS, [shown[index] for index in sorted(shown)])
    uploaded = _save_upload(folder, splats, task["upload"], stage, emit)
    outputs = ["model.safetensors", "summary.json", VIRTUAL_CAMERAS, VIRTUAL_VIEWS, *save_frames(folder, inbox), *uploaded]
    checkpoints.remove()
    return [*outputs, *signed_upload(folder, task)]


def _edge_statistics_bytes(inbox: Inbox, train: TrainConfig, memory_bytes: float | None, running: tuple[str, Emit]) -> int | None:
    """What the loss may keep where the models in the inbox are retrained within the edge's limit of memory, with a decision; None where
    they are cut, with a warning."""
    from radiant_core.aggregate.cloud_choice import cloud_needs, kept_statistics_bytes
    from radiant_core.train.native_loss import STATISTICS_BUDGET_BYTES

    if memory_bytes is None or len(inbox.models) < 2:
        return STATISTICS_BUDGET_BYTES
    stage, emit = running
    left = kept_statistics_bytes(inbox.models, inbox.cameras, train.long_side_px, memory_bytes)
    needed_bytes = cloud_needs(inbox.models, inbox.cameras, train.long_side_px, None).memory_bytes
    decision = join_memory_decision(stage, needed_bytes, left, memory_bytes)
    emit(Decided(decision=decision))
    if left is None:
        allowed = f"memory_gb of this edge allows {memory_bytes / 1e6:,.0f} MB"
        lift = f"To join them raise it in the system file of the next run; or {JOIN_AGAIN}"
        message = f"{decision.choice}: {decision.reason}, and {allowed}. {CUT_COSTS} {lift}."
        emit(Warned(stage=stage, message=message))
    return left


def run_cloud(folder: Path, stage: str, emit: Emit) -> Sequence[str]:
    """Join the edges' models: retrained where that is asked for and within the limits, else cut at their borders."""
    from radiant_core.aggregate.config import AggregateConfig
    from radiant_core.aggregate.crop_merge import crop_merge

    task = read_json(folder / "task.json")
    aggregate = AggregateConfig(**task["aggregate"])
    signed, dealt = task.get("signed", False), dealt_to(task["edges"], task)
    inbox = read_inbox(folder, task["edges"], stage, emit, signed=signed, dealt=dealt)
    if not inbox.models:
        return _nothing_placed(folder, inbox)
    outputs = ["scene.ply", "summary.json", *save_frames(folder, inbox)]
    if aggregate.cloud == "retrain":
        checkpoints = checkpoints_in(folder, _inbox_key(folder, task), task, (stage, emit))
        options = replace(fit_options(stage, task["backend"], emit), checkpoints=checkpoints)
        joined = joined_at_cloud(folder, task, inbox, emit, options)
        if joined is not None:
            save_ply(folder / "scene.ply", joined.splats)
            write_json(folder / "summary.json", training_summary(joined.trained))
            checkpoints.remove()
            return outputs
    rows = [task["edges"].index(name) for name in inbox.senders]
    sites, weights = np.array(task["sites"])[rows], np.array(task["weights"])[rows]
    merged = crop_merge(inbox.models, sites, weights, fill_blind_spots=aggregate.fill_blind_spots)
    emit(Decided(decision=blind_spots_decision(stage, merged, wanted=aggregate.fill_blind_spots)))
    save_ply(folder / "scene.ply", merged.splats)
    counts = {"num_splats": len(merged.splats), "num_filled": merged.num_filled, "num_dropped": merged.num_dropped}
    write_json(folder / "summary.json", counts)
    return outputs


def _inbox_key(folder: Path, task: Mapping[str, Any]) -> str:
    """Key of a training on what was sent to this node: all of its task that can change a bit of the result."""
    return content_key(__version__, {name: value for name, value in task.items() if name not in UNKEYED}, folder / "inbox")


def _nothing_placed(folder: Path, inbox: Inbox) -> Sequence[str]:
    """What an edge or the cloud leaves when every model was refused: why."""
    write_json(folder / "summary.json", {**NOTHING, "num_models": 0})
    return ["summary.json", *save_frames(folder, inbox)]


def load_views(teacher: Path, cameras: Cameras) -> Rendered:
    """The views that a teacher has written for `cameras`, all or the first ones; raises as `load_view`."""
    from radiant_core.io.view_file import load_view

    sizes = {index: (int(width), int(height)) for index, (width, height) in enumerate(cameras.sizes_wh)}
    written = {index: size for index, size in sizes.items() if (teacher / _view_name(index)).exists()}
    return {index: load_view(teacher / _view_name(index), *size) for index, size in written.items()}


def sfm_record(result: Any, folder: Path) -> dict[str, Any]:
    """What result.json in `folder` says of an `SfmResult`: where photographs and masks are, which photographs have no pose."""
    masks = {} if result.masks_folder is None else {"masks": place_of(result.masks_folder, folder)}
    return {"images": place_of(result.undistorted_folder, folder), "unregistered": list(result.unregistered), **masks}


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


def load_training_views(images: Path, cameras: Cameras, masks: Path | None) -> TrainingViews:
    """The photographs of `cameras` by name with what masks leave of them, reduced to the cameras' sizes."""
    from radiant_core.train.views import TrainingViews

    return TrainingViews(cameras=cameras, images=load_images(images, cameras), weights=pixel_weights(masks, cameras))


def fit_options(stage: str, backend: Any, emit: Emit) -> FitOptions:
    """How a node's training renders and tells how far it is."""
    from radiant_core.train.trainer import FitOptions

    def report(progress: Any) -> None:
        emit(StageProgress(stage=stage, done=progress.step, total=progress.num_steps, note=f"loss {progress.loss:.4f}"))

    return FitOptions(backend=backend, report=report)


def _view_name(index: int) -> str:
    return f"views/{index:05d}.safetensors"


def _save_upload(folder: Path, splats: Splats, upload: UploadFormat, stage: str, emit: Emit) -> list[str]:
    """Write what is sent in place of model.safetensors, if it is not that file itself; the names written."""
    if upload == "float32":
        return []
    problem = upload_problem(splats, upload)
    if problem is not None:
        emit(Warned(stage=stage, message=f"the model is uploaded as float32 instead of {upload}: {problem}"))
    save_upload(folder / "upload.safetensors", splats, upload if problem is None else "float32")
    return ["upload.safetensors"]


def training_summary(result: Any) -> dict[str, float | int]:
    """What a node's summary.json keeps of a `TrainResult`."""
    return {
        "num_splats": len(result.splats),
        "model_bytes": result.splats.num_bytes,
        "num_steps": result.num_steps,
        "num_rolled_back": result.num_rolled_back,
        "train_s": result.seconds,
        "first_loss": result.first_loss,
        "last_loss": result.last_loss,
        **asdict(result.density),
        **asdict(result.shapes),
    }


def sfm_progress(stage: str, progress: SfmProgress) -> StageProgress:
    """An event of how far structure from motion is."""
    return StageProgress(
        stage=stage, done=progress.done, total=progress.total, phase=progress.phase, step=progress.step, num_steps=progress.num_steps
    )
