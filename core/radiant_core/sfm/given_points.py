"""Points of a given pinhole model that lack: triangulated where it has none, seen by projection
where it does not say who sees them. Once per scene.

Poses that were imported (from a flight's log, from another program, after a merge) often come
without tracks, and training needs to know how far away what a photograph shows is. A point counts
as seen where it projects into a photograph in front of it and none much nearer lies in the same
cell:
    depth ≤ 1.05 · least depth among the points in its cell of (long side / 64)²
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.io.colmap.records import ColmapImage, ColmapModel
from radiant_core.numerics import FloatArray
from radiant_core.sfm.config import Phase, Report, SfmConfig
from radiant_core.sfm.known_poses import triangulated_model
from radiant_core.sfm.world_frame.world import cameras_of

CELLS_ACROSS = 64
MAX_DEPTH_RATIO = 1.05
POINT_PHASES: tuple[Phase, ...] = ("features", "pairs", "matching", "triangulating")
"""What `with_points` does of a model without any, after looking at the photographs again."""


def with_points(
    model: ColmapModel, photo_folder: Path, work_folder: Path, report: Report, masks: Path | None = None
) -> tuple[ColmapModel, tuple[str, ...]]:
    """The model with points that its photographs see, and what was done to it. Raises BadInput
    where no point can be triangulated, or none lies in a photograph."""
    if not len(model.points.ids):
        triangulated = triangulated_model(cameras_of(model), photo_folder, work_folder / "triangulated", SfmConfig(), report, masks)
        return triangulated, (f"the model has no points: {len(triangulated.points.ids)} were triangulated from its photographs and poses.",)
    blind = [image for image in model.images if not (image.point3d_ids != -1).any()]
    tracked = set(model.points.tracks[:, 1].tolist())
    blind = [image for image in blind if image.image_id not in tracked]
    if not blind:
        return model, ()
    seeing = {image.image_id: _with_seen(model, image) for image in blind}
    num_seen = sum((image.point3d_ids != -1).sum() for image in seeing.values())
    if not num_seen and len(blind) == len(model.images):
        raise BadInput(
            f"the model does not say who sees its {len(model.points.ids)} points, and none of them projects into a photograph: "
            "its poses and its points are not of one frame."
        )
    return _joined(model, seeing), (
        f"{len(blind)} of {len(model.images)} images of the model do not say which points they see: what projects into them and is not "
        "behind nearer points counts as seen.",
    )


def _joined(model: ColmapModel, seeing: dict[int, ColmapImage]) -> ColmapModel:
    """The model with images that see points, and the tracks of those."""
    row_of = {int(point_id): row for row, point_id in enumerate(model.points.ids)}
    tracks = [model.points.tracks]
    for image in seeing.values():
        at = np.flatnonzero(image.point3d_ids != -1)
        rows = [row_of[int(point_id)] for point_id in image.point3d_ids[at]]
        tracks.append(np.column_stack([rows, np.full(len(at), image.image_id), at]).astype(np.int64).reshape(-1, 3))
    joined = np.concatenate(tracks)
    joined = joined[np.argsort(joined[:, 0], kind="stable")]
    images = tuple(seeing.get(image.image_id, image) for image in model.images)
    return replace(model, images=images, points=replace(model.points, tracks=joined))


def _with_seen(model: ColmapModel, image: ColmapImage) -> ColmapImage:
    """The image with the points that it sees, behind the 2D points that it has."""
    camera = model.cameras[image.camera_id]
    pose = image.cam_from_world
    visible, px = seen_points(model.points.xyz @ pose[:3, :3].T + pose[:3, 3], camera.K, camera.size_wh)
    return replace(
        image,
        points2d=np.concatenate([image.points2d, px]),
        point3d_ids=np.concatenate([image.point3d_ids, model.points.ids[visible]]),
    )


def seen_points(in_camera: FloatArray, K: FloatArray, size_wh: tuple[int, int]) -> tuple[NDArray[np.int64], FloatArray]:
    """Which of the points (P,3) of a camera's frame a photograph of `size_wh` px shows, (S,), and
    where (S,2) px."""
    ahead = np.flatnonzero(in_camera[:, 2] > 0)
    px = in_camera[ahead] @ K.T
    px = px[:, :2] / px[:, 2:]
    inside = ((px >= 0) & (px < size_wh)).all(axis=1)
    visible, px = ahead[inside], px[inside]
    columns, rows = (px // (max(size_wh) / CELLS_ACROSS)).astype(np.int64).T
    cells, depths = rows * CELLS_ACROSS + columns, in_camera[visible, 2]
    nearest = np.full(CELLS_ACROSS * CELLS_ACROSS, np.inf)
    np.minimum.at(nearest, cells, depths)
    in_front = depths <= MAX_DEPTH_RATIO * nearest[cells]
    return visible[in_front], px[in_front]
