"""`RunConfig`: what one run was asked to do. Written into the run's manifest, so that `--resume` knows it."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from radiant_core.aggregate.config import AggregatePreset, aggregate_preset
from radiant_core.errors import BadInput
from radiant_core.evaluate.image_error import LpipsNetwork
from radiant_core.io.transport.upload import UploadFormat
from radiant_core.plan.counts.count_raster import DEFAULT_CELL_M
from radiant_core.sfm.world_frame.placement import Placement
from radiant_core.train.config import Preset
from radiant_core.train.needs import Overrides

Frames = Literal["shared", "gps", "known"]
"""shared: one owner pools the photographs and places them at once; gps, known: every device places its own, by GPS or given poses."""
PlanMethod = Literal["exact", "paper", "voronoi", "even"]
RunPreset = Literal["default", "paper"]
"""default: ours; paper: the paper's plan (Voronoi, Alg. 1, RTP), training (20,000 steps) and aggregation, nothing skipped."""

_RUN_PRESETS: dict[str, dict[str, Any]] = {
    "default": {"plan_method": "exact", "train_preset": "default", "aggregate_preset": "default", "matching": "auto", "upload": "float16"},
    # exhaustive: neighbours by GPS alone would skip pairs.
    "paper": {
        "plan_method": "paper",
        "train_preset": "paper",
        "aggregate_preset": "paper",
        "matching": "exhaustive",
        "upload": "float32",
    },
}


def run_preset(name: str, **given: Any) -> dict[str, Any]:
    """Fields of `RunConfig` that a preset sets; what is `given` and not None wins. BadInput lists the presets there are."""
    if name not in _RUN_PRESETS:
        raise BadInput(f"preset {name!r} is unknown: use one of {', '.join(get_args(RunPreset))}.")
    return {**_RUN_PRESETS[name], **{field: value for field, value in given.items() if value is not None}}


@dataclass(frozen=True, kw_only=True)
class RunConfig:
    """One run from photographs to a scene."""

    source: Path
    """Folder of photographs, a COLMAP project (images/ and sparse/), or a Mill 19 folder."""
    out: Path
    """The run's folder; made by the run."""
    system: Path | None = None
    """TOML of edges and devices; None: two edges with two equal devices each."""
    emulated: bool = False
    """Run devices and edges at the speeds and behind the uplinks of `system`, in wall time."""
    train_preset: Preset = "default"
    """How well to train, see `radiant_core.train.config.Preset`."""
    overrides: Overrides = Overrides()
    """Sizes and steps asked for by number."""
    aggregate_preset: AggregatePreset = "default"
    """How edges join models."""
    plan_method: PlanMethod = "exact"
    """exact: least makespan; paper: the paper's Alg. 1; voronoi: nearest edge; even: equal counts."""
    frames: Frames = "shared"
    """Who holds photographs, see `Frames`."""
    poses: Path | None = None
    """For frames "known": a COLMAP model with the poses of the photographs; None where the source brings its own."""
    masks: Path | None = None
    """Folder of masks, see `radiant_core.io.photos.masks`; None: photographs are used whole."""
    up: str | None = None
    """Which way is up, see `radiant_core.sfm.world_frame.placement.Placement`; None: auto."""
    distance: str | None = None
    """How far apart two photographs were taken: PHOTO,PHOTO,METRES."""
    height_m: float | None = None
    """How high the cameras were over the ground that they see, median."""
    plan: Path | None = None
    """A plan made before capture: every photograph goes to the device that was to take it; None: plan from what was captured."""
    raster_cell_m: float | None = None
    """Side of the cells of the count raster that the cloud plans from; 0: it plans from positions; None: 0 with frames shared, else 5 m."""
    single_owner: bool = False
    """With frames "gps" or "known": all devices are one owner's, so comparison pictures may be collected in the run."""
    matching: Literal["auto", "spatial", "exhaustive"] = "auto"
    """Which photographs are compared: neighbours by GPS, or all with all."""
    upload: UploadFormat = "float16"
    """What devices and edges send: exact, half the bytes, or SPZ with a fifth of them."""
    teachers: Literal["early", "late"] = "early"
    """early: an edge renders the views of a device when it has arrived; late: of all when the last has. The result is the same."""
    lpips_weights: Path | None = None
    """Weights for LPIPS, see `radiant_core.evaluate.lpips.load_lpips`; None: LPIPS is not measured."""
    lpips_network: LpipsNetwork = "vgg"
    """Network of LPIPS."""
    seed: int = 0
    """Seed of every random choice."""
    max_workers: int = 0
    """Processes at a time; 0: one per core."""
    checkpoint_every_s: float = 10.0
    """Seconds between two checkpoints of a training: what a kill may lose."""
    executor: Literal["local", "ray"] = "local"
    """Where nodes run: as processes of this machine, or as tasks of a Ray cluster of one owner's machines."""
    address: str | None = None
    """With executor "ray": host:port of the cluster's head, or "local" for a cluster on this machine alone."""
    deadline_factor: float = 10.0
    """A device or edge that takes so many times its planned time, corrected by what was measured, is given up; 0: never."""

    @property
    def early_teachers(self) -> bool:
        """Whether teachers are nodes of their own; an emulated edge renders them itself, at its own speed, and one that leaves joining to
        the cloud needs other views."""
        pools = self.frames == "shared" and aggregate_preset(self.aggregate_preset).edges_pool
        return self.teachers == "early" and not (self.emulated or pools)

    @property
    def placement(self) -> dict[str, Any]:
        """The fields of `Placement`."""
        return {"up": self.up or "auto", "distance": self.distance, "height_m": self.height_m}

    @property
    def cell_m(self) -> float | None:
        """Side of the raster's cells, None where the cloud may plan from positions."""
        if self.raster_cell_m is None:
            return None if self.frames == "shared" else DEFAULT_CELL_M
        return self.raster_cell_m or None

    @property
    def num_workers(self) -> int:
        """Processes at a time."""
        return self.max_workers or os.cpu_count() or 1

    def __post_init__(self) -> None:
        if self.max_workers < 0:
            raise BadInput(f"max_workers is {self.max_workers}, expected 0 (one per core) or more.")
        if not (self.deadline_factor == 0 or 1 <= self.deadline_factor < float("inf")):
            raise BadInput(f"the deadline is {self.deadline_factor} times the planned time, expected 1 or more, or 0 for none.")
        if (self.executor == "ray") != (self.address is not None):
            raise BadInput("--executor ray and --address belong together: give the address of the cluster's head, host:port, or local.")
        if self.executor == "ray" and (self.emulated or self.max_workers):
            raise BadInput("a Ray cluster has machines and processes of its own: leave out --emulate and --workers.")
        if self.emulated and (self.system is None or self.max_workers):
            raise BadInput("an emulated run needs a system file and runs all its devices at once: leave the number of workers out.")
        if self.raster_cell_m is not None and not 0 <= self.raster_cell_m < math.inf:
            raise BadInput(f"raster_cell_m is {self.raster_cell_m}, expected a side in metres, or 0 to plan from positions.")
        if not 0 <= self.seed < 2**31:
            raise BadInput(f"seed is {self.seed}, expected 0 to {2**31 - 1}.")
        if self.frames != "known" and self.poses is not None:
            raise BadInput(f"poses are given and frames is {self.frames!r}: give them with --frames known.")
        if self.frames == "shared" and self.single_owner:
            raise BadInput("with --frames shared there is one owner anyway: leave out --single-owner.")
        if self.frames != "shared" and self.masks is not None:
            raise BadInput(f"masks are given and frames is {self.frames!r}, whose devices keep their photographs: use --frames shared.")
        if self.frames != "shared" and (self.up, self.distance, self.height_m) != (None, None, None):
            told = "--up, --distance and --height turn and scale one scene"
            raise BadInput(f"{told}, and with --frames {self.frames} each device places its own: leave them out, or use --frames shared.")
        Placement(**self.placement)
        for path in (self.source, self.out, self.poses, self.masks, self.plan, self.lpips_weights):
            if path is not None and not _is_text(path):
                raise BadInput(f"the path {str(path)!r} is not valid UTF-8, which some libraries cannot open: rename the folder.")


def _is_text(path: Path) -> bool:
    try:
        str(path).encode()
    except UnicodeEncodeError:
        return False
    return True
