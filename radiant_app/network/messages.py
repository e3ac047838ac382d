"""What the cloud asks of an edge over a network, and what an edge reports. Once per run and edge.

    EdgeCountTask, EdgeRasterTask   what its devices have                → DevicesReport
    RegionTask                      fold its devices and join their models
    EdgeRefineTask, EdgeScoreTask   let its devices refine, or score, the scene

An edge gets the plan of its own devices and none of others'. What its devices are asked is the
edge's to say and to sign.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import Field

from radiant_app.workers.tasks import HeldOut, Move, SfmSettings, Triple
from radiant_core.aggregate.config import AggregateConfig
from radiant_core.choices import LpipsNetwork, StepPolicy, UploadFormat, Version
from radiant_core.errors import BadInput
from radiant_core.hierarchy.messages import Count, Id, Positive, Training

Devices = Annotated[tuple[Id, ...], Field(min_length=1, max_length=4096)]
PLAN_NAME, SYSTEM_NAME, SCENE_NAME, LPIPS_NAME = "plan.json", "system.toml", "scene.ply", "lpips.safetensors"


@dataclass(frozen=True, kw_only=True)
class EdgeCountTask:
    """Let devices count their photographs."""

    frames: Literal["gps", "known"]
    devices: Devices


@dataclass(frozen=True, kw_only=True)
class EdgeRasterTask(EdgeCountTask):
    """Let devices count what they train on in cells."""

    cell_m: Positive
    first_held_out: tuple[HeldOut, ...]
    """Of each device, see `RasterTask`."""

    def __post_init__(self) -> None:
        if len(self.first_held_out) != len(self.devices):
            raise BadInput(f"{len(self.devices)} devices come with {len(self.first_held_out)} places of the held out: give one each.")


@dataclass(frozen=True, kw_only=True)
class RegionTask(Training):
    """Fold the devices of a region; beside it its part of the plan and of the system."""

    frames: Literal["gps", "known"]
    devices: Devices
    first_held_out: tuple[HeldOut, ...]
    num_dealt: tuple[Count, ...]
    """Photographs of each device that are not held out."""
    origin: Triple | None
    sfm: SfmSettings
    aggregate: AggregateConfig
    upload: UploadFormat
    step_policy: StepPolicy
    num_devices: Count
    """Devices of the whole run, which share its steps."""
    num_photographs: Count
    """Planned ones of the whole run."""
    deadline_factor: Annotated[float, Field(ge=0)]
    lpips: LpipsNetwork | None

    def __post_init__(self) -> None:
        if not len(self.devices) == len(self.first_held_out) == len(self.num_dealt):
            counts = f"{len(self.first_held_out)} and {len(self.num_dealt)}"
            raise BadInput(f"{len(self.devices)} devices come with {counts} counts: give one each.")


@dataclass(frozen=True, kw_only=True)
class EdgeRefineTask:
    """Let devices refine the scene beside it, and average what they send."""

    devices: Devices
    to_cloud: Move
    """From the frame of the edge to the scene's."""
    joined: str
    """As of an `AverageTask`."""
    number: Annotated[int, Field(ge=1)] = 1
    """Of the round."""


@dataclass(frozen=True, kw_only=True)
class EdgeScoreTask:
    """Let devices score the scene beside it on what they held out."""

    devices: Devices
    to_cloud: Move
    versions: tuple[Version, ...] = ()
    """As of a `ScoreTask`."""


@dataclass(frozen=True, kw_only=True)
class DevicesReport:
    """What became of each device of an edge."""

    found: dict[Id, dict[str, Any]]
    """Device → what it sent, by the kind of task."""
    missing: dict[Id, str]
    """Device → why it sent nothing that can be used."""


EDGE_TASKS: dict[str, type[Any]] = {
    "edge_count": EdgeCountTask,
    "edge_raster": EdgeRasterTask,
    "region": RegionTask,
    "edge_refine": EdgeRefineTask,
    "edge_score": EdgeScoreTask,
}
