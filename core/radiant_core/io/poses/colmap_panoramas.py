"""COLMAP models of panoramas (lens EQUIRECTANGULAR, COLMAP 4), read as an alignment. Once per
source.

Their lens has no parameters but the size. Poses are COLMAP's, the points and observations too.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.io.colmap.model import read_cameras, read_records
from radiant_core.io.colmap.records import PANORAMA, check_model
from radiant_core.io.poses.lens import Lens, lens_of, sphere_lens
from radiant_core.io.poses.pose_file import PoseFile, SizeOf, views_of


def has_panoramas(folder: Path) -> bool:
    """Whether a camera of the model in `folder` is a panorama; raises as `read_model`."""
    return any(camera.model == PANORAMA for camera in read_cameras(folder))


def read_colmap_panoramas(folder: Path, size_of: SizeOf) -> PoseFile:
    """The model in `folder` with its panoramas. Raises as `read_model`, and BadInput for a camera
    beside them whose lens has other equations than those of `lens.py`."""
    del size_of
    model = check_model(*read_records(folder), str(folder), panoramas=True)
    used = sorted({image.camera_id for image in model.images})
    lenses: dict[int, Lens] = {}
    for number in used:
        camera = model.cameras[number]
        if camera.model == PANORAMA and camera.params != camera.size_wh:
            raise BadInput(f"{folder} has a panorama of {camera.size_wh} px whose lens is of {camera.params}: export the model again.")
        lens = sphere_lens(camera.size_wh) if camera.model == PANORAMA else lens_of(camera)
        if lens is None:
            raise BadInput(f"{folder} has panoramas and a camera of the model {camera.model}: give them as two projects.")
        lenses[number] = lens
    return PoseFile(
        path=folder,
        program="COLMAP",
        lenses=lenses,
        views=views_of(model),
        points=model.points.xyz,
        colors=model.points.colors if len(model.points.ids) else np.zeros((0, 3), np.uint8),
    )
