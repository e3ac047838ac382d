"""What a run can start from: a folder of photographs, a COLMAP project, or a Mill 19 folder. Decided once, by what lies there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

from radiant_core.errors import BadInput
from radiant_core.io.records import load_scene
from radiant_core.io.run_store import read_json
from radiant_core.scene import SfmScene

SourceKind = Literal["photographs", "colmap", "mill19"]


def detect_source(source: Path) -> tuple[SourceKind, Path, Path | None]:
    """Kind, folder of photographs, and the COLMAP model's folder if there is one.

    A folder with `images/` beside `sparse/` is a COLMAP project, one with `train/metadata` is Mill 19, any other holds photographs.
    Raises BadInput when it is no folder.
    """
    if not source.is_dir():
        raise BadInput(f"{source} is no folder: give a folder of photographs, a COLMAP project or a Mill 19 folder.")
    if (source / "train" / "metadata").is_dir():
        return "mill19", source, None
    if (source / "images").is_dir():
        for model in (source / "sparse" / "0", source / "sparse"):
            if any((model / f"cameras.{suffix}").is_file() for suffix in ("bin", "txt")):
                return "colmap", source / "images", model
        return "photographs", source / "images", None
    return "photographs", source, None


def all_files(source: Path, own: Path) -> list[tuple[str, int, int]]:
    """Name, size and time of change of every file of the source, used or not, without the run `own` where that lies inside."""
    own = own.resolve()
    files = [path for path in source.rglob("*") if path.is_file() and not path.resolve().is_relative_to(own)]
    return sorted((str(path.relative_to(source)), path.stat().st_size, path.stat().st_mtime_ns) for path in files)


def sfm_task(source: Path, sfm: dict[str, Any], masks: Path | None, placement: dict[str, Any]) -> dict[str, Any]:
    """What structure from motion is told: the source, fields of `SfmConfig`, a folder of masks, fields of `Placement` that differ from its
    own. Raises BadInput for a placement that makes no sense."""
    from radiant_core.sfm.world_frame.placement import Placement

    chosen, usual = asdict(Placement(**placement)), asdict(Placement())
    told = {name: value for name, value in chosen.items() if value != usual[name]}
    return {"source": str(source.resolve()), "sfm": sfm, "masks": None if masks is None else str(masks.resolve()), "placement": told}


def reconstruct_source(task: dict[str, Any], folder: Path, report: Callable[[Any], None]) -> Any:
    """The `SfmResult` of the source that a task names, made in `folder`."""
    from radiant_core.sfm.reconstruct import Placement, SfmConfig, reconstruct, scene_from_colmap, scene_from_mill19

    kind, images, model = detect_source(Path(task["source"]))
    masks = None if task.get("masks") is None else Path(task["masks"])
    placement = Placement(**task.get("placement", {}))
    if kind == "colmap":
        assert model is not None
        return scene_from_colmap(model, images, folder, report, masks, placement)
    if kind == "mill19":
        if placement != Placement():
            raise BadInput(f"{images} brings its own frame, which is used as it is: leave out --up, --distance and --height.")
        return scene_from_mill19(images, folder, report, masks=masks)
    return reconstruct(images, folder, SfmConfig(**task["sfm"]), report, masks, placement)


DELIVERED = "delivered"
"""Folder of a run in the field: the cameras and the plan of what its devices delivered, in the frame of its scene."""


def has_scene(folder: Path) -> bool:
    """Whether a folder is that of a run or of `radiant sfm`, with a scene in it."""
    return any((folder / name).is_file() for name in ("sfm/scene.safetensors", "scene.safetensors"))


def load_scene_of(folder: Path) -> SfmScene:
    """The scene in the folder of a run or of `radiant sfm`; BadInput where there is none."""
    inner = folder / "sfm" / "scene.safetensors"
    path = inner if inner.is_file() else folder / "scene.safetensors"
    if not path.is_file():
        raise BadInput(f"{folder} holds no scene.safetensors: give the folder of 'radiant sfm' or of a run.")
    return load_scene(path)


def scored_scene_of(folder: Path) -> tuple[SfmScene, tuple[str, ...], Path]:
    """As `load_scene_of`, without photographs that repeat others; what is told of those left out, and where its photographs are.

    Structure from motion leaves copies out; scenes of an earlier version, or made elsewhere, may hold some, and what is held out for
    scoring must not be trained on under another name.
    """
    from radiant_core.sfm.copies import without_repeats

    scene, images = load_scene_of(folder), images_of_scene(folder)
    return *without_repeats(scene, images), images


def images_of_scene(folder: Path) -> Path:
    """The folder of a scene's undistorted photographs; raises as `load_scene_of`."""
    owner = _owner_of_scene(folder)
    if not (owner / "result.json").is_file():
        raise BadInput(f"{owner} holds no result.json that names its photographs: give the folder of 'radiant sfm' or of a run.")
    return owner / read_json(owner / "result.json", ("images",))["images"]


def masks_of_scene(folder: Path) -> Path | None:
    """The folder of a scene's masks, as large as the photographs of `images_of_scene`; None where it has none."""
    owner = _owner_of_scene(folder)
    masks = read_json(owner / "result.json").get("masks") if (owner / "result.json").is_file() else None
    return None if masks is None else owner / masks


def _owner_of_scene(folder: Path) -> Path:
    return folder / "sfm" if (folder / "sfm" / "result.json").is_file() else folder
