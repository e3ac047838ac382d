"""What a worker does in its folder: read a message, call one function, write its answer. One function per kind of node.

| kind     | reads                                               | writes                                   |
|----------|-----------------------------------------------------|------------------------------------------|
| sfm      | task.json, the source it names                      | scene.safetensors, result.json, undistorted/ |
| device   | task.json, scene.safetensors, photos/, masks/       | model.safetensors, upload.safetensors (unless float32), summary.json |
| teacher  | task.json, inbox/{model,cameras}.safetensors        | views/<number>.safetensors               |
| edge     | task.json, inbox/<device>/{model,cameras}.safetensors, teachers/<device>/ | as device, virtual_{cameras,views}.safetensors |
| cloud    | task.json, inbox/<edge>/{model,virtual_cameras,virtual_views}.safetensors | scene.ply, summary.json |
| evaluate | task.json, scene.ply, plan.json, photos/ …          | result.json, renders/, photographs/, differences/ |

`field_nodes.py` has those of devices that place their own photographs. Each reads only files below its folder.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from radiant_app.events import Decided, Event, Warned
from radiant_app.workers.delivering import is_of_a_run, refusals, signed_upload
from radiant_app.workers.own_names import own_names
from radiant_app.workers.reporting import Emit, EventReporter
from radiant_app.workers.tasks import TASKS, SfmTask, TeacherTask, received_task
from radiant_app.workers.training import MASKS, finished_device, machine_in, remove_checkpoints, trained_device
from radiant_core.errors import BadInput
from radiant_core.io.records import save_scene
from radiant_core.io.run_store import SEAL_NAME, write_json

if TYPE_CHECKING:
    from radiant_core.hierarchy.messages import CloudTask, DeviceTask, EdgeTask

CUT_NAME = "cut_for_memory"
"""An empty file in the cloud's folder: its models are cut because its machine had too little memory."""

Work = Callable[[Path, Any, EventReporter], Sequence[str]]
"""What a kind of node does in its folder with its task; the names of the files it made, relative to the folder."""


def run_node(kind: str, folder: Path, stage: str, emit: Emit, work: Work | None = None) -> Sequence[str]:
    """Run one node and return the names of the files it made; decisions and warnings also go to notes.json.

    What a device reports of photographs of its own names none of their files. `work` is what the node does, where that is
    not one of this room's functions.
    """
    if kind not in TASKS:
        raise BadInput(f"worker kind {kind!r} is unknown: use one of {', '.join(TASKS)}.")
    notes: dict[str, list[Any]] = {"decisions": [], "warnings": []}
    names = own_names(kind, folder)

    def emit_and_note(event: Event) -> None:
        event = names.without_in(event)
        if isinstance(event, Decided):
            notes["decisions"].append(asdict(event.decision))
        elif isinstance(event, Warned):
            notes["warnings"].append(event.message)
        emit(event)

    outputs = (work or _work_of(kind))(folder, received_task(kind, folder), EventReporter(stage=stage, emit=emit_and_note))
    write_json(folder / "notes.json", notes)
    return [*outputs, "notes.json"]


def _work_of(kind: str) -> Work:
    """What nodes of a kind do; imports no more than that needs: most nodes are short, and starting a process is most of their time."""
    if kind in ("positions", "field", "score"):
        from radiant_app.workers.field_nodes import run_field, run_positions, run_score

        return {"positions": run_positions, "field": run_field, "score": run_score}[kind]
    if kind == "regions":
        from radiant_app.workers.regions import run_regions

        return run_regions
    if kind == "evaluate":
        from radiant_app.workers.evaluation import run_evaluate

        return run_evaluate
    return {"sfm": run_sfm, "device": run_device, "teacher": run_teacher, "edge": run_edge, "cloud": run_cloud}[kind]


def run_sfm(folder: Path, task: SfmTask, reporter: EventReporter) -> Sequence[str]:
    """Structure from motion on the source that the task names."""
    from radiant_app.workers.sources import reconstruct_source, sfm_record

    result = reconstruct_source(task, folder, reporter.sfm_progress)
    for decision in result.decisions:
        reporter.emit(Decided(decision=decision))
    for message in result.warnings:
        reporter.warn(message)
    save_scene(folder / "scene.safetensors", result.scene)
    write_json(folder / "result.json", sfm_record(result, folder))
    # Images that were pinhole already stay where they are, outside of this folder: they are the owner's and not sealed.
    own = [path for name in ("undistorted", MASKS) for path in sorted((folder / name).rglob("*")) if path.is_file()]
    return ["scene.safetensors", "result.json", *(str(path.relative_to(folder)) for path in own)]


def run_device(folder: Path, task: DeviceTask, reporter: EventReporter) -> Sequence[str]:
    """Train one model from the folder's own photographs and points."""
    model = trained_device(folder, task, folder / "photos", reporter)
    return finished_device(folder, task, model, reporter)


def run_teacher(folder: Path, task: TeacherTask, reporter: EventReporter) -> Sequence[str]:
    """Render what one device's model shows at its cameras, for the retraining of its edge; may be stopped at any time.

    What its edge refuses it does not render: the edge says why.
    """
    from radiant_app.workers.inbox import teacher_view_name
    from radiant_core.aggregate.synthetic_views import views_in_bytes
    from radiant_core.hierarchy.joining import model_problem
    from radiant_core.hierarchy.messages import DeviceModel
    from radiant_core.io.messages import load_device_model
    from radiant_core.io.view_file import save_view

    if is_of_a_run(folder) and refusals(folder, [folder.name], {folder.name: folder / "inbox"}):
        return []
    model = load_device_model(folder / "inbox")
    if not isinstance(model, DeviceModel) or model_problem(model, task.num_dealt):
        return []
    cameras = model.cameras.scaled(task.long_side_px)
    (folder / "views").mkdir(exist_ok=True)
    names = []
    for name, (image, weight) in zip(cameras.names, views_in_bytes(model.splats, cameras, task.backend), strict=True):
        names.append(teacher_view_name(len(names)))
        save_view(folder / names[-1], image, weight)
        reporter.progress(len(names), len(cameras), name)
    return names


def run_edge(folder: Path, task: EdgeTask, reporter: EventReporter) -> Sequence[str]:
    """Join the devices' models, or pool them for the cloud."""
    from radiant_app.workers.inbox import received_device_models, save_arrivals
    from radiant_core.hierarchy.edge import join_edge
    from radiant_core.io.messages import save_edge_model

    models = received_device_models(folder, task)
    model = join_edge(task, models, reporter, machine_in(folder, task.checkpoint_every_s, reporter))
    names = [
        *save_edge_model(folder, model, task.upload, reporter.warn),
        *save_arrivals(folder, model.corrections, model.refused, model.uncertainty),
    ]
    remove_checkpoints(folder)
    return names if model.splats is None else [*names, *signed_upload(folder)]


def run_cloud(folder: Path, task: CloudTask, reporter: EventReporter) -> Sequence[str]:
    """Join the edges' models into the scene."""
    from radiant_app.workers.inbox import received_edge_models, save_arrivals
    from radiant_core.hierarchy.cloud import join_cloud
    from radiant_core.io.messages import NOTHING
    from radiant_core.io.ply import save_ply

    models = received_edge_models(folder, task.edges, task.train.long_side_px)
    (folder / CUT_NAME).unlink(missing_ok=True)
    scene = join_cloud(task, models, reporter, machine_in(folder, task.checkpoint_every_s, reporter))
    names = ["summary.json", *save_arrivals(folder, scene.corrections, scene.refused, scene.uncertainty)]
    write_json(folder / "summary.json", dict(scene.summary) if scene.splats is not None else {**NOTHING, "num_models": 0})
    if scene.splats is None:
        return names
    if scene.cut_for_memory:
        (folder / CUT_NAME).touch()
    save_ply(folder / "scene.ply", scene.splats)
    remove_checkpoints(folder)
    return ["scene.ply", *names]


def forget_cut(folder: Path) -> None:
    """Unseal a cloud that cut its models for want of its machine's memory: there may be more by now."""
    if (folder / CUT_NAME).is_file():
        (folder / SEAL_NAME).unlink(missing_ok=True)
