"""Workers of a device whose photographs nobody else has heard of (`--executor network`).

    count      how many photographs it has                     → count.json
    raster     those that it trains on in cells, no position   → raster.json
    own_field  the same as `field`                             → as `field`

What a run on one machine writes into their tasks, names above all, these find themselves: where the
photographs are stands in own_source.json of the device's folder, which its owner wrote.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from radiant_app.reporting import EventReporter
from radiant_app.workers.field_nodes import OWN_POSES, run_field, run_positions
from radiant_app.workers.redaction import OWN_SOURCE
from radiant_app.workers.tasks import CountTask, FieldTask, OwnFieldTask, PlacingTask, PositionsTask, RasterTask
from radiant_core.errors import BadInput
from radiant_core.hierarchy.messages import DeviceSettings
from radiant_core.io.photos.folders import photograph_names
from radiant_core.io.run_store import read_json, write_json
from radiant_core.plan.counts.count_raster import middles_of_cells
from radiant_core.sfm.given_poses import GivenPoses, read_given_poses

COUNT_NAME, RASTER_NAME = "count.json", "raster.json"
HELD_OUT_EVERY = 8
"""As of `radiant_core.evaluate.split.held_out_mask`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class OwnPhotographs:
    """The photographs of this device."""

    folder: Path
    names: tuple[str, ...]
    """In the order of the poses where these are known, else sorted."""
    poses: GivenPoses | None

    def held_out(self, first: int) -> tuple[str, ...]:
        """The names that are held out, in the order of `names`."""
        held_out = set(sorted(self.names)[first::HELD_OUT_EVERY])
        return tuple(name for name in self.names if name in held_out)

    def trained_on(self, first: int) -> tuple[str, ...]:
        """The other names."""
        held_out = set(self.held_out(first))
        return tuple(name for name in self.names if name not in held_out)


def save_own_source(folder: Path, photographs: Path, poses: Path | None) -> None:
    """Tell the workers in a device's folder where its photographs are."""
    write_json(folder / OWN_SOURCE, {"photographs": str(photographs.resolve()), "poses": None if poses is None else str(poses.resolve())})


def find_own(folder: Path, frames: str) -> OwnPhotographs:
    """The photographs that a device's folder leads to; BadInput where there are none, or no poses
    for `known`."""
    record = read_json(folder / OWN_SOURCE, ("photographs", "poses"))
    photographs = Path(record["photographs"])
    if not photographs.is_dir():
        raise BadInput("the folder of photographs that --photos named is gone: start `radiant node work` with the one that they are in.")
    names = photograph_names(photographs)
    if frames != "known":
        return OwnPhotographs(folder=photographs, names=names, poses=None)
    poses = read_given_poses(photographs, None if record["poses"] is None else Path(record["poses"]), "own")
    if poses.model is None:
        raise BadInput("the poses of this device are no COLMAP model: give one with --poses.")
    here = set(names)
    return OwnPhotographs(folder=photographs, names=tuple(name for name in poses.cameras.names if name in here), poses=poses)


def run_count(folder: Path, task: CountTask, reporter: EventReporter) -> Sequence[str]:
    """Count the photographs of the device in the folder above."""
    del reporter
    write_json(folder / COUNT_NAME, {"num_photographs": len(find_own(folder.parent, task.frames).names)})
    return [COUNT_NAME]


def run_raster(folder: Path, task: RasterTask, reporter: EventReporter) -> Sequence[str]:
    """Count the photographs of the device in the folder above that it trains on, in cells."""
    photographs = find_own(folder.parent, task.frames)
    if photographs.poses is None:
        held_out = photographs.held_out(task.first_held_out)
        positions_task = PositionsTask(source=str(photographs.folder), cell_m=task.cell_m, held_out=held_out, owned=True)
        return run_positions(folder, positions_task, reporter)
    centers = photographs.poses.cameras.named(photographs.trained_on(task.first_held_out)).centers
    cells, numbers = np.unique(middles_of_cells(centers[:, :2], task.cell_m), axis=0, return_counts=True)
    record: dict[str, Any] = {"num_photographs": len(photographs.names), "num_unplaced": 0, "altitude_m": None}
    record["cells"] = [[float(x), float(y), int(number)] for (x, y), number in zip(cells, numbers, strict=True)]
    write_json(folder / RASTER_NAME, record)
    return [RASTER_NAME]


def run_own_field(folder: Path, task: OwnFieldTask, reporter: EventReporter) -> Sequence[str]:
    """Structure from motion, frame and model of the device's own photographs, see `run_field`."""
    photographs = find_own(folder, task.frames)
    names, held_out = photographs.trained_on(task.first_held_out), photographs.held_out(task.first_held_out)
    if photographs.poses is not None:
        for message in photographs.poses.unnamed_notes:
            reporter.warn(message)
        if photographs.poses.check is not None:
            reporter.decide(replace(photographs.poses.check, stage=reporter.stage))
        (folder / OWN_POSES).parent.mkdir(exist_ok=True)
        photographs.poses.deal([*names, *held_out], (folder / OWN_POSES).parent)
    placing = PlacingTask(
        frames=task.frames,
        source=str(photographs.folder),
        names=names,
        held_out=held_out,
        fetch=False,
        origin=task.origin,
        sfm=task.sfm,
        poses=None if photographs.poses is None else OWN_POSES,
    )
    settings = {field.name: getattr(task, field.name) for field in fields(DeviceSettings)}
    return run_field(folder, FieldTask(placing=placing, changed=(), **settings), reporter)
