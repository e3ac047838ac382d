"""Whether a COLMAP model that is given fits its photographs, as alignments of other programs are
held against theirs. Once per source.

COLMAP's own models always do; those that other programs write in its form have been seen with
poses the other way round and with axes of another library.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from radiant_core.decisions import Decision
from radiant_core.io.colmap.records import ColmapModel
from radiant_core.io.poses.lens import lens_of
from radiant_core.io.poses.pose_file import PosedView, PoseFile
from radiant_core.sfm.pose_check import check_poses

PROGRAM = "COLMAP"


def check_model_poses(model: ColmapModel, folder: Path, photos: Path, *, rough: bool = False) -> Decision:
    """The figure by which the model in `folder`, named by the photographs in `photos`, is taken;
    raises as `check_poses`. Lenses that it has no equations for are not checked, which it says."""
    lenses = {number: lens_of(model.cameras[number]) for number in sorted({image.camera_id for image in model.images})}
    unknown = sorted({model.cameras[number].model for number, lens in lenses.items() if lens is None})
    if unknown or len(model.images) < 2:
        return Decision(
            stage="sfm",
            topic="poses",
            choice=f"those of {folder.name}/ of {PROGRAM}",
            figure=0.0,
            unit="matched pairs",
            reason=f"the poses are not checked: no equations of {', '.join(unknown)} here" if unknown else "one photograph has no pair",
        )
    project = PoseFile(
        path=folder,
        program=PROGRAM,
        lenses={number: lens for number, lens in lenses.items() if lens is not None},
        views=_views(model),
        points=model.points.xyz,
        colors=model.points.colors if len(model.points.ids) else None,
    )
    return check_poses(project, photos, rough=rough)


def _views(model: ColmapModel) -> tuple[PosedView, ...]:
    order = np.argsort(model.points.ids)
    views = []
    for image in model.images:
        has_point = image.point3d_ids != -1
        rows = order[np.searchsorted(model.points.ids[order], image.point3d_ids[has_point])] if len(order) else np.zeros(0, np.int64)
        views.append(
            PosedView(
                name=image.name,
                lens_id=image.camera_id,
                cam_from_world=image.cam_from_world,
                pixels=image.points2d[has_point],
                point_rows=rows,
            )
        )
    return tuple(views)
