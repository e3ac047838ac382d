"""A model that COLMAP reads back: its text reader cuts names at spaces. Once per scene."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from radiant_core.io.colmap.records import ColmapModel
from radiant_core.io.colmap.text import write_model
from radiant_core.sfm.colmap.calls import pycolmap


def write_for_colmap(model: ColmapModel, folder: Path) -> None:
    """Write `model` into `folder` in binary, with whatever names its images have."""
    write_model(folder, replace(model, images=tuple(replace(image, name=str(image.image_id)) for image in model.images)))
    numbered = pycolmap.Reconstruction(folder)
    for image in model.images:
        numbered.image(image.image_id).name = image.name
    for path in folder.glob("*.txt"):
        path.unlink()
    numbered.write_binary(folder)
