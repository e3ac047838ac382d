"""COLMAP models (cameras, images, points3D; binary or text): found, read, checked. Once per scene.

`binary.py` and `text.py` parse the two formats into the same records, which `records.py` checks
against each other. Rig and frame files beside them are not needed: the images hold their poses.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.io.colmap import binary as colmap_binary
from radiant_core.io.colmap import text as colmap_text
from radiant_core.io.colmap.records import ColmapCamera, ColmapImage, ColmapModel, ColmapPoints, check_model
from radiant_core.numerics import FloatArray

MAX_FILE_BYTES = 1 << 33
STEMS = ("cameras", "images", "points3D")
_PARSERS = {parser.SUFFIX: parser for parser in (colmap_binary, colmap_text)}


def model_files(folder: Path) -> list[Path]:
    """The files of the model in `folder` that `read_model` reads; raises like that without one."""
    suffix = next(iter(formats_of(folder)), None)
    if suffix is None:
        raise BadInput(f"{folder} holds no COLMAP model: expected cameras, images and points3D, all .bin or all .txt.")
    return [folder / f"{stem}{suffix}" for stem in STEMS]


def image_names(folder: Path) -> tuple[str, ...]:
    """Names of the images of the model in `folder`; raises as `read_model`."""
    path = model_files(folder)[STEMS.index("images")]
    return tuple(image.name for image in _PARSERS[path.suffix].parse_images(_bytes_of(path), str(path)))


def read_cameras(folder: Path) -> list[ColmapCamera]:
    """The cameras of the model in `folder`, not checked; raises as `read_model`."""
    path = model_files(folder)[STEMS.index("cameras")]
    return _PARSERS[path.suffix].parse_cameras(_bytes_of(path), str(path))


def image_centers(folder: Path) -> FloatArray:
    """Centres (C,3) of the images of the model in `folder`, −Rᵀ t; raises as `read_model`."""
    path = model_files(folder)[STEMS.index("images")]
    poses = [image.cam_from_world for image in _PARSERS[path.suffix].parse_images(_bytes_of(path), str(path))]
    stacked = np.array(poses, np.float64).reshape(-1, 4, 4)
    return np.asarray(-np.einsum("nji,nj->ni", stacked[:, :3, :3], stacked[:, :3, 3]))


def read_model(folder: Path) -> ColmapModel:
    """The model in `folder` (binary where both formats are there).

    Raises BadInput naming the file and the byte or line when it is missing or truncated, or has
    trailing bytes, an unknown camera model, values that are not finite, a name that leaves
    the folder, an id twice, or an id that is not there.
    """
    return check_model(*read_records(folder), str(folder))


def read_records(folder: Path) -> tuple[list[ColmapCamera], list[ColmapImage], ColmapPoints]:
    """The records of the model in `folder`, not checked against each other; raises as
    `read_model`."""
    paths = model_files(folder)
    parser = _PARSERS[paths[0].suffix]
    cameras, images, points = (_bytes_of(path) for path in paths)
    return (
        parser.parse_cameras(cameras, str(paths[0])),
        parser.parse_images(images, str(paths[1])),
        parser.parse_points(points, str(paths[2])),
    )


def formats_of(folder: Path) -> tuple[str, ...]:
    """The suffixes in which `folder` has all three files of a model, the one that is read first."""
    return tuple(suffix for suffix in _PARSERS if all((folder / f"{stem}{suffix}").is_file() for stem in STEMS))


def _bytes_of(path: Path) -> bytes:
    num_bytes = path.stat().st_size
    if num_bytes > MAX_FILE_BYTES:
        raise BadInput(f"{path} has {num_bytes} bytes, more than the {MAX_FILE_BYTES} that are read: split the model first.")
    return path.read_bytes()
