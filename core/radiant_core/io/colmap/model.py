"""COLMAP models (cameras, images, points3D; binary or text): found, read, checked. Once per scene.

`binary.py` and `text.py` parse the two formats into the same records, which `records.py` checks
against each other. Rig and frame files beside them are not needed: the images hold their poses.
"""

from __future__ import annotations

from pathlib import Path

from radiant_core.errors import BadInput
from radiant_core.io.colmap import binary as colmap_binary
from radiant_core.io.colmap import text as colmap_text
from radiant_core.io.colmap.records import ColmapModel, check_model

MAX_FILE_BYTES = 1 << 33
STEMS = ("cameras", "images", "points3D")
_PARSERS = {parser.SUFFIX: parser for parser in (colmap_binary, colmap_text)}


def model_files(folder: Path) -> list[Path]:
    """The files that `read_model` reads of the model in `folder`; raises as that without one."""
    suffix = _format_of(folder)
    if suffix is None:
        raise BadInput(f"{folder} holds no COLMAP model: expected cameras, images and points3D, all .bin or all .txt.")
    return [folder / f"{stem}{suffix}" for stem in STEMS]


def image_names(folder: Path) -> tuple[str, ...]:
    """Names of the images of the model in `folder`; raises as `read_model`."""
    path = model_files(folder)[STEMS.index("images")]
    return tuple(image.name for image in _PARSERS[path.suffix].parse_images(_bytes_of(path), str(path)))


def read_model(folder: Path) -> ColmapModel:
    """The model in `folder` (binary where both formats are there).

    Raises BadInput naming the file and the byte or line when it is missing or truncated, or has
    trailing bytes, an unknown camera model, values that are not finite, a name that leaves
    the folder, an id twice, or an id that is not there.
    """
    paths = model_files(folder)
    parser = _PARSERS[paths[0].suffix]
    parsers = (parser.parse_cameras, parser.parse_images, parser.parse_points)
    cameras, images, points = (parse(_bytes_of(path), str(path)) for parse, path in zip(parsers, paths, strict=True))
    return check_model(cameras, images, points, str(folder))


def _format_of(folder: Path) -> str | None:
    for suffix in _PARSERS:
        if all((folder / f"{stem}{suffix}").is_file() for stem in STEMS):
            return suffix
    return None


def _bytes_of(path: Path) -> bytes:
    num_bytes = path.stat().st_size
    if num_bytes > MAX_FILE_BYTES:
        raise BadInput(f"{path} has {num_bytes} bytes, more than the {MAX_FILE_BYTES} that are read: split the model first.")
    return path.read_bytes()
