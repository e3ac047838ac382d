"""The tasks of a run's workers, beside those of the tiers (`radiant_core.hierarchy.messages`). Once
per node.

A node of a run accepts its task only if its parent signed it (`delivering.accept_task`) and if it
parses strictly as the class of its kind: no unknown key, no number as text, nothing infinite, no
path that leaves a folder. Folders without an identity, made by hand, hold unsigned tasks.

    device, field   what to train   signed by its edge
    own_field       the same        signed by its edge, which is another machine
    count, raster   what to count   signed by its edge on the way (`radiant_app/network`)
    score           the scene       signed by its device's edge; not where the owner scores all
    edge            what to join    signed by the cloud
    refine          the scene       signed by its device's edge
    average         the scene       signed by the cloud
    cloud, finish   what to join    not signed: the cloud is the root
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field

from radiant_app.workers.delivering import accept_task, belongs_to_run, conducts_itself
from radiant_core.choices import Effort, LightMode, LpipsNetwork, Matching, PlanMethod, UploadFormat, Version
from radiant_core.errors import BadInput
from radiant_core.frames import Sim3
from radiant_core.hierarchy.codec import load_task, sim3_of
from radiant_core.hierarchy.messages import (
    CloudTask,
    Count,
    DeviceSettings,
    DeviceTask,
    EdgeTask,
    Id,
    Pair,
    Positive,
    RefineTask,
    Renderer,
)
from radiant_core.io.transport.delivery import Kind
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.regions.paper_config import PaperConfig
from radiant_core.sfm.config import SfmConfig
from radiant_core.sfm.intake import AS_FOUND, Intake
from radiant_core.sfm.world_frame.placement import Placement

Triple = tuple[float, float, float]
PixelCount = Annotated[int, Field(ge=1)]
HeldOut = Annotated[int, Field(ge=0, le=7)]


def _inner(name: str) -> str:
    """A path inside a folder, relative to it."""
    if not name or name.startswith("/") or ".." in name.split("/") or "\0" in name:
        raise ValueError("Input should be a name inside the folder")
    return name


Inner = Annotated[str, AfterValidator(_inner)]
PathText = Annotated[str, Field(min_length=1)]


@dataclass(frozen=True, kw_only=True)
class SfmTask:
    """Structure from motion of a whole source."""

    source: PathText
    sfm: SfmConfig
    masks: str | None
    placement: Placement
    poses: str | None = None
    """A COLMAP model's folder or an alignment's file, or none; else what lies there."""
    refine_poses: bool = False
    """Whether given poses are adjusted to their photographs."""
    intake: Intake = AS_FOUND


@dataclass(frozen=True, kw_only=True)
class PositionsTask:
    """Read the GPS positions of the photographs in `source`, or count them in a raster."""

    source: PathText
    cell_m: Positive | None
    """Side of the raster's cells; None: positions are written."""
    held_out: tuple[str, ...]
    owned: bool
    """Whether `source` is a device's own folder."""


@dataclass(frozen=True, kw_only=True)
class SfmSettings:
    """Settings of a device's own structure from motion."""

    matching: Matching
    effort: Effort = "auto"
    seed: Count
    memory_bytes: Positive | None = None


@dataclass(frozen=True, kw_only=True)
class PlacingTask:
    """Reconstruct a device's own photographs in `source`, in the frame that all devices share."""

    frames: Literal["gps", "known"]
    source: PathText
    names: tuple[Inner, ...]
    held_out: tuple[Inner, ...]
    fetch: bool
    """Whether the device fetches the photographs into its folder first."""
    origin: Triple | None
    sfm: SfmSettings
    poses: Literal["poses", "poses.safetensors", "own/poses"] | None
    """Place of given poses in the device's folder: a COLMAP model, or cameras; own/: its own."""


@dataclass(frozen=True, kw_only=True)
class FieldTask(DeviceSettings):
    """Reconstruct and train from a device's own photographs."""

    placing: PlacingTask
    changed: tuple[tuple[int, int], ...]
    """Sizes and modification times of the photographs, which stand for their content."""


@dataclass(frozen=True, kw_only=True)
class CountTask:
    """Count the photographs that a device has, over a network."""

    frames: Literal["gps", "known"]


@dataclass(frozen=True, kw_only=True)
class RasterTask(CountTask):
    """Count the photographs of a device's own that it trains on in the cells of a raster."""

    cell_m: Positive
    first_held_out: HeldOut
    """Of its photographs by name this one is held out, and every eighth after it: who asks knows
    no names, and yet holds out those that a run on one machine would."""


@dataclass(frozen=True, kw_only=True)
class OwnFieldTask(DeviceSettings):
    """Reconstruct and train from photographs that are named by nobody but their device."""

    frames: Literal["gps", "known"]
    first_held_out: HeldOut
    """As of a `RasterTask`."""
    origin: Triple | None
    sfm: SfmSettings


def _triple(row: Iterable[float]) -> Triple:
    x, y, z = (float(value) for value in row)
    return x, y, z


@dataclass(frozen=True, kw_only=True)
class Move:
    """A similarity."""

    scale: Positive
    rotation: tuple[Triple, Triple, Triple]
    translation: Triple

    @classmethod
    def of(cls, move: Sim3) -> Move:
        """The same as a message."""
        first, second, third = (_triple(row) for row in move.rotation)
        return cls(scale=float(move.scale), rotation=(first, second, third), translation=_triple(move.translation))

    @property
    def sim3(self) -> Sim3:
        """The same as the core's type."""
        return sim3_of({"scale": self.scale, "rotation": self.rotation, "translation": self.translation})


HELD_OUT_NAME, INITIAL_NAME, OWN_NAME = "held_out.safetensors", "initial.safetensors", "own.json"
TRAINED_NAME = "trained.safetensors"
"""In the folder of a machine that scores: its held-out cameras, the Gaussians before training,
where its photographs are, and the cameras of the training where it is no device's folder."""


@dataclass(frozen=True, kw_only=True)
class ScoreTask:
    """Score the finished scene in inbox/ on the held-out photographs of this machine, and its seams
    on those that were trained on."""

    corrections: tuple[Move, ...]
    """From the frame of the held-out cameras to the scene's, in order."""
    long_side_px: PixelCount
    backend: Renderer
    lpips: LpipsNetwork | None
    light: LightMode
    """Whether photographs are scored in their own light, as it is predicted."""
    owned: bool
    """Whether the photographs are a device's own, whose folder is the one above: figures then come
    under numbers and with the leakage of its synthetic views."""
    versions: tuple[Version, ...] = ()
    """Versions of the scene to compare, that in scene.ply first, the others in files of their
    names; empty: none are compared."""


@dataclass(frozen=True, kw_only=True)
class RefineNodeTask(RefineTask):
    """Refine the scene beside it by the photographs of the device in the folder above."""

    corrections: tuple[Move, ...]
    """As of a `ScoreTask`."""


@dataclass(frozen=True, kw_only=True)
class RefinementsTask:
    """Take the refinements in inbox/ of the scene beside it."""

    senders: tuple[Id, ...]
    num_dealt: tuple[Count, ...]
    """Photographs of each sender, which the weights of its refinement cannot exceed."""

    def __post_init__(self) -> None:
        if len(self.senders) != len(self.num_dealt):
            raise BadInput(f"{len(self.senders)} senders come with {len(self.num_dealt)} counts of photographs: give one each.")


@dataclass(frozen=True, kw_only=True)
class FinishTask(RefinementsTask):
    """Put their mean into the scene."""

    another_round: bool
    """Whether another round follows, so that its start is asked for too."""


@dataclass(frozen=True, kw_only=True)
class AverageTask(RefinementsTask):
    """Send on their mean."""

    corrections: tuple[tuple[Move, ...], ...]
    """Of each sender's cameras, as of a `ScoreTask`."""
    upload: UploadFormat
    backend: Renderer
    long_side_px: Annotated[int, Field(ge=1)]
    """Of the pictures in which the edge renders what its devices' photographs show."""
    joined: str
    """SHA-256 of the scene before any round, which says of what a count is."""
    counted_in: tuple[Annotated[int, Field(ge=0)], ...]
    """Of each sender the earlier round whose count of what its photographs show holds; 0: they are
    counted now."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.senders) != len(self.counted_in):
            raise BadInput(f"{len(self.senders)} senders come with {len(self.counted_in)} rounds of a count: give one each.")


@dataclass(frozen=True, kw_only=True)
class PlannedEdge:
    """What the cloud receives of an edge to plan."""

    id: str
    position: Pair
    uplink_bytes_per_s: float
    time_s: CostCurve
    max_cameras: int | None


@dataclass(frozen=True, kw_only=True)
class RegionsTask:
    """Plan regions from a count raster and one curve per edge."""

    cell_m: Positive
    cells: tuple[tuple[int, int], ...]
    counts: tuple[int, ...]
    edges: tuple[PlannedEdge, ...]
    method: PlanMethod
    paper: PaperConfig | None = None
    """Knobs of Alg. 1; None: as they are by default."""


@dataclass(frozen=True, kw_only=True)
class JobTask:
    """One run of a batch."""

    config: dict[str, Any]
    """The run's configuration, as a run file has it."""
    resume: bool


TASKS: dict[str, type[Any]] = {
    "sfm": SfmTask,
    "positions": PositionsTask,
    "regions": RegionsTask,
    "device": DeviceTask,
    "field": FieldTask,
    "count": CountTask,
    "raster": RasterTask,
    "own_field": OwnFieldTask,
    "edge": EdgeTask,
    "cloud": CloudTask,
    "score": ScoreTask,
    "refine": RefineNodeTask,
    "average": AverageTask,
    "finish": FinishTask,
    "run": JobTask,
}
SIGNED: dict[str, Kind] = {
    "device": "device_task",
    "field": "field_task",
    "own_field": "field_task",
    "edge": "edge_task",
    "score": "score_task",
    "refine": "refine_task",
    "average": "average_task",
}
"""Kind of worker whose task is signed by another node → kind of delivery."""


def receive_task(kind: str, folder: Path) -> Any:
    """Verify and parse the task in the folder of a node.

    Raises:
        BadInput: it is of another kind or, in a run's folder, not the newest one that the parent
            signed.
    """
    if kind in SIGNED and belongs_to_run(folder) and not conducts_itself(folder):
        accept_task(folder, SIGNED[kind])
    return load_task(TASKS[kind], folder, f"{kind} task")
