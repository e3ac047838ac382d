"""What a node is told, field by field: the typed content of task.json for every kind of worker that a run deals to. Once per node.

A node of a run takes its task only when the one above it signed it (`delivering.take_task`) and it is exactly of its kind's schema here:
no unknown key, no number as text, nothing infinite, no path that leaves a folder. Tasks made by hand, without an identity, are not asked.

| worker         | task         | from       | signed                                              |
|----------------|--------------|------------|-----------------------------------------------------|
| device, field  | what to train | its edge   | yes                                                 |
| score          | the scene    | its edge   | yes                                                 |
| edge           | what to join | the cloud  | yes                                                 |
| teacher, cloud | what to do   | itself     | no: a teacher is a part of its edge, the cloud is the root |
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, FiniteFloat, ValidationError

from radiant_app.files.toml_file import Strict, sentence
from radiant_app.workers.delivering import IDENTITY, POST_NAME, take_task
from radiant_core.aggregate.config import AggregateConfig
from radiant_core.errors import BadInput
from radiant_core.evaluate.image_error import LpipsNetwork
from radiant_core.io.run_store import MAX_JSON_BYTES, parse_json, read_bounded
from radiant_core.io.transport.delivery import Kind
from radiant_core.io.transport.upload import UploadFormat
from radiant_core.plan.system import Cloud
from radiant_core.sfm.config import Matching
from radiant_core.train.config import TrainConfig

Backend = Literal["gsplat", "native", "reference"]
"""Those of `radiant_core.render.contract` that a run has chosen among; torch is not imported for it."""
Id = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")]
Pair = tuple[FiniteFloat, FiniteFloat]
Triple = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=0)]


def _inner(name: str) -> str:
    """A path inside a folder, relative to it."""
    if not name or name.startswith("/") or ".." in name.split("/") or "\0" in name:
        raise ValueError("Input should be a name inside the folder")
    return name


Inner = Annotated[str, AfterValidator(_inner)]


class _Trained(Strict):
    """What whoever trains or joins models is told."""

    train: TrainConfig
    backend: Backend
    checkpoint_every_s: Positive


class _Sending(_Trained):
    upload: UploadFormat
    sends: list[Literal["cameras.safetensors", "virtual_cameras.safetensors", "virtual_views.safetensors", "frame.json"]]


class DeviceTask(_Sending):
    """Train a model of the photographs in photos/ from scene.safetensors."""

    memory_bytes: Positive | None


class SfmSettings(Strict):
    """What a device's own structure from motion is told."""

    matching: Matching
    seed: Annotated[int, Field(ge=0)]
    two_view_points: bool
    memory_bytes: Positive | None


class FieldTask(DeviceTask):
    """Reconstruct and train from the device's own photographs, which lie in `source`."""

    frames: Literal["gps", "known"]
    source: Annotated[str, Field(min_length=1)]
    names: list[Inner]
    held_out: list[Inner]
    copy_: Annotated[bool, Field(alias="copy")]
    changed: list[tuple[int, int]]
    origin: Triple | None
    sfm: SfmSettings
    model: bool | None


class TeacherTask(Strict):
    """Render a device's views."""

    long_side_px: Annotated[int, Field(ge=1)]
    backend: Backend
    num_dealt: Count
    signed: Literal[True]
    checkpoint_every_s: Positive


class CloudLimits(Strict):
    """What the cloud can spend, and an edge's share of all cameras, by which it foresees whether the cloud will retrain."""

    limits: Cloud
    share: Annotated[float, Field(gt=0, le=1)]


class EdgeTask(_Sending):
    """Join the models of `devices`, whose regions are `strips`; each was dealt `num_dealt` photographs."""

    devices: Annotated[list[Id], Field(min_length=1)]
    num_dealt: list[Count]
    strips: list[list[Pair]]
    aggregate: AggregateConfig
    memory_bytes: Positive | None
    cloud: CloudLimits | None
    signed: Literal[True]
    teachers: list[Id]


class CloudTask(_Trained):
    """Join the models of `edges`, whose regions are the power cells of `sites` with `weights`; each was dealt `num_dealt` photographs."""

    edges: Annotated[list[Id], Field(min_length=1)]
    num_dealt: list[Count]
    sites: list[Pair]
    weights: list[FiniteFloat]
    aggregate: AggregateConfig
    limits: Cloud | None = None
    edge_times_s: list[FiniteFloat] | None = None
    signed: Literal[True]


class Move(Strict):
    """A similarity."""

    scale: Positive
    rotation: tuple[Triple, Triple, Triple]
    translation: Triple


class ScoreTask(Strict):
    """Score the finished scene in inbox/, to which `corrections` lead, on photographs that were held out."""

    corrections: list[Move]
    long_side_px: Annotated[int, Field(ge=1)]
    backend: Backend
    lpips: LpipsNetwork | None


SCHEMAS: dict[str, type[Strict]] = {
    "device": DeviceTask,
    "field": FieldTask,
    "teacher": TeacherTask,
    "edge": EdgeTask,
    "cloud": CloudTask,
    "score": ScoreTask,
}
SIGNED: dict[str, Kind] = {"device": "device_task", "field": "field_task", "edge": "edge_task", "score": "score_task"}
"""Kinds of workers whose task comes from another node, and as what it is delivered."""


def require_task(kind: str, folder: Path) -> None:
    """Raise BadInput unless the task in the folder of a run's node is for it, newest, unchanged and of its schema; nothing is asked of
    folders that are no node's."""
    if kind not in SCHEMAS or not (folder / IDENTITY / POST_NAME).is_file():
        return
    if kind in SIGNED:
        take_task(folder, SIGNED[kind])
    require_schema(kind, folder / "task.json")


def require_schema(kind: str, path: Path) -> None:
    """Raise BadInput unless a file is the task of a worker of this kind."""
    data = read_bounded(path, MAX_JSON_BYTES)
    try:
        parse_json(data)
        SCHEMAS[kind].model_validate_json(data)
    except ValidationError as error:
        raise BadInput(f"{path}: {sentence(error, f'{kind} task')}") from error
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{path} is not valid JSON ({error}): send the task again.") from error
