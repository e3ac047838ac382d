"""Photographs and model without lens distortion: pinhole cameras, same names. Once per scene."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

from radiant_core.cameras import Cameras
from radiant_core.frames import Sim3
from radiant_core.io.run_store import require_room
from radiant_core.sfm.colmap.calls import call_colmap, pycolmap
from radiant_core.sfm.config import Report, SfmProgress

JPEG_QUALITY = 95


@dataclass(frozen=True, kw_only=True)
class Undistorted:
    """Where the pinhole model and its images are."""

    model_folder: Path
    image_folder: Path


def undistort(model_folder: Path, image_folder: Path, work_folder: Path, num_threads: int, report: Report) -> Undistorted:
    """Write work_folder/undistorted/{images,sparse}, which appears only when complete."""
    part, final = work_folder / "undistorted.part", work_folder / "undistorted"
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    report(SfmProgress(phase="undistorting", done=0, total=1))
    call_colmap(
        "undistorting",
        pycolmap.undistort_images,
        part,
        model_folder,
        image_folder,
        output_type="COLMAP",
        jpeg_quality=JPEG_QUALITY,
        num_threads=num_threads,
        cancellation_token=pycolmap.CancellationToken(),
    )
    # COLMAP takes no notice of an image that could not be written.
    require_room(work_folder)
    part.rename(final)
    report(SfmProgress(phase="undistorting", done=1, total=1))
    return Undistorted(model_folder=final / "sparse", image_folder=final / "images")


def fit_model(model_folder: Path, world_from_model: Sim3, cameras: Cameras) -> None:
    """Make the COLMAP model in `model_folder` fit its scene: moved into its world, without images
    that are none of its cameras and points that only those saw."""
    model = pycolmap.Reconstruction(model_folder)
    model.transform(pycolmap.Sim3d(world_from_model.scale, pycolmap.Rotation3d(world_from_model.rotation), world_from_model.translation))
    kept = set(cameras.names)
    for image in [image for image in model.images.values() if image.has_pose and image.name not in kept]:
        model.deregister_frame(image.frame_id)
    model.write_binary(model_folder)


def remove_images(image_folder: Path, cameras: Cameras) -> None:
    """Remove the images of a folder of `undistort` that are none of the cameras."""
    kept = {image_folder / name for name in cameras.names}
    for path in image_folder.rglob("*"):
        if path.is_file() and path not in kept:
            path.unlink()
