"""One function per kind of node: read a message, call one function of the hierarchy, write its
result.

Each reads task.json, and beside it, below its folder:

    sfm      the source that its task names
             → scene.safetensors, result.json, captures.json, undistorted/
    device   scene.safetensors, photos/, masks/
             → model.safetensors, upload.safetensors (unless float32), summary.json
    edge     inbox/<device>/{model,cameras}.safetensors; none where devices train together
             → as device, virtual_cameras.safetensors
    cloud    inbox/<edge>/{model,virtual_cameras}.safetensors
             → scene.ply, summary.json, cut/scene.ply
    refine   scene.ply; in the folder above scene.safetensors, model.safetensors, photos/, masks/
             → refined.safetensors, rows.safetensors
    average  scene.ply, inbox/<device>/{refined,rows}.safetensors
             → as refine
    finish   scene.ply, kept/scene.ply, inbox/<edge>/{refined,rows}.safetensors
             → refined/scene.ply, refined/next/scene.ply
    score    inbox/{scene.ply,plan.json,joined.ply,cut.ply}, {held_out,initial}.safetensors,
             own.json, photos/, masks/, of a device all but the inbox in the folder above
             → scores.json, renders/, photographs/, differences/

`field_nodes.py` has those of devices that place their own photographs, `own_photographs.py` those
whose photographs nobody else has heard of.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from radiant_app.events import Decided, Event, Warned
from radiant_app.reporting import Emit, EventReporter
from radiant_app.workers.delivering import sign_upload
from radiant_app.workers.redaction import make_redactor
from radiant_app.workers.tasks import TASKS, SfmTask, receive_task
from radiant_app.workers.training import MASKS, make_machine, remove_checkpoints, save_signed_model, train_from_folder
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.io.records import save_scene
from radiant_core.io.run_store import SEAL_NAME, write_json

if TYPE_CHECKING:
    from radiant_core.hierarchy.messages import CloudTask, DeviceTask, EdgeTask

CUT_NAME = "cut_for_memory"
"""Empty file in the cloud's folder: models were cut because its machine had too little memory."""
CUT_SCENE = "cut/scene.ply"
"""The scene as it would be without joining, where the cloud fitted it or leaves that to devices."""

Work = Callable[[Path, Any, EventReporter], Sequence[str]]
"""The work of a kind of node in its folder with its task; returns the names of its files."""


def run_node(kind: str, folder: Path, stage: str, emit: Emit, work: Work | None = None) -> Sequence[str]:
    """Run one node and return the names of the files it made; decisions and warnings also go to
    notes.json.

    Events of a device with photographs of its own name none of their files. `work` replaces the
    function of this kind.
    """
    if kind not in TASKS:
        raise BadInput(f"worker kind {kind!r} is unknown: use one of {', '.join(TASKS)}.")
    notes: dict[str, list[Any]] = {"decisions": [], "warnings": []}
    names = make_redactor(kind, folder)

    def emit_and_note(event: Event) -> None:
        event = names.redact_event(event)
        if isinstance(event, Decided):
            notes["decisions"].append(asdict(event.decision))
        elif isinstance(event, Warned):
            notes["warnings"].append(event.message)
        emit(event)

    reporter = EventReporter(stage=stage, emit=emit_and_note)
    task = _with_renderer_here(receive_task(kind, folder), reporter)
    outputs = (work or _import_work(kind))(folder, task, reporter)
    write_json(folder / "notes.json", notes)
    return [*outputs, "notes.json"]


def _with_renderer_here(task: Any, reporter: EventReporter) -> Any:
    """The task as it is; for gsplat without a CUDA device, with the CPU's renderer and a decision.

    Raises:
        BadInput: its machine trains one model with others, whose steps are the same bits.
    """
    if getattr(task, "backend", None) != "gsplat":
        return task
    from radiant_core.hierarchy.messages import EdgeTask
    from radiant_core.render.gsplat_backend import missing_for_gsplat

    missing = missing_for_gsplat()
    if missing is None:
        return task
    group = getattr(task, "group", None)
    if isinstance(task, EdgeTask) and group is not None and group.has_relays:
        return task  # It has no model.
    if group is not None or getattr(task, "seat", None) is not None:
        raise BadInput(
            f"this machine trains one model with others on CUDA and has {missing}: add --within-edge joined --between-edges joined, "
            "or leave the machine out of the system file."
        )
    reporter.decide(
        Decision(
            stage=reporter.stage,
            topic="renderer",
            choice="native, on the CPU",
            figure=None,
            unit="",
            reason=f"the run renders on CUDA devices, and this machine has {missing}",
        )
    )
    return replace(task, backend="native")


def _import_work(kind: str) -> Work:
    """Import the function of a kind of node alone: a short node spends its time on starting."""
    if kind in ("positions", "field"):
        from radiant_app.workers.field_nodes import run_field, run_positions

        return {"positions": run_positions, "field": run_field}[kind]
    if kind in ("count", "raster", "own_field"):
        from radiant_app.workers.own_photographs import run_count, run_own_field, run_raster

        return {"count": run_count, "raster": run_raster, "own_field": run_own_field}[kind]
    if kind == "regions":
        from radiant_app.workers.regions import run_regions

        return run_regions
    if kind in ("refine", "average", "finish"):
        from radiant_app.workers.refining import run_average, run_finish, run_refine

        return {"refine": run_refine, "average": run_average, "finish": run_finish}[kind]
    if kind == "score":
        from radiant_app.workers.evaluation import run_score

        return run_score
    return {"sfm": run_sfm, "device": run_device, "edge": run_edge, "cloud": run_cloud}[kind]


def run_sfm(folder: Path, task: SfmTask, reporter: EventReporter) -> Sequence[str]:
    """Structure from motion on the source that the task names."""
    from radiant_app.workers.sources import photographs_of_task, reconstruct_source, save_given_frames, sfm_record
    from radiant_core.light.captures import read_captures, save_captures

    result = reconstruct_source(task, folder, reporter.sfm_progress)
    for decision in result.decisions:
        reporter.emit(Decided(decision=decision))
    for message in result.warnings:
        reporter.warn(message)
    save_scene(folder / "scene.safetensors", result.scene)
    write_json(folder / "result.json", sfm_record(result, folder))
    frame_files = save_given_frames(folder, result)
    # What is undistorted has lost its EXIF.
    captures = save_captures(folder, read_captures(photographs_of_task(task, folder), result.scene.cameras.names))
    # Images that were pinhole already stay outside this folder and are not sealed.
    own_files = [path for name in ("undistorted", "readable", MASKS) for path in sorted((folder / name).rglob("*")) if path.is_file()]
    return ["scene.safetensors", "result.json", *frame_files, captures, *(str(path.relative_to(folder)) for path in own_files)]


def run_device(folder: Path, task: DeviceTask, reporter: EventReporter) -> Sequence[str]:
    """Train one model from the folder's own photographs and points."""
    model = train_from_folder(folder, task, folder / "photos", reporter)
    return save_signed_model(folder, task, model, reporter)


def run_edge(folder: Path, task: EdgeTask, reporter: EventReporter) -> Sequence[str]:
    """Join the devices' models, or train one with them."""
    from radiant_app.workers.inbox import receive_device_models, save_joining
    from radiant_core.hierarchy.codec import save_edge_model
    from radiant_core.hierarchy.edge import join_edge

    if task.group is not None:
        from radiant_app.workers.groups import run_group_edge

        return run_group_edge(folder, task, task.group, reporter)

    models = receive_device_models(folder, task.devices)
    (folder / CUT_NAME).unlink(missing_ok=True)
    model = join_edge(task, models, reporter, make_machine(folder, task, reporter))
    names = [
        *save_edge_model(folder, model, task.upload, reporter.warn),
        *save_joining(folder, model.corrections, model.refused, model.uncertainty),
    ]
    if model.cut_for_memory:
        (folder / CUT_NAME).touch()
    remove_checkpoints(folder)
    return names if model.splats is None else [*names, *sign_upload(folder)]


def run_cloud(folder: Path, task: CloudTask, reporter: EventReporter) -> Sequence[str]:
    """Join the edges' models into the scene, or train it with all devices."""
    if task.group is not None:
        from radiant_app.workers.groups import run_group_cloud

        return run_group_cloud(folder, task, task.group, reporter)
    from radiant_app.workers.inbox import receive_edge_models, save_joining
    from radiant_core.hierarchy.cloud import join_cloud
    from radiant_core.hierarchy.codec import NOTHING
    from radiant_core.io.ply import save_ply

    models = receive_edge_models(folder, task.edges)
    for name in (CUT_NAME, CUT_SCENE):
        (folder / name).unlink(missing_ok=True)
    scene = join_cloud(task, models, reporter, make_machine(folder, task, reporter))
    names = ["summary.json", *save_joining(folder, scene.corrections, scene.refused, scene.uncertainty)]
    write_json(folder / "summary.json", dict(scene.summary) if scene.splats is not None else {**NOTHING, "num_models": 0})
    if scene.splats is None:
        return names
    if scene.cut_for_memory:
        (folder / CUT_NAME).touch()
    save_ply(folder / "scene.ply", scene.splats)
    if scene.cut is not None:
        (folder / CUT_SCENE).parent.mkdir(exist_ok=True)
        save_ply(folder / CUT_SCENE, scene.cut)
        names.append(CUT_SCENE)
    remove_checkpoints(folder)
    return ["scene.ply", *names]


def unseal_cut(folder: Path) -> None:
    """Unseal an edge or a cloud that cut its models for lack of memory: more may be free by now."""
    if (folder / CUT_NAME).is_file():
        (folder / SEAL_NAME).unlink(missing_ok=True)
