"""Photographs and model without lens distortion: pinhole cameras, the same file names. Once per scene, all pixels."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

from radiant_core.frames import Sim3
from radiant_core.io.run_store import require_room
from radiant_core.sfm.colmap_calls import call_colmap, pycolmap
from radiant_core.sfm.config import Report, SfmProgress

JPEG_QUALITY = 95


@dataclass(frozen=True, kw_only=True)
class Undistorted:
    """Where the pinhole model and its images are."""

    model_folder: Path
    image_folder: Path


def undistort(model_folder: Path, image_folder: Path, work_folder: Path, num_threads: int, report: Report) -> Undistorted:
    """Write work_folder/undistorted/{images,sparse}; the folder appears only when it is complete."""
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


def move_model(model_folder: Path, world_from_model: Sim3) -> None:
    """Move the binary COLMAP model in `model_folder` by a similarity, so that it and the scene made of it are in one frame."""
    model = pycolmap.Reconstruction(model_folder)
    model.transform(pycolmap.Sim3d(world_from_model.scale, pycolmap.Rotation3d(world_from_model.rotation), world_from_model.translation))
    model.write_binary(model_folder)
