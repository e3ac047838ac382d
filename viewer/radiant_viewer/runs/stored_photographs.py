"""The photographs of a run as they are stored, before undistortion. Looked up once per window.

Marks of ground control are made in them: gcp_list.txt counts pixels of photographs as they are
stored, and a run's own copies are undistorted and perhaps smaller.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath

import cv2
import numpy as np

from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.io.photos.listing import MAX_FILE_BYTES, decode_image, read_size_wh
from radiant_core.io.run_store import read_bounded, read_json
from radiant_viewer.pictures.images import Image
from radiant_viewer.runs.run_view import RunView
from radiant_viewer.runs.unplanned import source_of

HEAD_BYTES = 1 << 20
"""Within which nearly every file says its size."""


def stored_photographs(run: RunView) -> Path:
    """The folder that structure from motion took the photographs from; BadInput with the reason
    where there is none."""
    if run.in_field:
        raise BadInput("photographs of this run stay with their devices, which are placed by their own GPS: there is nothing to mark here.")
    source = source_of(run.folder)
    owners = [run.folder / "sfm", run.folder, *([source / "sfm", source] if source is not None else [])]
    for owner in owners:
        try:
            photographs = read_json(owner / "task.json").get("source") if (owner / "task.json").is_file() else None
        except StoreDamaged:
            continue
        if isinstance(photographs, str):
            return _existing(Path(photographs), run)
    raise BadInput(f"{run.folder.name} was not made by structure from motion of photographs, so ground control would not be used.")


def stored_size_wh(path: Path) -> tuple[int, int] | None:
    """Width and height of a stored photograph; None where it is not there, or is none."""
    if not path.is_file():
        return None
    with path.open("rb") as file:
        return read_size_wh(file.read(HEAD_BYTES))


def load_stored(folder: Path, name: str) -> Image:
    """A photograph (H,W,3) by its name in the scene, in the orientation of its pixels, whatever
    EXIF says; BadInput where it is not in the folder or broken."""
    parts = PurePosixPath(name)
    if parts.is_absolute() or ".." in parts.parts:
        raise BadInput(f"{name!r} is no name of a photograph inside {folder}.")
    if not (folder / name).is_file():
        raise BadInput(f"{folder} no longer holds {name}: put the photograph back to mark it.")
    pixels = decode_image(read_bounded(folder / name, MAX_FILE_BYTES), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if pixels is None:
        raise BadInput(f"the photograph {folder / name} is not whole or cannot be decoded: fetch it again to mark it.")
    return np.ascontiguousarray(pixels[:, :, ::-1], dtype=np.uint8)


def _existing(folder: Path, run: RunView) -> Path:
    names = run.scene.cameras.names
    if not folder.is_dir() or not any((folder / name).is_file() for name in names[:1]):
        raise BadInput(f"the photographs of this run were in {folder} and are not there any more: put them back to mark points in them.")
    return folder
