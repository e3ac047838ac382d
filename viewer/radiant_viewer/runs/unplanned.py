"""Folders of `radiant train`, one machine's model, and of `radiant sfm`, which have no plan.

    training    manifest.json with a training's settings; scene.ply once trained; cameras in sfm/
                or in the source it names
    scene       scene.safetensors and result.json
Where a plan is required, they get one of a single region without borders, which is neither drawn
nor written. Read once per view.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np

from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.io.records import load_scene
from radiant_core.io.run_store import read_json
from radiant_core.numerics import FloatArray
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.render.trajectories import middle_box
from radiant_core.scene import SfmScene

FolderKind = Literal["run", "training", "scene"]
SCENE_NAMES = ("sfm/scene.safetensors", "scene.safetensors")
"""Its path in a run or a training, and in a folder of `radiant sfm`."""
EVERYTHING, ONE_MACHINE = "everything", "one machine"


def folder_kind(folder: Path) -> FolderKind:
    """Return the kind of a folder; "run" where nothing else is recognised."""
    if not (folder / "manifest.json").is_file():
        return "scene" if (folder / "scene.safetensors").is_file() and (folder / "result.json").is_file() else "run"
    return "training" if "validate" in _settings(folder) else "run"


def finish_command(folder: Path) -> str:
    """Return the command that completes a folder, for the end of a sentence."""
    kind = folder_kind(folder)
    if kind == "training":
        return f"finish it with 'radiant train … --out {folder} --resume'"
    if kind == "scene":
        return f"train a model of it with 'radiant train {folder} --out MODEL' and give that folder"
    return f"finish it with 'radiant run … --out {folder} --resume'"


def unplanned_scene(folder: Path) -> SfmScene:
    """Read cameras and points of a training or a scene; BadInput with the next step if missing."""
    places = [folder / name for name in SCENE_NAMES]
    source = _settings(folder).get("source") if folder_kind(folder) == "training" else None
    if isinstance(source, str):
        places += [Path(source) / name for name in SCENE_NAMES]
    for place in places:
        if place.is_file():
            return load_scene(place)
    if (folder / "scene.ply").is_file():
        raise BadInput(
            f"the cameras of {folder} are those of {source}, which holds no scene any more: put it back, or look at the model alone, "
            f"{folder / 'scene.ply'}."
        )
    raise BadInput(f"{folder} has no cameras yet: structure from motion is not finished, {finish_command(folder)}.")


def unplanned_photographs(folder: Path) -> Path | None:
    """Return the folder of undistorted photographs of a training or a scene; None if unknown."""
    source = source_of(folder)
    for owner in [folder / "sfm", folder, *([] if source is None else [source / "sfm", source])]:
        try:
            images = read_json(owner / "result.json", ("images",))["images"] if (owner / "result.json").is_file() else None
        except StoreDamaged:
            continue
        if isinstance(images, str):
            return owner / images
    return None


def source_of(folder: Path) -> Path | None:
    """Return what a run or a training was made from, by its manifest; None if unknown."""
    source = _settings(folder).get("source")
    return Path(source) if isinstance(source, str) else None


def has_unplanned_scene(folder: Path) -> bool:
    """Return whether `unplanned_scene` finds a scene."""
    try:
        unplanned_scene(folder)
    except BadInput:
        return False
    return True


def scene_box(scene: SfmScene) -> FloatArray:
    """Return lower and upper corner (2,3) of the ground below the cameras and of most points."""
    box = middle_box(scene.points if len(scene.points) else scene.cameras.centers)
    places = scene.cameras.centers[:, :2]
    box[0, :2], box[1, :2] = np.minimum(box[0, :2], places.min(axis=0)), np.maximum(box[1, :2], places.max(axis=0))
    return box


def single_region_plan(scene: SfmScene, num_trained: int) -> tuple[CloudPlan, tuple[EdgePlan, ...]]:
    """Return a plan of one region without borders, all `num_trained` cameras on one machine."""
    nobody = np.zeros(num_trained, np.int64)
    centers = scene.cameras.centers[:, :2]
    cloud = CloudPlan(
        method="captured",
        edge_ids=(EVERYTHING,),
        sites=centers.mean(axis=0, keepdims=True) if len(centers) else np.zeros((1, 2)),
        weights=np.zeros(1),
        borders=(np.zeros((0, 2)),),
        edge_of_camera=nobody,
        edge_time_s=np.zeros(1),
        lower_bound_s=0.0,
        status="stopped",
        certified=False,
    )
    edge = EdgePlan(
        edge_id=EVERYTHING,
        device_ids=(ONE_MACHINE,),
        camera_indices=np.arange(num_trained),
        device_of_camera=nobody,
        strips=(np.zeros((0, 2)),),
        device_time_s=np.zeros(1),
    )
    return cloud, (edge,)


def _settings(folder: Path) -> dict[str, Any]:
    """Return the manifest's settings, empty where unreadable; readers that need it raise."""
    if not (folder / "manifest.json").is_file():
        return {}
    try:
        record = read_json(folder / "manifest.json")
    except StoreDamaged:
        return {}
    config = record.get("config") if isinstance(record, dict) else None
    return config if isinstance(config, dict) else {}
