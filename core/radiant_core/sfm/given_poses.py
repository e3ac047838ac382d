"""Poses that come with the photographs: a COLMAP model, or a Mill 19 folder. Once per run.

The world is that of the poses, as it is; z must be up for a plan of the ground.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.io.colmap.model import read_model
from radiant_core.io.colmap.records import ColmapModel, check_model
from radiant_core.io.colmap.text import write_model
from radiant_core.io.mill19 import read_mill19
from radiant_core.io.records import save_cameras
from radiant_core.sfm.known_poses import NO_POINTS
from radiant_core.sfm.world_frame.up import roll_deg

NO_POINTS_2D, NO_IDS = np.zeros((0, 2)), np.zeros(0, np.int64)
MAX_ROLL_DEG = 30.0
"""Photographs are level or look down: with x axes farther from the horizontal, z is not up."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GivenPoses:
    """Poses of photographs in `photos`; `model`: their COLMAP model, whose lenses may distort."""

    cameras: Cameras
    """Centres and rotations; the calibration is right only where `model` is None."""
    photos: Path
    model: ColmapModel | None

    def deal(self, names: Sequence[str], folder: Path) -> bool:
        """Write these poses into `folder`: poses/, a COLMAP model (True), or a safetensors file."""
        if self.model is None:
            save_cameras(folder / "poses.safetensors", self.cameras.named(names))
            return False
        shutil.rmtree(folder / "poses", ignore_errors=True)
        (folder / "poses").mkdir()
        wanted = set(names)
        images = [replace(image, points2d=NO_POINTS_2D, point3d_ids=NO_IDS) for image in self.model.images if image.name in wanted]
        cameras = [self.model.cameras[camera_id] for camera_id in sorted({image.camera_id for image in images})]
        write_model(folder / "poses", check_model(cameras, images, NO_POINTS, str(folder)))
        return True


def read_given_poses(source: Path, model_folder: Path | None) -> GivenPoses:
    """The poses in `model_folder`, or else those beside the photographs of `source`. BadInput where
    there are none, or where z is not up in them."""
    if model_folder is None and (source / "train" / "metadata").is_dir():
        return GivenPoses(cameras=read_mill19(source), photos=source, model=None)
    folder = model_folder or next((place for place in (source / "sparse" / "0", source / "sparse") if place.is_dir()), None)
    if folder is None:
        raise BadInput(f"{source} has no poses beside its photographs (sparse/ or a Mill 19 folder): give a COLMAP model with --poses.")
    model = read_model(folder)
    cameras = _cameras_of(model)
    if len(cameras) < 2:
        raise BadInput(f"{folder} has {len(cameras)} poses, expected those of all photographs.")
    rolled_deg = roll_deg(cameras, np.array([0.0, 0.0, 1.0]))
    if rolled_deg > MAX_ROLL_DEG:
        raise BadInput(
            f"in {folder} z is not up (the photographs are rolled by {rolled_deg:.0f}° against it): turn the model so that z points up, "
            "or let --frames shared find it."
        )
    photos = source / "images" if (source / "images").is_dir() else source
    return GivenPoses(cameras=cameras, photos=photos, model=model)


def _cameras_of(model: ColmapModel) -> Cameras:
    """Names, poses and sizes of a model; calibrations that any lens may have."""
    sizes_wh = np.array([model.cameras[image.camera_id].size_wh for image in model.images], np.int64).reshape(-1, 2)
    Ks = np.tile(np.eye(3), (len(sizes_wh), 1, 1))
    Ks[:, 0, 0] = Ks[:, 1, 1] = sizes_wh.max(axis=1, initial=1)
    Ks[:, :2, 2] = sizes_wh / 2
    return Cameras(
        names=tuple(image.name for image in model.images),
        Ks=Ks,
        cam_from_world=np.array([image.cam_from_world for image in model.images]).reshape(-1, 4, 4),
        sizes_wh=sizes_wh,
    )
