"""`RunView`: the contents of a run, a training or a scene, read and checked to fit together.

Read once per window or screenshot. The error for a broken or unfinished run names what is missing
and what makes it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.evaluate.split import held_out_mask
from radiant_core.geometry.cleaning import Cleaning
from radiant_core.geometry.cleaning_file import CLEANING_NAME, cleaning_path, load_cleaning
from radiant_core.geometry.support import Support
from radiant_core.io.ply import load_ply
from radiant_core.io.records import load_plan, load_scene
from radiant_core.io.run_store import read_json, stays_inside
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from radiant_viewer.layers.camera_roles import NOBODY, CameraRoles, camera_roles
from radiant_viewer.layers.ortho_layer import ORTHO
from radiant_viewer.runs.cleaned_model import CleanedModel, cleaned_model, find_support, surroundings
from radiant_viewer.runs.field_files import local_file_names
from radiant_viewer.runs.growing_model import growing_files, growing_model
from radiant_viewer.runs.unplanned import FolderKind, finish_command, folder_kind, has_unplanned_scene, single_region_plan, unplanned_scene

SCENE_NAME, PLAN_NAME, PLY_NAME, METRICS_NAME = "sfm/scene.safetensors", "plan.json", "scene.ply", "metrics.json"
DELIVERED = "delivered"
"""Folder of a run in the field: poses and plan of the delivered models."""
FileStamps = tuple[tuple[str, int, int], ...]
COMPARISON_KINDS = ("photographs", "renders", "differences")
"""Folders below pictures/ with one PNG per held-out photograph, in the order they are shown."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RunView:
    """The present state of a run: scene and plan always, model and figures once they exist.

    held_out: names of the held-out cameras; psnr_db: figures of held-out photographs by name, None
    before evaluation. Where photographs stayed with their devices (`in_field`), cameras are
    numbered, held-out photographs have no pose here (`unplaced`, sorted), and `files` maps numbers
    to file names if the devices' folders are inside the run's. kind: what the folder is; the plan
    of a training or a scene is one region without borders. model: as it was trained, and as its
    cleaning leaves it.
    """

    folder: Path
    scene: SfmScene
    cloud_plan: CloudPlan
    edge_plans: tuple[EdgePlan, ...]
    model: CleanedModel | None
    held_out: frozenset[str]
    psnr_db: Mapping[str, float] | None
    roles: CameraRoles
    in_field: bool = False
    unplaced: tuple[str, ...] = ()
    files: Mapping[str, str] = field(default_factory=dict)
    kind: FolderKind = "run"

    @property
    def splats(self) -> Splats | None:
        """The model without what its cleaning leaves out."""
        return None if self.model is None else self.model.splats

    @property
    def is_growing(self) -> bool:
        """Whether the model is what the nodes of a run at work have made so far."""
        return self.kind == "run" and self.model is not None and not (self.folder / PLY_NAME).is_file()

    @property
    def photographs(self) -> tuple[str, ...]:
        """Names of the scene's cameras, then of the held-out photographs without a pose."""
        return (*self.scene.cameras.names, *self.unplaced)

    @property
    def placed_psnr_db(self) -> dict[str, float]:
        """The figures of photographs whose cameras are in the scene."""
        names = set(self.scene.cameras.names)
        return {name: value for name, value in (self.psnr_db or {}).items() if name in names}

    def owner(self, index: int) -> str:
        """Return the device of photograph `index` of `photographs`, empty where there is none."""
        if index < len(self.scene.cameras):
            device = int(self.roles.device_of_camera[index])
            return self.roles.device_ids[device] if device >= 0 else ""
        owner = self.photographs[index].rpartition("/")[0]
        return owner if owner in self.roles.device_ids else ""

    @property
    def unit(self) -> str:
        """Unit of the world coordinates, "m" or "units"."""
        return self.scene.frame.unit


def load_run_view(folder: Path, *, with_files: bool = False, as_trained: bool = False, growing: bool = False) -> RunView:
    """Read the run, training or scene in `folder`, that of `radiant run`, `train` or `sfm`.

    Args:
        folder: the folder that the command wrote.
        with_files: fill `RunView.files` from the devices' records; for a window, which writes
            nothing of them into the run.
        as_trained: the whole model, whatever its cleaning leaves out.
        growing: before there is a scene.ply, what the nodes of a run have made so far; to look at.

    Returns:
        Scene and plan, and the model and the figures if there are any yet.

    Raises:
        BadInput: the folder is of none of these commands, or has no plan yet.
        StoreDamaged: a file is broken.
    """
    folder = Path(folder)
    if folder.is_file():
        raise BadInput(
            f"{folder} is a file, and the folder of a run is needed here: a model alone is opened by 'radiant inspect' without --web, "
            "'radiant inspect --page' and 'radiant render'."
        )
    if not folder.is_dir():
        raise BadInput(f"there is neither a folder nor a file {folder}: name the folder that 'radiant run --out' made, or a model's file.")
    if (kind := folder_kind(folder)) != "run":
        return _unplanned_view(folder, kind, as_trained)
    if (folder / DELIVERED).is_dir():
        # Devices in the field send poses of training photographs only.
        _require_file(folder, f"{DELIVERED}/plan.json", "the run is not finished")
        scene, plan_path = load_scene(folder / DELIVERED / "scene.safetensors"), folder / DELIVERED / "plan.json"
        held_out: frozenset[str] = frozenset()
        psnr_db = _image_psnr_db(folder / METRICS_NAME) if (folder / METRICS_NAME).is_file() else None
        in_field = True
    else:
        _require_file(folder, SCENE_NAME, "structure from motion is not finished")
        _require_file(folder, PLAN_NAME, "the plan is not finished")
        scene, plan_path = load_scene(folder / SCENE_NAME), folder / PLAN_NAME
        names = scene.cameras.names
        psnr_db = _image_psnr_db(folder / METRICS_NAME) if (folder / METRICS_NAME).is_file() else None
        held_out = frozenset(psnr_db or (name for name, is_held in zip(names, held_out_mask(names), strict=True) if is_held))
        in_field = False
    cloud_plan, edge_plans = load_plan(plan_path)
    roles = camera_roles(scene.cameras, cloud_plan, edge_plans, held_out)
    model = _model(folder, scene, cloud_plan, as_trained)
    if model is None and growing and not in_field and (parts := growing_model(folder, edge_plans)) is not None:
        model = cleaned_model(parts, Cleaning(), surroundings(folder, scene, cloud_plan, len(parts)))
    return RunView(
        folder=folder,
        scene=scene,
        cloud_plan=cloud_plan,
        edge_plans=edge_plans,
        model=model,
        held_out=held_out,
        psnr_db=psnr_db,
        roles=roles,
        in_field=in_field,
        unplaced=tuple(sorted(set(psnr_db or ()) - set(scene.cameras.names))),
        files=local_file_names(folder, roles.device_ids) if in_field and with_files else {},
    )


def _model(folder: Path, scene: SfmScene, cloud_plan: CloudPlan, as_trained: bool) -> CleanedModel | None:
    if not (folder / PLY_NAME).is_file():
        return None
    whole = load_ply(folder / PLY_NAME)
    cleaning = Cleaning() if as_trained else load_cleaning(cleaning_path(folder))
    return cleaned_model(whole, cleaning, surroundings(folder, scene, cloud_plan, len(whole)))


def _unplanned_view(folder: Path, kind: FolderKind, as_trained: bool) -> RunView:
    scene = unplanned_scene(folder)
    is_scored = kind == "training" and (folder / METRICS_NAME).is_file()
    psnr_db = _image_psnr_db(folder / METRICS_NAME) if is_scored else None
    names = scene.cameras.names
    # Training drops copies of photographs before it splits: its figures name the held-out ones.
    is_held_out = np.isin(names, list(psnr_db)) if psnr_db else held_out_mask(names)
    held_out = frozenset(name for name, is_held in zip(names, is_held_out, strict=True) if is_held)
    cloud_plan, edge_plans = single_region_plan(scene, int((~is_held_out).sum()))
    roles, nobody = camera_roles(scene.cameras, cloud_plan, edge_plans, held_out), np.full(len(is_held_out), NOBODY, np.int64)
    model = _model(folder, scene, cloud_plan, as_trained) if kind == "training" else None
    return RunView(
        folder=folder,
        scene=scene,
        cloud_plan=cloud_plan,
        edge_plans=edge_plans,
        model=model,
        held_out=held_out,
        psnr_db=psnr_db,
        roles=replace(roles, edge_of_camera=nobody, device_of_camera=nobody),
        kind=kind,
    )


def is_planned(folder: Path) -> bool:
    """Return whether a run has a plan to show, or a training its cameras."""
    if folder_kind(folder) != "run":
        return has_unplanned_scene(folder)
    if (folder / DELIVERED).is_dir():
        return (folder / DELIVERED / PLAN_NAME).is_file()
    return (folder / SCENE_NAME).is_file() and (folder / PLAN_NAME).is_file()


def file_stamps(path: Path) -> FileStamps:
    """Return name, time and length of the files that `load_run_view` reads, or of the file `path`;
    equal stamps mean equal content."""
    delivered = (f"{DELIVERED}/{PLAN_NAME}", f"{DELIVERED}/scene.safetensors")
    names = (SCENE_NAME, "scene.safetensors", PLAN_NAME, PLY_NAME, METRICS_NAME, CLEANING_NAME, ORTHO, *delivered)
    stamps = []
    files = [path / name for name in names] if path.is_dir() else [path, cleaning_path(path)]
    if path.is_dir() and not (path / PLY_NAME).is_file():
        files += growing_files(path)
    for file in files:
        with suppress(OSError):
            stat = file.stat()
            stamps.append((file.name, stat.st_mtime_ns, stat.st_size))
    return tuple(stamps)


def plan_path(folder: Path) -> Path:
    """Return the path of a run's plan; with `delivered` in a run in the field."""
    return folder / DELIVERED / PLAN_NAME if (folder / DELIVERED).is_dir() else folder / PLAN_NAME


def require_splats(run: RunView) -> Splats:
    """Return the run's model; BadInput with the command that makes it where there is none."""
    if run.splats is None:
        raise BadInput(no_model_text(run.folder))
    return run.splats


def comparison_paths(run: RunView, name: str) -> tuple[Path, Path, Path]:
    """Return the files of photograph, render and difference of a held-out photograph; BadInput
    where the run has none, or the name leads out of the folder of pictures."""
    if not stays_inside(name):
        raise BadInput(f"{name[:80]!r} is no name of a photograph inside a run: score the run again, or leave out who sent it.")
    paths = tuple(run.folder / "pictures" / kind / f"{name}.png" for kind in COMPARISON_KINDS)
    missing = [path for path in paths if not path.is_file()]
    if missing and run.in_field:
        owner = name.rpartition("/")[0]
        raise BadInput(
            f"the comparison pictures of {name!r} stayed with device {owner}, which sent its figures alone: where all devices are yours,"
            " 'radiant run … --single-owner' collects them."
        )
    if missing:
        raise BadInput(
            f"{missing[0]} is missing: the pictures of {name!r} stayed with the owner of the photograph, "
            f"or the run is not evaluated; {finish_command(run.folder)}."
        )
    return paths[0], paths[1], paths[2]


def run_support(run: RunView) -> Support | None:
    """Return which photographs constrain each Gaussian of a run's model; None where that was not
    measured, or of another model. StoreDamaged for a broken file."""
    if run.model is None:
        return None
    support = find_support(run.folder, len(run.model.whole))
    return support if support is None or run.model.splats is run.model.whole else support.select(run.model.cleaned.kept)


def canonical_path(run: RunView, name: str) -> Path | None:
    """Return the file of a held-out photograph's render in the model's own light; None where light
    is not modelled."""
    path = run.folder / "pictures" / "canonical" / f"{name}.png"
    return path if stays_inside(name) and path.is_file() else None


def no_model_text(folder: Path) -> str:
    """Return why a folder has no model, and what makes one."""
    state = {
        "run": "the run is not finished",
        "training": "the training is not finished",
        "scene": "'radiant sfm' makes cameras and points",
    }
    return f"{folder} has no {PLY_NAME}: {state[folder_kind(folder)]}, {finish_command(folder)}."


def _require_file(folder: Path, name: str, reason: str) -> None:
    if not (folder / "manifest.json").is_file():
        raise BadInput(f"{folder} is no run: it has no manifest.json; name the folder that 'radiant run --out' made, or train or sfm.")
    if not (folder / name).is_file():
        raise BadInput(f"{folder} has no {name}: {reason}, {finish_command(folder)}.")


def _image_psnr_db(path: Path) -> dict[str, float]:
    """PSNR by photograph of metrics.json: {"images": [{"name", "psnr_db", …}, …], …}."""
    record: Any = read_json(path)
    rows = record.get("images") if isinstance(record, dict) else None
    if not isinstance(rows, list) or not all(_is_figure(row) for row in rows):
        raise StoreDamaged(f"{path} has no list 'images' of names and psnr_db: run the evaluation again.")
    return {row["name"]: float(row["psnr_db"]) for row in rows}


def _is_figure(row: Any) -> bool:
    if not (isinstance(row, dict) and isinstance(row.get("name"), str)):
        return False
    value = row.get("psnr_db")
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
