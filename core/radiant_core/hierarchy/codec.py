"""The codec of messages: all that crosses between nodes is written and read here. Once per message.

    a task       task.json, and files of the arrays that its fields name (`in_file`)
    DeviceModel  model.safetensors in the format of the upload, cameras.safetensors, frame.json
                 where its frame is uncertain
    EdgeModel    the same with virtual_cameras.safetensors
    Refinement   refined.safetensors in the format of the upload, rows.safetensors

Types and unknown keys are refused by pydantic in its strict mode: no number as text, nothing
infinite. Values are checked by the dataclasses themselves.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import asdict, fields
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar, get_type_hints

import numpy as np
from pydantic import ValidationError, create_model

from radiant_core.aggregate.arrival import MAX_SPLATS
from radiant_core.aggregate.averaging import Refinement, refinement_problem
from radiant_core.cameras import NO_CAMERAS, Cameras
from radiant_core.errors import BadInput
from radiant_core.frames import FrameUncertainty, Sim3
from radiant_core.hierarchy.messages import DeviceModel, EdgeModel
from radiant_core.io.array_file import load_arrays, save_arrays
from radiant_core.io.records import load_cameras, load_scene, save_cameras, save_scene, save_splats
from radiant_core.io.run_store import MAX_JSON_BYTES, content_key, file_sha256, parse_json, read_bounded, read_json, write_json
from radiant_core.io.strict import Strict, problem_sentence
from radiant_core.io.transport.upload import UploadFormat, count_uploaded, load_upload, save_upload, upload_problem
from radiant_core.splats import Splats

Message = TypeVar("Message")
Model = TypeVar("Model", DeviceModel, EdgeModel)
TASK_NAME = "task.json"
MODEL_NAME, UPLOAD_NAME = "model.safetensors", "upload.safetensors"
"""What a node keeps, and what it sends where that differs; both arrive under the first name."""
REFINED_NAME, ROWS_NAME, ROWS_SCHEMA = "refined.safetensors", "rows.safetensors", "radiant.rows"
CAMERAS_NAME, FRAME_NAME, SUMMARY_NAME = "cameras.safetensors", "frame.json", "summary.json"
VIRTUAL_CAMERAS = "virtual_cameras.safetensors"
NOTHING = {"num_splats": 0, "model_bytes": 0, "num_steps": 0, "train_s": 0.0, "first_loss": 0.0, "last_loss": 0.0}
"""The summary of a node that delivers no model."""
MAX_FRAME_BYTES = 1 << 15
"""A reason of 4,000 characters, each written in six bytes."""
MAX_UNCERTAINTY = 1e6
"""In m, rad or as a share: more is no frame."""


@cache
def _model(kind: type[Any]) -> type[Strict]:
    """The pydantic model of the fields of a dataclass that stand in JSON."""
    hints = get_type_hints(kind, include_extras=True)
    # Everything is written, so everything has to be there.
    json_fields: dict[str, Any] = {name: (hints[name], ...) for name in _json_names(kind)}
    return create_model(kind.__name__, __base__=Strict, **json_fields)


@cache
def _json_names(kind: type[Any]) -> tuple[str, ...]:
    return tuple(field.name for field in fields(kind) if not {"file", "local"} & set(field.metadata))


def message_record(message: Any) -> dict[str, Any]:
    """The message as JSON's values, without the fields that travel as files or not at all."""
    kind = type(message)
    values = {name: getattr(message, name) for name in _json_names(kind)}
    return _model(kind).model_construct(**values).model_dump(mode="json")


def message_of(kind: type[Message], record: Mapping[str, Any], name: str = "message") -> Message:
    """The message of the dataclass `kind`, without files, that `message_record` wrote; BadInput,
    calling it `name`, where a field is missing, unknown or of another kind."""
    return kind(**_parse(kind, json.dumps(record).encode(), name))


def task_key(task: Any) -> dict[str, Any]:
    """What of a task decides the bits of its result; its files count by their bytes, elsewhere. A
    setting that is None does not count, so that a new one leaves the keys of older runs valid."""
    record, keyed = message_record(task), {field.name for field in fields(task) if field.metadata.get("keyed", True)}
    return {name: value for name, value in record.items() if name in keyed and value is not None}


def save_task(folder: Path, task: Any) -> list[str]:
    """Write a task into a node's folder; the names of the files."""
    names = [TASK_NAME]
    write_json(folder / TASK_NAME, message_record(task))
    for field in fields(task):
        if "file" in field.metadata:
            save_scene(folder / field.metadata["file"], getattr(task, field.name))
            names.append(field.metadata["file"])
    return names


def load_task(kind: type[Message], folder: Path, name: str = "task") -> Message:
    """The task that `save_task` wrote into a node's folder; BadInput, calling it `name`, where a
    file is missing, damaged, or no task of this kind."""
    path = folder / TASK_NAME
    data = read_bounded(path, MAX_JSON_BYTES)
    try:
        content = parse_json(data)
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{path} is not valid JSON ({error}): send the task again.") from error
    if not isinstance(content, dict):
        raise BadInput(f"{path} is no JSON object: send the task again.")
    values = _parse(kind, data, f"{path}: {name}")
    for field in fields(kind):  # pyright: ignore[reportArgumentType]
        if "file" in field.metadata:
            values[field.name] = load_scene(folder / field.metadata["file"])
    try:
        return kind(**values)
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from error


def task_setting(folder: Path, name: str) -> Any:
    """One setting of the task in a node's folder as JSON has it; None where there is none."""
    path = folder / TASK_NAME
    record = read_json(path) if path.is_file() else {}
    return record.get(name) if isinstance(record, dict) else None


def _parse(kind: type[Any], data: bytes, name: str) -> dict[str, Any]:
    try:
        parsed = _model(kind).model_validate_json(data)
    except ValidationError as error:
        raise BadInput(f"{name}: {problem_sentence(error, 'message', data=json.loads(data))}") from error
    key = _find_left_out(parsed.model_dump(mode="json"), json.loads(data))
    if key is not None:
        raise BadInput(f"{name}: {key} is missing: add it.")
    return {field: getattr(parsed, field) for field in _json_names(kind)}


def _find_left_out(whole: Any, document: Any, place: str = "") -> str | None:
    """The path of the first key that `document` leaves to a default: pydantic demands those of the
    message alone, not of its parts."""
    parts = whole.items() if isinstance(whole, dict) else enumerate(whole) if isinstance(whole, list) else ()
    for key, value in parts:
        path = f"{place}[{key}]" if isinstance(key, int) else f"{place}.{key}".lstrip(".")
        if (isinstance(document, dict) and key not in document) or (path := _find_left_out(value, document[key], path)):
            return path
    return None


def save_device_model(folder: Path, model: DeviceModel, upload: UploadFormat, warn: Callable[[str], None]) -> list[str]:
    """Write a device's model into its folder; the names of the files."""
    save_cameras(folder / CAMERAS_NAME, model.cameras)
    return [*_save_model(folder, model.splats, model.summary, upload, warn), CAMERAS_NAME]


def save_edge_model(folder: Path, model: EdgeModel, upload: UploadFormat, warn: Callable[[str], None]) -> list[str]:
    """Write an edge's model into its folder; the names of the files."""
    if model.splats is None:
        write_json(folder / SUMMARY_NAME, {**NOTHING, "num_models": 0})
        return [SUMMARY_NAME]
    names = _save_model(folder, model.splats, model.summary, upload, warn)
    if not len(model.cameras):
        return names
    save_cameras(folder / VIRTUAL_CAMERAS, model.cameras)
    return [*names, VIRTUAL_CAMERAS]


def save_frame(folder: Path, uncertainty: FrameUncertainty | None, missing: str | None = None) -> str:
    """Write how well a model's frame is known, or why there is no model; the name of the file."""
    status = {"status": "placed", "reason": ""} if missing is None else {"status": "missing", "reason": missing}
    write_json(folder / FRAME_NAME, {**status, "uncertainty": None if uncertainty is None else asdict(uncertainty)})
    return FRAME_NAME


def _save_model(
    folder: Path, splats: Splats, summary: Mapping[str, float | int], upload: UploadFormat, warn: Callable[[str], None]
) -> list[str]:
    save_splats(folder / MODEL_NAME, splats)
    write_json(folder / SUMMARY_NAME, dict(summary))
    names = [MODEL_NAME, SUMMARY_NAME]
    if upload == "float32":
        return names
    problem = upload_problem(splats, upload)
    if problem is not None:
        warn(f"the model is uploaded as float32 instead of {upload}: {problem}")
    save_upload(folder / UPLOAD_NAME, splats, upload if problem is None else "float32")
    return [*names, UPLOAD_NAME]


def sent_files(folder: Path) -> dict[str, Path]:
    """What a node with a model sends: name where it arrives → file in its folder.

    A frame is sent where it is uncertain, virtual cameras where an edge has drawn some.
    """
    upload = folder / UPLOAD_NAME
    sent = {MODEL_NAME: upload if upload.is_file() else folder / MODEL_NAME}
    sent |= {name: folder / name for name in (CAMERAS_NAME, VIRTUAL_CAMERAS) if (folder / name).is_file()}
    if (folder / FRAME_NAME).is_file() and read_json(folder / FRAME_NAME, ("uncertainty",))["uncertainty"] is not None:
        sent[FRAME_NAME] = folder / FRAME_NAME
    return sent


def load_device_model(place: Path) -> DeviceModel | str:
    """The device's model that arrived in a folder, or why it cannot be used, one sentence."""
    try:
        return DeviceModel(
            splats=_load_model(place),
            cameras=_cameras_in(place / CAMERAS_NAME),
            uncertainty=load_uncertainty(place),
            received=_hashes(place),
        )
    except BadInput as error:
        return str(error)


def load_edge_model(place: Path) -> EdgeModel | str:
    """The edge's model that arrived in a folder, or why it cannot be used, one sentence."""
    try:
        return EdgeModel(
            splats=_load_model(place),
            cameras=_cameras_in(place / VIRTUAL_CAMERAS),
            uncertainty=load_uncertainty(place),
            received=_hashes(place),
        )
    except BadInput as error:
        return str(error)


def _load_model(place: Path) -> Splats:
    # Said by the file's head, before memory is taken for the rest.
    count = count_uploaded(place / MODEL_NAME)
    if not 0 < count <= MAX_SPLATS:
        raise BadInput(f"it has {count:,} Gaussians, expected 1 to {MAX_SPLATS:,}.")
    return load_upload(place / MODEL_NAME)


def _cameras_in(path: Path) -> Cameras:
    return load_cameras(path) if path.is_file() else NO_CAMERAS


def _hashes(place: Path) -> dict[str, str]:
    return {path.relative_to(place).as_posix(): file_sha256(path) for path in place.rglob("*") if path.is_file()}


def load_uncertainty(place: Path) -> FrameUncertainty | None:
    """How well a model's frame is known; None where it is exact or unsaid. BadInput otherwise."""
    path = place / FRAME_NAME
    if not path.is_file():
        return None
    record = read_json(path, ("uncertainty",), MAX_FRAME_BYTES)["uncertainty"]
    names = {field.name for field in fields(FrameUncertainty)}
    if record is None:
        return None
    if (
        not isinstance(record, dict)
        or record.keys() != names
        or not all(type(value) in (int, float) and 0 < value <= MAX_UNCERTAINTY for value in record.values())
    ):
        raise BadInput(f"{path} says an uncertainty that is none, expected {', '.join(sorted(names))} of more than 0.")
    return FrameUncertainty(**{name: float(value) for name, value in record.items()})


def passed_on(model: Model, upload: UploadFormat) -> Model | str:
    """The model as its receiver reads it, after the same bytes that a delivery has."""
    with TemporaryDirectory(prefix="radiant-message-") as name:
        receiver = Path(name) / "receiver"
        receiver.mkdir()
        for file, path in _sent_by(Path(name) / "sender", model, upload).items():
            shutil.copyfile(path, receiver / file)
        arrived: Any = load_device_model(receiver) if isinstance(model, DeviceModel) else load_edge_model(receiver)
        return arrived


def save_refinement(folder: Path, refinement: Refinement, scene: Splats, upload: UploadFormat, warn: Callable[[str], None]) -> list[str]:
    """Write a refinement of `scene` into a node's folder, in 16 bits unless `upload` is exact; the
    names of the files, all of which are sent."""
    upload_format: UploadFormat = "float32" if upload == "float32" else "float16"
    problem = upload_problem(refinement.splats, upload_format)
    if problem is not None:
        warn(f"the refinement is uploaded as float32 instead of {upload_format}: {problem}")
    save_upload(folder / REFINED_NAME, refinement.splats, upload_format if problem is None else "float32")
    save_arrays(
        folder / ROWS_NAME, ROWS_SCHEMA, {"rows": refinement.rows, "weights": refinement.weights}, {"scene": content_key(scene.arrays())}
    )
    return [REFINED_NAME, ROWS_NAME]


def load_refinement(place: Path, scene: Splats, num_dealt: float = float("inf")) -> Refinement | str:
    """The refinement of `scene` that arrived in a folder, or why it cannot be used, one sentence;
    `num_dealt`: photographs of its sender, which no weight exceeds."""
    try:
        if count_uploaded(place / REFINED_NAME) > len(scene):
            return f"it refines more Gaussians than the scene's {len(scene):,}."
        splats = load_upload(place / REFINED_NAME)
        arrays, about = load_arrays(place / ROWS_NAME, ROWS_SCHEMA, {"rows": "I64", "weights": "F32"})
        if about.get("scene") != content_key(scene.arrays()):
            return "it refines another scene than the one that was sent: run that node again."
        refinement = Refinement(rows=arrays["rows"], splats=splats, weights=arrays["weights"])
        problem = refinement_problem(refinement, scene, num_dealt)
    except BadInput as error:
        return str(error)
    return problem or refinement


def passed_refinement(refinement: Refinement, upload: UploadFormat, scene: Splats) -> Refinement | str:
    """The refinement as its receiver reads it, after the same bytes that a delivery has."""
    with TemporaryDirectory(prefix="radiant-message-") as name:
        save_refinement(Path(name), refinement, scene, upload, lambda message: None)
        return load_refinement(Path(name), scene)


def sent_bytes(model: DeviceModel | EdgeModel, upload: UploadFormat) -> int:
    """How many bytes a delivery of the model has, without its signed record."""
    with TemporaryDirectory(prefix="radiant-message-") as name:
        return sum(path.stat().st_size for path in _sent_by(Path(name) / "sender", model, upload).values() if path.is_file())


def refinement_bytes(refinement: Refinement, scene: Splats, upload: UploadFormat) -> int:
    """The same of a refinement."""
    with TemporaryDirectory(prefix="radiant-message-") as name:
        return sum(
            (Path(name) / file).stat().st_size for file in save_refinement(Path(name), refinement, scene, upload, lambda message: None)
        )


def _sent_by(sender: Path, model: DeviceModel | EdgeModel, upload: UploadFormat) -> dict[str, Path]:
    sender.mkdir()
    save_frame(sender, model.uncertainty)
    if isinstance(model, DeviceModel):
        save_device_model(sender, model, upload, lambda message: None)
    else:
        save_edge_model(sender, model, upload, lambda message: None)
    return sent_files(sender)


def sim3_record(move: Sim3) -> dict[str, Any]:
    """A similarity as JSON's values."""
    return {"scale": move.scale, "rotation": move.rotation.tolist(), "translation": move.translation.tolist()}


def sim3_of(record: Mapping[str, Any]) -> Sim3:
    """The similarity that `sim3_record` wrote."""
    return Sim3(scale=record["scale"], rotation=np.array(record["rotation"]), translation=np.array(record["translation"]))
