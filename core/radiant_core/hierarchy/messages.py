"""The messages between the tiers: what a node is asked to do, and the model it answers with. Once
per node.

    DeviceTask, photographs  ── train_device ──→  DeviceModel
    EdgeTask, DeviceModels   ── join_edge ─────→  EdgeModel
    CloudTask, EdgeModels    ── join_cloud ────→  SceneModel
    RefineTask, photographs  ── refine_device ─→  Refinement (`aggregate/averaging.py`)

`radiant_core.hierarchy.codec` writes and reads them. A field that is `UNKEYED` changes no bit of a
node's result and stands in no key; one that is `in_file` travels as a file of that name beside the
JSON; one that is `LOCAL` does not travel.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Annotated, Any, Literal

from pydantic import Field

from radiant_core.aggregate.config import Join
from radiant_core.cameras import NO_CAMERAS, Cameras
from radiant_core.errors import BadInput
from radiant_core.frames import FrameUncertainty, Sim3
from radiant_core.hierarchy.groups import GroupTraining, Seat
from radiant_core.io.transport.upload import UploadFormat
from radiant_core.plan.system import Cloud
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from radiant_core.train.config import CHECKPOINT_EVERY_S, TrainConfig

Renderer = Literal["gsplat", "native", "reference"]
"""A backend of `radiant_core.render`; "auto" is resolved before a task is written."""
Id = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")]
Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=0)]
Pair = tuple[float, float]

UNKEYED: Mapping[str, Any] = {"keyed": False}
LOCAL: Mapping[str, Any] = {"local": True}


def in_file(name: str) -> Mapping[str, Any]:
    """Metadata of a field that travels as the file `name`."""
    return {"file": name}


ONLY_FADED = "only_faded"
"""In a cloud's summary: 1 where models faded and nothing was fitted to them."""


@dataclass(frozen=True, kw_only=True)
class Training:
    """What every node that trains or joins is given."""

    train: TrainConfig
    backend: Renderer
    checkpoint_every_s: Positive = field(default=CHECKPOINT_EVERY_S, metadata=UNKEYED)


@dataclass(frozen=True, kw_only=True)
class DeviceSettings(Training):
    """How a device trains, wherever its scene comes from."""

    upload: UploadFormat = "float32"
    memory_bytes: Positive | None = None
    """What the process may hold, which limits the number of Gaussians; None: no limit."""
    seat: Seat | None = None
    """None: it trains alone."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DeviceTask(DeviceSettings):
    """Train a model of the photographs that the cameras of `scene` took."""

    scene: SfmScene = field(metadata=in_file("scene.safetensors"))


def device_task(settings: DeviceSettings, scene: SfmScene) -> DeviceTask:
    """The task of a device with that scene."""
    return DeviceTask(scene=scene, **{item.name: getattr(settings, item.name) for item in fields(DeviceSettings)})


@dataclass(frozen=True, kw_only=True, eq=False)
class DeviceModel:
    """A device's model as its edge receives it. No pixel, no path, no EXIF."""

    splats: Splats = field(metadata=in_file("model.safetensors"))
    cameras: Cameras = field(metadata=in_file("cameras.safetensors"))
    uncertainty: FrameUncertainty | None = None
    """How well its frame is known; None where the frame is exact."""
    received: Mapping[str, str] = field(default_factory=dict, metadata=LOCAL)
    """SHA-256 of the files that it arrived as, which seed the edge's virtual cameras."""
    initial: Splats | None = field(default=None, metadata=LOCAL)
    """The Gaussians before training; they stay on the device."""
    summary: Mapping[str, float | int] = field(default_factory=dict, metadata=LOCAL)


@dataclass(frozen=True, kw_only=True)
class EdgeTask(Training):
    """Join the models of `devices`, whose strips of the region are `strips`."""

    devices: Annotated[tuple[Id, ...], Field(min_length=1)]
    num_dealt: tuple[Count, ...]
    """Photographs dealt to each device: it may send at most as many cameras."""
    strips: tuple[tuple[Pair, ...], ...]
    join: Join
    draws_cameras: bool = True
    """Whether the cloud asks for virtual cameras, at which it renders the edge's model."""
    upload: UploadFormat = "float32"
    memory_bytes: Positive | None = None
    group: GroupTraining | None = None
    """Its devices train as one model, at this edge or below the cloud; None: models are joined."""

    def __post_init__(self) -> None:
        if not len(self.devices) == len(self.num_dealt) == len(self.strips):
            raise BadInput(f"an edge task has {len(self.devices)} devices, {len(self.num_dealt)} counts and {len(self.strips)} strips.")
        _require_epochs(self.join)


@dataclass(frozen=True, kw_only=True, eq=False)
class EdgeModel:
    """An edge's model as the cloud receives it: nothing of it names, counts or locates a device."""

    splats: Splats | None = field(metadata=in_file("model.safetensors"))
    """None where no device's model could be used; such a model is not sent."""
    cameras: Cameras = field(default=NO_CAMERAS, metadata=in_file("virtual_cameras.safetensors"))
    """Virtual cameras, where the cloud asks for some."""
    uncertainty: FrameUncertainty | None = None
    corrections: Mapping[str, Sim3 | None] = field(default_factory=dict, metadata=LOCAL)
    """How each device's model was moved; None for one that was refused."""
    refused: Mapping[str, str] = field(default_factory=dict, metadata=LOCAL)
    """Devices whose models were refused, with the reasons."""
    received: Mapping[str, str] = field(default_factory=dict, metadata=LOCAL)
    """As of a device's model."""
    summary: Mapping[str, float | int] = field(default_factory=dict, metadata=LOCAL)
    cut_for_memory: bool = field(default=False, metadata=LOCAL)
    """Its machine had too little free, so that another try may join."""


@dataclass(frozen=True, kw_only=True)
class CloudTask(Training):
    """Join the models of `edges`, whose regions are the power cells of `sites` with `weights`."""

    edges: Annotated[tuple[Id, ...], Field(min_length=1)]
    num_dealt: tuple[Count, ...]
    """Photographs dealt below each edge: it may send at most as many virtual cameras."""
    sites: tuple[Pair, ...]
    weights: tuple[float, ...]
    join: Join
    limits: Cloud | None = None
    edge_times_s: tuple[float, ...] | None = None
    """Seconds that each edge took to join; only where the cloud's time is limited."""
    group: GroupTraining | None = None
    """All devices train as one model; None: models are joined."""
    of_devices: tuple[Count, ...] | None = None
    """Photographs dealt to each device of the group, in its order; None without one."""

    def __post_init__(self) -> None:
        lengths = {len(self.edges), len(self.num_dealt), len(self.edge_times_s or self.edges), len(self.sites), len(self.weights)}
        if len(lengths) != 1:
            raise BadInput(f"a cloud task of {len(self.edges)} edges has {sorted(lengths)} entries: give one per edge.")
        _require_epochs(self.join)


def _require_epochs(join: Join) -> None:
    if join.epochs is None:
        raise BadInput("a task to join says no epochs: say how often each view is shown (`AggregateConfig.joining_after`).")


@dataclass(frozen=True, kw_only=True)
class RefineTask(Training):
    """Fit the joined scene to a device's own photographs."""

    epochs: Annotated[int, Field(ge=1)]
    """How often each photograph is shown."""
    max_num_steps: Annotated[int, Field(ge=1)] | None = None
    """Upper limit of steps, as of a join; None for none."""
    upload: UploadFormat = "float32"
    memory_bytes: Positive | None = None
    """What the process may hold; None: no limit."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SceneModel:
    """The scene, and what became of each edge's model."""

    splats: Splats | None
    corrections: Mapping[str, Sim3 | None] = field(default_factory=dict)
    refused: Mapping[str, str] = field(default_factory=dict)
    uncertainty: FrameUncertainty | None = None
    summary: Mapping[str, float | int] = field(default_factory=dict)
    cut_for_memory: bool = False
    """Whether too little free memory made it cut models, which another try may join."""
    cut: Splats | None = None
    """The edges' models cut at their borders, where they were joined and that was compared, or
    where they only faded, for devices to fit."""

    @property
    def only_faded(self) -> bool:
        """Whether the edges' models only faded: what no device fits is better cut."""
        return self.cut is not None and bool(self.summary.get(ONLY_FADED))
