"""`RunConfig`: what one run is asked to do; a sentence under a field is also its option's help.

    RunConfig(source=photos, out=folder, train=TrainOptions(num_steps=300))

The options of `radiant run`, the keys of a run file, `--set PATH=VALUE` and a run's manifest are
made from these fields (`radiant_app.config.fields`). Pure: nothing heavy is imported.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast, get_args, get_type_hints

from radiant_app.quantities import seconds_of
from radiant_core.aggregate.config import AggregateConfig, AggregatePreset, Refine, aggregate_preset, joining_types, with_joins
from radiant_core.choices import (
    Contradictions,
    CutBy,
    DevicesUsed,
    Effort,
    LpipsNetwork,
    MaskIgnores,
    Matching,
    Panoramas,
    PlanMethod,
    StepPolicy,
    TrainedAs,
    UploadFormat,
)
from radiant_core.errors import BadInput
from radiant_core.plan.regions.paper_config import PaperConfig
from radiant_core.sfm.intake import AS_FOUND, Intake
from radiant_core.train.config import CHECKPOINT_EVERY_S, Preset, setting_types, train_preset, with_settings

if TYPE_CHECKING:
    from radiant_core.train.needs import Overrides

Frames = Literal["shared", "gps", "known"]
"""shared: one owner pools and places the photographs; gps, known: every device places its own."""
RunPreset = Literal["default", "paper"]
"""default: ours; paper: the paper's plan, training (20,000 steps) and joining, nothing skipped."""
ExecutorName = Literal["local", "ray", "network"]
"""local: processes of this machine; ray: tasks of a Ray cluster of one owner's machines; network:
machines of different owners that join this one."""
SIZES = ("long_side_px", "num_steps", "max_num_splats")
"""Fields of `TrainConfig` that have an option of their own."""
MAX_SEED = 2**31 - 1
"""What numpy, torch and COLMAP all take."""
MAX_DEVICES = 1_000
"""Devices that one machine is divided into; each is a process of its own."""
FIRST, PLACE, JOINING, OUTPUT = "Options", "Scale, direction and ground control", "Joining models", "Settings and output"
GROUPS = {
    "sfm": "Photographs and poses",
    "plan": "Plan and machines",
    "train": "Training",
    "aggregate": JOINING,
    "evaluate": "Scores",
    "execution": "Processes, clusters and networks",
    "": OUTPUT,
}
"""Section of `RunConfig` → heading of its options in the help, but for those most runs need
(`FIRST`) and those that place a scene (`PLACE`)."""

RUN_PRESETS: dict[RunPreset, dict[str, str]] = {
    "default": {},
    # exhaustive: neighbours by GPS alone would skip pairs.
    "paper": {
        "sfm.matching": "exhaustive",
        "sfm.effort": "thorough",
        "plan.method": "paper",
        "train.preset": "paper",
        "plan.within_edge": "joined",
        "plan.between_edges": "joined",
        "train.step_policy": "fixed",
        "aggregate.preset": "paper",
        "upload": "float32",
    },
}
"""Preset of a run → path of a field → its value where that is not the field's default."""


def _devices_of(text: str) -> DevicesUsed | int:
    """The devices that a user types: auto, all or a number of them."""
    if (choice := text.strip().lower()) in get_args(DevicesUsed):
        return cast("DevicesUsed", choice)
    try:
        return int(choice)
    except ValueError:
        raise BadInput(f"--devices is {text!r}, expected auto, all, or a number of devices of this machine.") from None


@dataclass(frozen=True, kw_only=True)
class Option:
    """How a field appears on the command line, where its name and type do not say so."""

    name: str | None = None
    """None: the field's name, as `--field-name`."""
    min: float | None = None
    max: float | None = None
    metavar: str | None = None
    default_text: str | None = None
    """The default as the help shows it."""
    parse: Callable[[str], Any] | None = None
    """Makes the value of what a user types; None: it is typed as it is."""
    group: str | None = None
    """Heading that it stands under in the help; None: that of its section."""


@dataclass(frozen=True, kw_only=True)
class SettingsOf:
    """Marks a mapping whose keys are paths of the fields of another configuration."""

    types: Callable[[], Mapping[str, Any]]
    """Path → type of those fields."""
    fixed: tuple[str, ...]
    """Paths that stand elsewhere in a run's configuration."""


@dataclass(frozen=True, kw_only=True)
class SfmOptions:
    """How cameras are placed."""

    matching: Matching = "auto"
    """Compare neighbours by GPS (spatial), or every pair (exhaustive)."""
    effort: Effort = "auto"
    """auto: skip what photographs with good overlap do not need; thorough: COLMAP's features, all
    pairs of neighbours and COLMAP's adjustments, in about three times the time."""
    poses: Annotated[Path | None, Option(metavar="FILE", default_text="what lies beside the photographs")] = None
    """Alignment to use: a COLMAP model's folder, or a file of another program
    (docs/begun_elsewhere.md); none: photographs are placed anew."""
    refine_poses: Annotated[bool, Option(name="--refine-poses")] = False
    """Adjust the rough poses of an alignment to its photographs, in its frame."""
    masks: Path | None = None
    """Folder of masks: photograph.jpg.png or photograph.png, 8-bit grey, black is ignored; by
    default masks/ beside the photographs, if the names match."""
    mask_ignores: Annotated[MaskIgnores | None, Option(default_text="black; asks where that is most of a mask")] = None
    """Colour that a mask leaves out of a photograph; nothing: masks/ is not used."""
    film_frames: Annotated[int | None, Option(default_text="by motion, 400 at most")] = None
    """Roughly how many frames of a film become photographs: the sharpest of each stretch of equal
    motion."""
    panoramas: Annotated[Panoramas | None, Option(default_text="those whose XMP says so")] = None
    """Treat all photographs as equirectangular panoramas and cut them into faces, or none."""
    up: Annotated[str | None, Option(default_text="auto", group=PLACE)] = None
    """auto: from GPS, else from ground and cameras. Or: ground (the plane through most points is
    level), level (the camera was held level), down (it looked straight down), a photograph's name
    (its top edge is up), or x,y,z in the frame of a COLMAP project. Overrides GPS."""
    distance: Annotated[str | None, Option(metavar="PHOTO,PHOTO,METRES", group=PLACE)] = None
    """Distance between the cameras of two photographs; sets the scale and overrides GPS."""
    height_m: Annotated[float | None, Option(name="--height", group=PLACE)] = None
    """Median height of the cameras above ground in metres; sets the scale and overrides GPS."""

    north: Annotated[str | None, Option(metavar="PHOTO,DEGREES", group=PLACE)] = None
    """Direction a photograph looks in, clockwise from north, where GPS gives none; of one that
    looks down, the direction of its top edge."""
    gcp: Annotated[Path | None, Option(metavar="FILE", group=PLACE)] = None
    """Ground control points as in OpenDroneMap's gcp_list.txt: the system (EPSG:…, LOCAL), then
    lines of east north up column row photograph name. All photographs are adjusted to them."""
    gcp_accuracy: Annotated[str | None, Option(metavar="METRES[,METRES]", default_text="0.02", group=PLACE)] = None
    """Standard deviation of the coordinates of ground control; two: horizontal, vertical."""
    check_points: Annotated[str | None, Option(metavar="NAMES|every:K", group=PLACE)] = None
    """Points left out of the adjustment, with errors in the report; also marked by the word check
    behind a name in the list."""
    require_grids: Annotated[bool, Option(name="--require-grids", group=PLACE)] = False
    """Refuse ground control in a system whose best transformation lacks a grid; by default a
    warning gives the error in metres."""

    contradictions: Annotated[Contradictions, Option(group=PLACE)] = "stop"
    """Where --gcp, --distance, --height, --north or --up differ from the photographs' GPS by more
    than its error: stop, or warn and use what is given here."""

    @property
    def intake(self) -> Intake:
        """What is made of the source's files before structure from motion."""
        return Intake(mask_ignores=self.mask_ignores, film_frames=self.film_frames, panoramas=self.panoramas)

    @property
    def placed_by_hand(self) -> bool:
        """Whether the user gives a direction, a length or surveyed points."""
        return (self.up, self.distance, self.height_m, self.north, self.gcp) != (None,) * 5

    @property
    def placement(self) -> dict[str, Any]:
        """The fields of `radiant_core.sfm.world_frame.placement.Placement`."""
        fields = {"up": self.up or "auto", "distance": self.distance, "height_m": self.height_m, "north": self.north}
        fields |= {"contradictions": self.contradictions}
        if self.gcp is None:
            return fields
        from radiant_core.georef.control_points import control_request  # numpy

        return {**fields, "control": control_request(self.gcp, self.gcp_accuracy, self.check_points, require_grids=self.require_grids)}

    def __post_init__(self) -> None:
        if self.gcp is None and (self.gcp_accuracy, self.check_points, self.require_grids) != (None, None, False):
            raise BadInput("--gcp-accuracy, --check-points and --require-grids are of ground control: give its list with --gcp.")
        if self.placed_by_hand:
            from radiant_core.sfm.world_frame.placement import Placement  # numpy

            Placement(**self.placement)


@dataclass(frozen=True, kw_only=True)
class PlanOptions:
    """Which edge and device takes which photographs."""

    method: Annotated[PlanMethod, Option(name="--plan-method")] = "exact"
    """exact: least makespan; paper: Alg. 1 on power cells; paper-literal: Alg. 1 as written; even:
    equal counts."""
    file: Annotated[Path | None, Option(name="--plan")] = None
    """Plan that `radiant plan` made before capture; by default the photographs are planned."""
    cut_by: CutBy = "auto"
    """Cut regions and strips where cameras stand (positions) or where they look (looks); auto:
    where they look if devices then see clearly more of their strips."""
    devices: Annotated[DevicesUsed | int, Option(metavar="auto|all|N", default_text="auto", parse=_devices_of)] = "auto"
    """auto: with a system, only the fastest devices where one owner has few photographs, better in
    six of seven cells; without, this machine as one device where memory holds all photographs. all:
    every device, always so with gps and known. N: this machine as N devices."""
    within_edge: TrainedAs = "auto"
    """together: the devices of an edge train one model and sum gradients in every step; joined:
    each trains a model; auto: together if that is predicted to take at most twice the time."""
    between_edges: TrainedAs = "auto"
    """The same for the devices of all edges; edges exchange through the cloud."""
    mask_gradients: bool = False
    """Devices that train together add masks that cancel in their edge's sum, so the edge sees no
    single gradient; about 9 times the upload, and training stops if one device is lost."""
    raster_cell_m: Annotated[float | None, Option(min=0)] = None
    """Plan from photograph counts in cells of this many metres; 0: from positions. By default 5
    with gps and known."""
    settings: Annotated[Mapping[str, Any], SettingsOf(types=partial(get_type_hints, PaperConfig), fixed=("max_iterations",))] = field(
        default_factory=dict
    )
    """Field of `PaperConfig`, d and T_thres of Alg. 1 → its value."""

    @property
    def asks_together(self) -> bool:
        """Whether machines are to train together, whatever is predicted."""
        return "together" in (self.within_edge, self.between_edges)

    @property
    def paper(self) -> PaperConfig | None:
        """The knobs of Alg. 1; None: as they are by default."""
        return PaperConfig(**self.settings) if self.settings else None

    def __post_init__(self) -> None:
        if self.paper is not None and not self.method.startswith("paper"):
            names = " and ".join(f"plan.{name}" for name in self.settings)
            raise BadInput(f"{names} is for Alg. 1 and the plan's method is {self.method}: use paper or paper-literal, or leave it out.")
        if self.between_edges == "together" and self.within_edge == "joined":
            raise BadInput("--between-edges together and --within-edge joined exclude each other: leave one of them out.")
        if self.mask_gradients and self.within_edge == "joined":
            raise BadInput("--mask-gradients is for machines that train together, and --within-edge is joined: leave one of them out.")
        if isinstance(self.devices, int) and not 1 <= self.devices <= MAX_DEVICES:
            raise BadInput(f"--devices is {self.devices}, expected auto, all, or 1 to {MAX_DEVICES} devices of this machine.")
        if self.raster_cell_m is not None and not 0 <= self.raster_cell_m < math.inf:
            raise BadInput(f"raster_cell_m is {self.raster_cell_m}, expected a side in metres, or 0 to plan from positions.")
        if self.file is not None and self.method != "exact":
            raise BadInput("--plan keeps to a plan that is made and --plan-method makes another: leave one of them out.")
        if self.file is not None and self.cut_by != "auto":
            raise BadInput(f"--plan keeps to a plan that is made and --cut-by {self.cut_by} cuts another: leave one of them out.")


@dataclass(frozen=True, kw_only=True)
class TrainOptions:
    """How devices train: a preset, and whatever of `TrainConfig` is to differ from it.

    Raises:
        BadInput: no such preset or setting, or a value that the setting cannot have.
    """

    preset: Annotated[Preset, Option(name="--train-preset", group=FIRST)] = "default"
    """draft: default with fewer, smaller steps; default: high rates, one light for all photographs,
    Gaussians that grow evenly up to the limit; standard: 3DGS, its schedule scaled to the steps;
    paper: its 20,000 steps. All but paper are reduced on a CPU."""
    long_side_px: Annotated[int | None, Option(min=16)] = None
    """Long side of the training images."""
    num_steps: Annotated[int | None, Option(name="--steps", min=1)] = None
    """Training steps per device, the mean over devices."""
    max_num_splats: Annotated[int | None, Option(name="--max-splats", min=100)] = None
    """Maximum Gaussians per device."""
    step_policy: StepPolicy = "per_photograph"
    """per_photograph: steps in proportion to a device's photographs, with --steps as the mean;
    fixed: the same for each."""
    settings: Annotated[Mapping[str, Any], SettingsOf(types=setting_types, fixed=(*SIZES, "seed"))] = field(default_factory=dict)
    """Path of a field of `TrainConfig` → its value."""

    @property
    def overrides(self) -> Overrides:
        """All but the preset."""
        from radiant_core.train.needs import Overrides  # numpy

        return Overrides(**{name: getattr(self, name) for name in SIZES}, settings=self.settings)

    def __post_init__(self) -> None:
        with_settings(train_preset(self.preset), self.settings)


@dataclass(frozen=True, kw_only=True)
class AggregateOptions:
    """How edges and the cloud join models: a preset, and what of each `Join` is to differ."""

    preset: Annotated[AggregatePreset, Option(name="--aggregate-preset")] = "default"
    """paper: retrain every parameter at the edges and the cloud."""
    settings: Annotated[Mapping[str, Any], SettingsOf(types=joining_types, fixed=())] = field(default_factory=dict)
    """Path of a field of `AggregateConfig`, as edge.epochs → its value."""


@dataclass(frozen=True, kw_only=True)
class RefineOptions:
    """How devices refine the scene: what of `Refine` is to differ from the preset of joining."""

    settings: Annotated[Mapping[str, Any], SettingsOf(types=partial(get_type_hints, Refine), fixed=())] = field(default_factory=dict)
    """Field of `Refine` → its value."""


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions:
    """What the scene is scored with beside PSNR, SSIM and FLIP; may change on resuming."""

    lpips_weights: Path | None = None
    """LPIPS weights: a folder with torchvision's backbone and lpips' heads, or one file."""
    lpips_network: Annotated[LpipsNetwork, Option(name="--lpips-net")] = "vgg"
    """Network of LPIPS: VGG16 or AlexNet."""


@dataclass(frozen=True, kw_only=True)
class ExecutionOptions:
    """Where and in which order nodes work: decides no result, so it may change on resuming."""

    max_workers: Annotated[int, Option(name="--workers", min=0)] = 0
    """Processes at a time; 0: one per core."""
    executor: ExecutorName = "local"
    """local: processes here; ray: one owner's cluster; network: machines of several owners, with
    this machine's node folder as SOURCE."""
    address: str | None = None
    """ray: host:port of the cluster's head, or local."""
    deadline_factor: Annotated[float, Option(min=0)] = 10.0
    """Drop a node that takes this many times its planned time; 0: never."""
    checkpoint_every_s: Annotated[float, Option(name="--checkpoint-every", parse=seconds_of, default_text="10s")] = CHECKPOINT_EVERY_S
    """Time between two checkpoints of a training."""

    @property
    def num_workers(self) -> int:
        """Processes at a time."""
        return self.max_workers or os.cpu_count() or 1

    def __post_init__(self) -> None:
        if self.max_workers < 0:
            raise BadInput(f"max_workers is {self.max_workers}, expected 0 (one per core) or more.")
        if not (self.deadline_factor == 0 or 1 <= self.deadline_factor < math.inf):
            raise BadInput(f"the deadline is {self.deadline_factor} times the planned time, expected 1 or more, or 0 for none.")
        if not 0 < self.checkpoint_every_s < math.inf:
            raise BadInput(f"checkpoint_every_s is {self.checkpoint_every_s}, expected a positive number of seconds.")
        if (self.executor == "ray") != (self.address is not None):
            raise BadInput("--executor ray and --address belong together: give the address of the cluster's head, host:port, or local.")


@dataclass(frozen=True, kw_only=True)
class RunConfig:
    """One run from photographs to a scene.

    Raises:
        BadInput: settings that contradict each other, or a value out of range.

    Example:
        >>> training = radiant.TrainOptions(preset="draft", num_steps=300)
        >>> plan = radiant.PlanOptions(devices=4)
        >>> places = {"source": Path("PHOTOS"), "out": Path("RUN")}
        >>> config = radiant.RunConfig(**places, train=training, plan=plan)
    """

    source: Path
    """Photographs, with an alignment beside them or without, a COLMAP project (images/ and
    sparse/), or a Mill 19 folder."""
    out: Annotated[Path, Option(group=FIRST)]
    """Folder for the run, new or empty; a batch writes beside its file."""
    system: Annotated[Path | None, Option(group=FIRST)] = None
    """TOML of edges and devices (docs/system_files.md). By default this machine is the only device;
    it stands in for two edges with two devices each if photographs lie in folders of devices, or
    with --plan, --plan-method, --preset paper or --executor ray."""
    emulate: Annotated[Path | None, Option(group=GROUPS["execution"])] = None
    """System file whose speeds and uplinks are emulated on this machine."""
    frames: Annotated[Frames, Option(group=FIRST)] = "shared"
    """shared: photographs are pooled; gps, known: each device keeps its photographs and places them
    by GPS or by known poses."""
    single_owner: bool = False
    """Copy the devices' comparison pictures into the run."""
    upload: Annotated[UploadFormat, Option(group=JOINING)] = "float16"
    """Format that devices and edges send: exact, half the bytes, or a fifth."""
    seed: Annotated[int, Option(min=0, max=MAX_SEED)] = 0
    """Seed of every random choice."""
    sfm: SfmOptions = SfmOptions()
    plan: PlanOptions = PlanOptions()
    train: TrainOptions = TrainOptions()
    aggregate: AggregateOptions = AggregateOptions()
    refine: RefineOptions = RefineOptions()
    evaluate: EvaluateOptions = EvaluateOptions()
    execution: ExecutionOptions = ExecutionOptions()

    @property
    def emulated(self) -> bool:
        """Whether devices and edges run at their system's speeds and uplinks, in wall time."""
        return self.emulate is not None

    @property
    def system_file(self) -> Path | None:
        """The file of edges and devices, emulated or not."""
        return self.emulate or self.system

    @property
    def joining(self) -> AggregateConfig:
        """How models are joined and the scene is refined: the preset with the settings."""
        return with_joins(aggregate_preset(self.aggregate.preset), self.aggregate.settings, self.refine.settings)

    @property
    def cell_m(self) -> float | None:
        """Side of the raster's cells, None where the cloud may plan from positions."""
        if self.plan.raster_cell_m is not None:
            return self.plan.raster_cell_m or None
        if self.frames == "shared":
            return None
        from radiant_core.plan.counts.count_raster import DEFAULT_CELL_M  # scipy

        return DEFAULT_CELL_M

    def __post_init__(self) -> None:
        assert self.joining
        if self.system is not None and self.emulate is not None:
            raise BadInput("--system and --emulate both name a system: keep one of them.")
        if isinstance(self.plan.devices, int) and (self.system_file is not None or self.execution.executor == "network"):
            raise BadInput(
                f"--devices {self.plan.devices} divides this machine, and the run has machines of its own: use --devices all, or leave out "
                "the system or the network."
            )
        if self.emulated and self.execution.max_workers:
            raise BadInput("an emulated run runs all its devices at once: leave the number of workers out.")
        if self.execution.executor == "ray" and (self.emulated or self.execution.max_workers):
            raise BadInput("a Ray cluster has machines and processes of its own: leave out --emulate and --workers.")
        if self.execution.executor == "network":
            self._check_network()
        if not 0 <= self.seed <= MAX_SEED:
            raise BadInput(f"seed is {self.seed}, expected 0 to {MAX_SEED}.")
        if self.frames != "shared" and self.sfm.refine_poses:
            raise BadInput(
                f"--refine-poses adjusts all poses together, and with --frames {self.frames} devices have their own: leave it out."
            )
        if self.frames == "gps" and self.sfm.poses is not None:
            raise BadInput("poses are given and frames is 'gps', whose devices place their photographs: use --frames known or shared.")
        if self.frames != "shared" and self.plan.cut_by == "looks":
            reason = "where cameras look is known once they are reconstructed together"
            raise BadInput(f"--cut-by is looks: {reason}, and with --frames {self.frames} each device places its own: use --frames shared.")
        if (self.plan.asks_together or self.plan.mask_gradients) and (self.frames == "gps" or self.execution.executor == "network"):
            where = "over a network" if self.execution.executor == "network" else "with --frames gps"
            reason = "machines that train together need one exact frame and one owner's links"
            raise BadInput(f"{reason}, and {where} their models are joined: leave --within-edge, --between-edges and --mask-gradients out.")
        if self.frames == "shared" and self.single_owner:
            raise BadInput("with --frames shared there is one owner anyway: leave out --single-owner.")
        if self.frames != "shared" and (self.sfm.masks is not None or self.sfm.intake != AS_FOUND):
            options = "--masks, --mask-ignores, --film-frames and --panoramas are of photographs in one place"
            raise BadInput(f"{options}, and with --frames {self.frames} devices keep theirs: leave them out, or use --frames shared.")
        if self.frames != "shared" and self.sfm.placed_by_hand:
            reason = "--up, --north, --distance, --height and --gcp place one scene"
            raise BadInput(f"{reason}, and with --frames {self.frames} each device places its own: leave them out, or use --frames shared.")
        if (cross_validate := self.train.settings.get("cross_validate", "none")) != "none":
            reason = "is for a model that stands alone, by `radiant train`, and devices of a run are planned for one training each"
            raise BadInput(f"train.cross_validate is {cross_validate}, which {reason}: leave it out.")
        for path in (self.source, self.out, self.sfm.poses, self.sfm.masks, self.sfm.gcp, self.plan.file, self.evaluate.lpips_weights):
            if path is not None and not _is_text(path):
                raise BadInput(f"the path {str(path)!r} is not valid UTF-8, which some libraries cannot open: rename the folder.")

    def _check_network(self) -> None:
        """Raise BadInput for what a run over a network cannot do."""
        if self.frames == "shared":
            raise BadInput("over a network photographs stay with their devices: use --frames gps, or known where they bring poses.")
        if self.emulated or self.execution.max_workers:
            raise BadInput("a network has machines of its own: leave out --emulate and --workers.")
        if self.single_owner:
            raise BadInput("over a network pictures stay with their devices: leave out --single-owner.")
        if self.sfm.poses is not None:
            raise BadInput("over a network each device has the poses of its photographs: give them there, radiant node work --poses.")
        if self.plan.raster_cell_m == 0:
            raise BadInput("over a network no position leaves a device: give --raster-cell-m more than 0, or leave it out.")


def _is_text(path: Path) -> bool:
    try:
        str(path).encode()
    except UnicodeEncodeError:
        return False
    return True
