"""A scene as a project that other trainers open: cameras, points, photographs, masks. Once per
export.

    colmap      sparse/0/{cameras,images,points3D}.bin, images/, masks/NAME.png
    nerfstudio  transforms.json, points.ply, images/, masks/NAME.png

Photographs have no lens distortion, so cameras are PINHOLE; in transforms.json OPENCV without
distortion, which OpenSplat, nerfstudio and Brush all know. There poses are camera → world with x
right, y up, z back; the world is the scene's own, z up, so that `applied_transform` is the identity
(without it nerfstudio takes older files' turn for granted). The 2D points are where the cameras
project the points, so their errors are zero by construction.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput, CannotWrite
from radiant_core.export.scene import colmap_model
from radiant_core.io.colmap.binary_writer import write_binary_model
from radiant_core.io.photos.masks import mask_name, save_mask
from radiant_core.io.run_store import atomic_writer, require_room, write_atomic
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene

IMAGES, MASKS, POINTS = "images", "masks", "points.ply"
CAMERA_FROM_OPENGL = np.diag([1.0, -1.0, -1.0])
_POINT = np.dtype([("xyz", "<f4", 3), ("color", "u1", 3)])


@dataclass(frozen=True, kw_only=True)
class ProjectPhotographs:
    """Where the photographs of a scene and their masks lie, by the cameras' names."""

    images: Path | None
    """None where they stay with their devices."""
    masks: Path | None = None


@dataclass(frozen=True, kw_only=True)
class ProjectCounts:
    """What was copied into a project, and which photographs were not there."""

    photographs: int
    masks: int
    missing: tuple[str, ...]


def save_colmap_project(
    folder: Path, scene: SfmScene, photographs: ProjectPhotographs, report: Callable[[int, int], None] = lambda num_done, total: None
) -> ProjectCounts:
    """Write the project into `folder`; `report(done, total)` after each photograph. BadInput
    without cameras, CannotWrite where the disk is full."""
    _require_cameras(folder, scene)
    write_binary_model(folder / "sparse" / "0", colmap_model(scene))
    return _copy_photographs(folder, scene.cameras, photographs, report, all_masked=False)


def save_nerfstudio_project(
    folder: Path, scene: SfmScene, photographs: ProjectPhotographs, report: Callable[[int, int], None] = lambda num_done, total: None
) -> ProjectCounts:
    """As `save_colmap_project`, for nerfstudio, which wants a mask of every photograph or of
    none."""
    _require_cameras(folder, scene)
    counts = _copy_photographs(folder, scene.cameras, photographs, report, all_masked=True)
    _save_points(folder / POINTS, scene)
    write_atomic(folder / "transforms.json", json.dumps(_transforms(scene.cameras, masked=counts.masks > 0), indent=1).encode())
    return counts


def _require_cameras(folder: Path, scene: SfmScene) -> None:
    if not len(scene.cameras):
        raise BadInput(f"cannot write {folder}: the scene has no cameras.")


def _transforms(cameras: Cameras, *, masked: bool) -> dict[str, Any]:
    lenses = [_lens(K, size_wh) for K, size_wh in zip(cameras.Ks, cameras.sizes_wh.tolist(), strict=True)]
    shared = lenses[0] if all(lens == lenses[0] for lens in lenses) else {}
    frames = []
    for index, name in enumerate(cameras.names):
        about = {} if shared else lenses[index]
        mask = {"mask_path": f"{MASKS}/{mask_name(name)}"} if masked else {}
        frames.append(
            {
                "file_path": f"{IMAGES}/{name}",
                "transform_matrix": world_from_opengl(cameras.cam_from_world[index]).tolist(),
                **about,
                **mask,
            }
        )
    identity = np.eye(4)[:3].tolist()
    return {"camera_model": "OPENCV", **shared, "applied_transform": identity, "ply_file_path": POINTS, "frames": frames}


def world_from_opengl(cam_from_world: FloatArray) -> FloatArray:
    """The pose (4,4) of a camera (4,4) whose x is right, y up and z back."""
    pose = np.eye(4)
    pose[:3, :3] = cam_from_world[:3, :3].T @ CAMERA_FROM_OPENGL
    pose[:3, 3] = -cam_from_world[:3, :3].T @ cam_from_world[:3, 3]
    return pose


def _lens(K: FloatArray, size_wh: Sequence[int]) -> dict[str, float]:
    straight = dict.fromkeys(("k1", "k2", "p1", "p2"), 0.0)
    focal = {"fl_x": float(K[0, 0]), "fl_y": float(K[1, 1]), "cx": float(K[0, 2]), "cy": float(K[1, 2])}
    return {"w": int(size_wh[0]), "h": int(size_wh[1]), **focal, **straight}


def _save_points(path: Path, scene: SfmScene) -> None:
    rows = np.zeros(len(scene.points), _POINT)
    rows["xyz"], rows["color"] = scene.points, scene.colors
    properties = "".join(f"property float {axis}\n" for axis in "xyz") + "".join(f"property uchar {c}\n" for c in ("red", "green", "blue"))
    with atomic_writer(path) as file:
        file.write(f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n{properties}end_header\n".encode())
        file.write(rows.tobytes())


def _copy_photographs(
    folder: Path, cameras: Cameras, photographs: ProjectPhotographs, report: Callable[[int, int], None], *, all_masked: bool
) -> ProjectCounts:
    """Copy photographs and masks; a photograph without a mask gets a white one where `all_masked`
    and there is any."""
    if photographs.images is None:
        return ProjectCounts(photographs=0, masks=0, missing=())
    masks = photographs.masks
    any_masked = masks is not None and any((masks / mask_name(name)).is_file() for name in cameras.names)
    missing, num_masks = [], 0
    for num_done, (name, size_wh) in enumerate(zip(cameras.names, cameras.sizes_wh.tolist(), strict=True), start=1):
        if (photographs.images / name).is_file():
            _copy(photographs.images / name, folder / IMAGES / name)
        else:
            missing.append(name)
        if masks is not None and (masks / mask_name(name)).is_file():
            _copy(masks / mask_name(name), folder / MASKS / mask_name(name))
            num_masks += 1
        elif any_masked and all_masked:
            save_mask(folder / MASKS / mask_name(name), np.ones(size_wh[::-1], bool))
            num_masks += 1
        report(num_done, len(cameras))
    return ProjectCounts(photographs=len(cameras) - len(missing), masks=num_masks, missing=tuple(missing))


def _copy(source: Path, target: Path) -> None:
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, target)
    except OSError as error:
        require_room(target.parent)
        raise CannotWrite(f"cannot copy {source} to {target}: {error.strerror or error}: choose another output folder.") from error
