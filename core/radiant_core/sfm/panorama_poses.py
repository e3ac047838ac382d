"""Panoramas that come with poses: their faces, each with the pose that the panorama's gives it.
Once per source.

    cam_from_world(face) = cam_from_rig(face) · cam_from_world(panorama)
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.io.panoramas.cutting import CutFaces, cut_masks, cut_panoramas, face_name
from radiant_core.io.photos.listing import photograph_size_wh
from radiant_core.io.photos.masks import find_masks
from radiant_core.io.poses.lens import Lens
from radiant_core.io.poses.pose_file import PosedView, PoseFile
from radiant_core.panoramas import Face
from radiant_core.sfm.config import Report, SfmProgress
from radiant_core.sfm.intake import FACE_MASKS, FACES


@dataclass(frozen=True, kw_only=True, eq=False)
class FacedAlignment:
    """An alignment of flat photographs, their folder, that of their masks, and what was cut."""

    alignment: PoseFile
    photos: Path
    masks: Path | None
    faces: CutFaces | None = None


def with_faces(alignment: PoseFile, photos: Path, masks: Path | None, work_folder: Path, report: Report) -> FacedAlignment:
    """The alignment, named by its photographs, with faces cut into `work_folder` in place of its
    panoramas. Raises BadInput where some are panoramas and others are not, or as
    `cut_panoramas`."""
    spheres = [view.name for view in alignment.views if alignment.lenses[view.lens_id].kind == "sphere"]
    if not spheres:
        shutil.rmtree(work_folder / FACES, ignore_errors=True)
        return FacedAlignment(alignment=alignment, photos=photos, masks=masks)
    if len(spheres) < len(alignment.views):
        raise BadInput(
            f"{alignment.title} has {len(spheres)} panoramas among {len(alignment.views)} photographs: give them as two projects, or leave "
            "one kind out."
        )
    sizes = {name: size_wh for name in spheres if (size_wh := photograph_size_wh(photos / name)) is not None}
    odd = [name for name, (width, height) in sizes.items() if abs(width - 2 * height) > 0.02 * height]
    if odd:
        raise BadInput(f"photograph {odd[0]!r} has {sizes[odd[0]]} px, and a panorama is twice as wide as high: give whole panoramas.")
    faces = cut_panoramas(
        photos,
        spheres,
        work_folder / FACES,
        lambda num_done, total: report(SfmProgress(phase="cutting panoramas", done=num_done, total=total)),
    )
    if masks is not None:
        cut_masks(find_masks(masks, spheres), sizes, work_folder / FACE_MASKS, faces)
        masks = work_folder / FACE_MASKS
    return FacedAlignment(alignment=_faced(alignment, faces), photos=faces.folder, masks=masks, faces=faces)


def _faced(alignment: PoseFile, faces: CutFaces) -> PoseFile:
    K, size_px = faces.K, faces.size_px
    lens = Lens(size_wh=(size_px, size_px), fx=float(K[0, 0]), fy=float(K[1, 1]), cx=float(K[0, 2]), cy=float(K[1, 2]))
    views = [_face_of(view, alignment.lenses[view.lens_id], face, lens) for view in alignment.views for face in faces.rig.faces]
    return replace(alignment, lenses={1: lens}, views=tuple(sorted(views, key=lambda view: view.name)))


def _face_of(view: PosedView, sphere: Lens, face: Face, lens: Lens) -> PosedView:
    """A face of a panorama, with what of its observations lies in it."""
    turn = np.eye(4)
    turn[:3, :3] = face.cam_from_rig
    rays = sphere.cam_from_img(view.pixels) @ face.cam_from_rig.T
    pixels = lens.img_from_cam(rays)
    inside = (rays[:, 2] > 0) & ((pixels >= 0) & (pixels < lens.size_wh)).all(axis=1)
    return PosedView(
        name=face_name(face.folder, view.name),
        lens_id=1,
        cam_from_world=turn @ view.cam_from_world,
        pixels=pixels[inside],
        point_rows=view.point_rows[inside],
    )
