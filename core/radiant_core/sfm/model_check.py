"""Whether a COLMAP model that is given fits its photographs, as alignments of other programs are
held against theirs. Once per source.

COLMAP's own models always do; those that other programs write in its form have been seen with
poses the other way round and with axes of another library.
"""

from __future__ import annotations

from pathlib import Path

from radiant_core.decisions import Decision
from radiant_core.io.colmap.records import ColmapModel
from radiant_core.io.poses.lens import lens_of
from radiant_core.io.poses.pose_file import PoseFile, views_of
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
        views=views_of(model),
        points=model.points.xyz,
        colors=model.points.colors if len(model.points.ids) else None,
    )
    return check_poses(project, photos, rough=rough)
