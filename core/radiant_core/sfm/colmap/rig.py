"""The rig of panoramas' faces in COLMAP's database and models. Once per scene.

A panorama's faces look from one place in known directions through known lenses: COLMAP places them
as one frame, and neither the rig nor the lenses are adjusted, which moved them by 0.02° in tests of
the library (`ba_refine_sensor_from_rig`).
"""

from __future__ import annotations

import shutil
from pathlib import Path

from radiant_core.errors import BadInput
from radiant_core.io.colmap.model import read_model
from radiant_core.io.colmap.records import ColmapModel
from radiant_core.io.panoramas.cutting import RIG_CONFIG
from radiant_core.panoramas import PREFIX, frame_of
from radiant_core.sfm.colmap.calls import call_colmap, pycolmap
from radiant_core.sfm.colmap.spaced_names import write_for_colmap
from radiant_core.sfm.colmap.strays import MIN_POINTS


def apply_rig(database: Path, photo_folder: Path) -> None:
    """Make the faces in a database frames of the rig that lies beside them, with its lenses. Raises
    BadInput where it does not."""
    if not (photo_folder / RIG_CONFIG).is_file():
        raise BadInput(
            f"the folders {PREFIX}… in {photo_folder} are named as those of panoramas' faces, and {RIG_CONFIG} does not lie beside them: "
            "put it there, or name the folders otherwise."
        )
    configs = pycolmap.read_rig_config(photo_folder / RIG_CONFIG)
    with pycolmap.Database.open(database) as store:
        call_colmap("placing the faces of panoramas", pycolmap.apply_rig_config, configs, store)


def flatten(model_folder: Path) -> tuple[str, ...]:
    """Make the faces in the model of a folder images of their own, as programs without rigs read
    them, without those that see too few points; what is said of these."""
    model, warnings = without_blind_faces(read_model(model_folder))
    shutil.rmtree(model_folder)
    model_folder.mkdir()
    write_for_colmap(model, model_folder)
    return warnings


def without_blind_faces(model: ColmapModel) -> tuple[ColmapModel, tuple[str, ...]]:
    """The model without faces of panoramas that see too few points to train on, and what is said
    of them."""
    faces = [image for image in model.images if frame_of(image.name) != image.name]
    blind = {image.name for image in faces if int((image.point3d_ids != -1).sum()) < MIN_POINTS}
    if not blind:
        return model, ()
    warning = f"{len(blind)} faces of panoramas see under {MIN_POINTS} points (sky, or what carries the camera) and are left out."
    return model.without(blind), (warning,)
