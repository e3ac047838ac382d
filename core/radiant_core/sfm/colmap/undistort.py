"""Photographs and model without lens distortion: pinhole cameras, same file names. Per scene."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from radiant_core.cameras import Cameras
from radiant_core.errors import CannotWrite, way_to_write
from radiant_core.frames import Sim3
from radiant_core.io.run_store import require_room
from radiant_core.sfm.colmap.calls import call_colmap, pycolmap
from radiant_core.sfm.colmap.plain_fisheyes import bend_plain_fisheyes
from radiant_core.sfm.colmap.warp import can_warp, warp_jpeg
from radiant_core.sfm.config import Report, SfmProgress
from radiant_core.threads import in_order, single_opencv_thread

JPEG_QUALITY = 95
BENT = "bent"


@dataclass(frozen=True, kw_only=True)
class Undistorted:
    """Where the pinhole model and its images are."""

    model_folder: Path
    image_folder: Path


def undistort(model_folder: Path, image_folder: Path, work_folder: Path, num_threads: int, report: Report) -> Undistorted:
    """Write work_folder/undistorted/{images,sparse,stereo}, which appears only when complete.
    Raises BadInput where a photograph cannot be decoded."""
    part, final = work_folder / "undistorted.part", work_folder / "undistorted"
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    model_folder = _bent_copy(model_folder, part / BENT)
    plan = _plan(model_folder)
    total = len(plan.warped) + len(plan.others)
    report(SfmProgress(phase="undistorting", done=0, total=total))
    _undistort_by_colmap(plan, (model_folder, image_folder, part), num_threads)
    # COLMAP takes no notice of an image that could not be written.
    require_room(work_folder)
    _warp_all(plan, image_folder, part / "images", num_threads, lambda num_done: report(_progress(len(plan.others) + num_done, total)))
    _name_for_stereo(part / "stereo", (*plan.warped, *plan.others))
    shutil.rmtree(part / BENT, ignore_errors=True)
    part.rename(final)
    report(_progress(total, total))
    return Undistorted(model_folder=final / "sparse", image_folder=final / "images")


def _progress(num_done: int, total: int) -> SfmProgress:
    return SfmProgress(phase="undistorting", done=num_done, total=total)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Plan:
    """Which photographs are warped here, by name with their camera and its pinhole; `others` are
    left to COLMAP: those in other formats, those without distortion, which it copies."""

    warped: Mapping[str, tuple[pycolmap.Camera, pycolmap.Camera]]
    others: tuple[str, ...]


def _bent_copy(model_folder: Path, folder: Path) -> Path:
    """The model's folder, or `folder` with what COLMAP needs where it has plain fisheyes."""
    model = pycolmap.Reconstruction(model_folder)
    if not bend_plain_fisheyes(model):
        return model_folder
    folder.mkdir()
    model.write_binary(folder)
    return folder


def _plan(model_folder: Path) -> _Plan:
    model = pycolmap.Reconstruction(model_folder)
    options = pycolmap.UndistortCameraOptions()
    sides = {number: (camera, pycolmap.undistort_camera(options, camera)) for number, camera in model.cameras.items()}
    placed = {image.name: sides[image.camera_id] for image in map(model.image, sorted(model.reg_image_ids()))}
    warped = {name: cameras for name, cameras in placed.items() if can_warp(name, *cameras)}
    return _Plan(warped=warped, others=tuple(name for name in placed if name not in warped))


def _undistort_by_colmap(plan: _Plan, places: tuple[Path, Path, Path], num_threads: int) -> None:
    """The model and the photographs that are not warped here; `places`: model, photographs, result.
    Where there is none, COLMAP looks for one in an empty folder, and writes the model alone."""
    model_folder, image_folder, part = places
    with TemporaryDirectory(dir=part) as empty:
        call_colmap(
            "undistorting",
            pycolmap.undistort_images,
            part,
            model_folder,
            image_folder if plan.others else empty,
            image_names=list(plan.others) or [next(iter(plan.warped))],
            output_type="COLMAP",
            jpeg_quality=JPEG_QUALITY,
            num_threads=num_threads,
            cancellation_token=pycolmap.CancellationToken(),
        )


def _warp_all(plan: _Plan, image_folder: Path, to_folder: Path, num_threads: int, on_done: Callable[[int], None]) -> None:
    def work(name: str) -> None:
        jpeg = warp_jpeg(image_folder / name, *plan.warped[name], JPEG_QUALITY)
        _write(to_folder / name, jpeg)

    with single_opencv_thread():
        for num_done, _ in enumerate(in_order(work, tuple(plan.warped), num_threads), 1):
            on_done(num_done)


def _name_for_stereo(folder: Path, names: Iterable[str]) -> None:
    """List all photographs where COLMAP's dense stereo looks for them, as COLMAP itself does."""
    names = sorted(names)
    _write(folder / "fusion.cfg", "".join(f"{name}\n" for name in names).encode())
    _write(folder / "patch-match.cfg", "".join(f"{name}\n__auto__, 20\n" for name in names).encode())


def _write(path: Path, data: bytes) -> None:
    """Write a file of a folder that counts only when complete."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    except OSError as error:
        raise CannotWrite(f"cannot write {path}: {error.strerror or error}: {way_to_write(error)}.") from error


def fit_model(model_folder: Path, world_from_model: Sim3, cameras: Cameras) -> None:
    """Make the COLMAP model in `model_folder` fit its scene: moved into its world, without images
    that are none of its cameras and points that only those saw."""
    model = pycolmap.Reconstruction(model_folder)
    model.transform(pycolmap.Sim3d(world_from_model.scale, pycolmap.Rotation3d(world_from_model.rotation), world_from_model.translation))
    names = set(cameras.names)
    for image in [image for image in model.images.values() if image.has_pose and image.name not in names]:
        model.deregister_frame(image.frame_id)
    model.write_binary(model_folder)


def remove_images(image_folder: Path, cameras: Cameras) -> None:
    """Remove the images of a folder of `undistort` that are none of the cameras."""
    paths = {image_folder / name for name in cameras.names}
    for path in image_folder.rglob("*"):
        if path.is_file() and path not in paths:
            path.unlink()
