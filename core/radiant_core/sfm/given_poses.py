"""Poses that come with the photographs: a COLMAP model, another alignment, a Mill 19 folder. Once a
run.

The world is that of the poses, but for a whole offset where they lie far from its origin; z must be
up for a plan of the ground.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Literal

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.frames import compose
from radiant_core.geometry.similarity import move_cameras
from radiant_core.georef.given_frame import GivenFrame, shifted_frame
from radiant_core.io.colmap.candidates import find_models, notes_on_project, picture_folder
from radiant_core.io.colmap.image_files import ImageFiles, photographs_without_pose, read_with_files, require_files, unposed_count
from radiant_core.io.colmap.records import ColmapModel, check_model
from radiant_core.io.colmap.text import write_model
from radiant_core.io.mill19 import given_from_scene, images_without_pose, read_mill19
from radiant_core.io.photos.listing import photograph_size_wh
from radiant_core.io.poses.recognise import the_alignment
from radiant_core.io.records import save_cameras
from radiant_core.sfm.known_poses import NO_POINTS, misfit_text
from radiant_core.sfm.model_check import check_model_poses
from radiant_core.sfm.pose_project import crs_of, placed_project, read_with_photographs, said_of
from radiant_core.sfm.world_frame.up import roll_deg

NO_POINTS_2D, NO_IDS = np.zeros((0, 2)), np.zeros(0, np.int64)
MAX_ROLL_DEG = 30.0
"""A photograph is taken level or looking down: where its x axes are farther from the horizontal
than this, z is not up."""


Where = Literal["together", "by device", "own"]
"""together: all photographs in one folder; by device: in subfolders; own: those of one device of
many, whose poses are beside those of others."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GivenPoses:
    """Poses of photographs in `photos`; `model`: their COLMAP model, whose lenses may distort."""

    cameras: Cameras
    """Centres and rotations; the calibration is right only where `model` is None."""
    photos: Path
    model: ColmapModel | None
    frame: GivenFrame
    """The way back to the frame that the poses were given in."""
    notes: tuple[str, ...] = ()
    """What was given and is not used, or taken for another."""
    unnamed_notes: tuple[str, ...] = ()
    """The same without names of photographs."""
    check: Decision | None = None
    """How they were held against the photographs; None where nobody opened these."""

    def deal(self, names: Sequence[str], folder: Path) -> bool:
        """Write the poses of these photographs into `folder`: poses/, a COLMAP model, or
        poses.safetensors; True for the former."""
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


def read_given_poses(source: Path, model_folder: Path | None, where: Where = "together") -> GivenPoses:
    """The poses in `model_folder`, or else those beside the photographs of `source`. Poses that lie
    far from their origin are moved by a whole offset. Raises BadInput where there are none, where z
    is not up in them, or where they lie far out and are those of one device of many."""
    if model_folder is None and (source / "train" / "metadata").is_dir():
        return _read_mill19_poses(source)
    models, photos = find_models(source), picture_folder(source) or source
    alignment = the_alignment(source) if model_folder is None and not models else model_folder
    if alignment is not None and not alignment.is_dir():
        return _read_alignment(alignment, photos, where)
    if model_folder is None and not models:
        raise BadInput(
            f"{source} has no poses beside its photographs (sparse/, an alignment or a Mill 19 folder): give a COLMAP model or another "
            "alignment with --poses."
        )
    folder = model_folder or models[0].folder
    model, files = read_with_files(folder, photos, required=False)
    check = None
    if where != "by device":
        # A device looks at its photographs itself: no other process opens them.
        _require_sizes(model, photos)
        here = set(files.files.values())
        check = check_model_poses(model.without([image.name for image in model.images if image.name not in here]), folder, photos)
    else:
        files, model = _below_devices(files), _named_below_devices(model, files)
    cameras = _cameras_of(model)
    if len(cameras) < 2:
        raise BadInput(f"{folder} has {len(cameras)} poses, expected those of all photographs.")
    _require_z_up(cameras, folder)
    frame = shifted_frame(cameras, "the COLMAP model")
    _require_shared(cameras, frame, where)
    unposed = photographs_without_pose(files) if where != "by device" else ()
    project_notes = notes_on_project(source, for_poses=True) if model_folder is None else ()
    counts = (*files.count(), *unposed_count(unposed, files))
    return GivenPoses(
        cameras=move_cameras(cameras, frame.given_from_scene.inverse()),
        photos=photos,
        model=_moved(model, frame),
        frame=frame,
        notes=(*project_notes, *files.notes(), *unposed_count(unposed, files), *frame.notes()),
        unnamed_notes=(*project_notes, *counts, *frame.notes()),
        check=check,
    )


def _read_alignment(path: Path, photos: Path, where: Where) -> GivenPoses:
    """The poses of another program, in metres where it says so."""
    alignment, files = read_with_photographs(path, photos)
    if where == "by device":
        views = [replace(view, name=files.files.get(view.name) or _last_of(view.name)) for view in alignment.views]
        project = placed_project(replace(alignment, views=tuple(views)), None)
        files, model = _below_devices(files), _named_below_devices(project.model, files)
    else:
        here = [view for view in alignment.views if view.name in files.files]
        if where == "together":
            require_files(files, [view.name for view in alignment.views])
        if len(here) < 2:
            raise BadInput(f"{len(here)} of the photographs in {photos} have a pose in {path}, expected 2 or more: give poses of these.")
        project = placed_project(replace(alignment, views=tuple(here)).named(files), photos)
        model = project.model
    if project.other_lenses:
        raise BadInput(
            f"{alignment.title} has lenses with k4 or skew, which devices cannot undistort: use --frames shared, or undistort the "
            "photographs in the program that aligned them."
        )
    cameras = _cameras_of(model)
    _require_z_up(cameras, path)
    shift = shifted_frame(cameras, alignment.title)
    frame = replace(
        shift,
        given_from_scene=compose(project.given_from_scene, shift.given_from_scene),
        crs=crs_of(alignment),
        is_default=True,
    )
    _require_shared(cameras, frame, where)
    unposed = photographs_without_pose(files) if where != "by device" else ()
    counts = (*files.count(), *unposed_count(unposed, files))
    return GivenPoses(
        cameras=move_cameras(cameras, shift.given_from_scene.inverse()),
        photos=photos,
        model=_moved(model, shift),
        frame=frame,
        notes=(said_of(alignment), *alignment.notes, *files.notes(), *unposed_count(unposed, files), *frame.notes()),
        unnamed_notes=(*counts, *frame.notes()),
        check=project.check,
    )


def _require_shared(cameras: Cameras, frame: GivenFrame, where: Where) -> None:
    """Raise BadInput where one device of many would choose a frame of its own."""
    if where == "own" and not frame.is_same:
        raise BadInput(
            f"the poses lie up to {np.abs(cameras.centers).max():.3g} from their origin, where float32 loses what is small: take the same "
            "whole numbers off the poses of all devices."
        )


def _read_mill19_poses(source: Path) -> GivenPoses:
    cameras = read_mill19(source)
    unposed = images_without_pose(source, cameras)
    note = f"{len(unposed)} of {len(cameras) + len(unposed)} images in rgbs have no metadata and are left out."
    frame = GivenFrame(given_from_scene=given_from_scene(source), model="the Mill 19 folder (c2w of its metadata)")
    return GivenPoses(cameras=cameras, photos=source, model=None, frame=frame, notes=(note,) if unposed else ())


def _below_devices(files: ImageFiles) -> ImageFiles:
    """Files in folders of devices by their paths there, and the same ends of their names."""
    ends: dict[str, str] = {}
    for name, file in files.files.items():
        below = _below_first(file)
        ends["/".join(PurePosixPath(name).parts[-len(PurePosixPath(below).parts) :])] = below
    return replace(files, files=ends)


def _named_below_devices(model: ColmapModel, files: ImageFiles) -> ColmapModel:
    """The model whose images are named as in the folder of their device. Raises BadInput where two
    devices have one of the same name."""
    there = set(files.files.values())
    names = [_below_first(image.name) if image.name in there else PurePosixPath(image.name).name for image in model.images]
    first: dict[str, str] = {}
    for image, name in zip(model.images, names, strict=True):
        if first.setdefault(name, image.name) != image.name:
            raise BadInput(
                f"the poses have {first[name]} and {image.name}, which are both {name!r} in the folder of their device: rename one, there "
                "and in the poses."
            )
    return replace(model, images=tuple(replace(image, name=name) for image, name in zip(model.images, names, strict=True)))


def _last_of(name: str) -> str:
    """The file of a name, whatever system wrote it."""
    return PurePosixPath(name.replace("\\", "/")).name


def _below_first(path: str) -> str:
    """A path without its first folder."""
    return path.partition("/")[2] or path


def _moved(model: ColmapModel, frame: GivenFrame) -> ColmapModel:
    """The model in the frame of the scene, which is a shift from that of the model."""
    shift = frame.given_from_scene.translation
    images = tuple(replace(image, translation=image.translation + image.cam_from_world[:3, :3] @ shift) for image in model.images)
    return replace(model, images=images, points=replace(model.points, xyz=model.points.xyz - shift))


def _require_sizes(model: ColmapModel, photos: Path) -> None:
    """Raise BadInput where a photograph that is here has another size than its camera; of each
    camera one is looked at."""
    for image in {image.camera_id: image for image in model.images if (photos / image.name).is_file()}.values():
        size_wh, camera_wh = photograph_size_wh(photos / image.name), model.cameras[image.camera_id].size_wh
        if size_wh is not None and size_wh != camera_wh:
            raise BadInput(misfit_text(f"photograph {image.name!r}", size_wh, camera_wh))


def _require_z_up(cameras: Cameras, folder: Path) -> None:
    rolled_deg = roll_deg(cameras, np.array([0.0, 0.0, 1.0]))
    if rolled_deg > MAX_ROLL_DEG:
        raise BadInput(
            f"in {folder} z is not up (the photographs are rolled by {rolled_deg:.0f}° against it): turn the model so that z points up, "
            "or let --frames shared find it."
        )


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
