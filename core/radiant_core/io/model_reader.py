"""`read_model`: a model file that a user gives, of any kind that is read, told by its content. Once
per command.

    begins with      is
    ply              PLY (`io.ply`), 3DGS's layout or PlayCanvas's compressed one
    PK               .sog, a zip (`io.sog_reader`)
    1f 8b            SPZ of version 1, 2 or 3, gzip (`io.spz`)
    NGSP             SPZ of version 4 (`io.open3d_formats`)
    {                meta.json of a SOG, or lod-meta.json of levels of detail, by its keys
    8 bytes, {       safetensors of `radiant train` or a run (`io.transport.upload`)
    anything         .splat, which has no header, by its name

A user's own file loses the Gaussians that cannot be drawn, counted and said
(`io.stored_gaussians`). What strangers send within a run is read strictly elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, get_args

from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.io.lod_reader import MAX_META_BYTES, read_lod_level
from radiant_core.io.ply import read_ply
from radiant_core.io.run_store import open_without_waiting, parse_json, read_bounded
from radiant_core.io.sog_reader import read_sog
from radiant_core.io.splat_file import MAX_SPLAT_BYTES, gaussians_of_splat
from radiant_core.io.spz import gaussians_of_gzip_spz
from radiant_core.io.stored_gaussians import ModelFile, StoredGaussians, stored, usable
from radiant_core.splats import concatenate_splats

ModelKind = Literal["ply", "sog", "spz", "lod", "safetensors", "splat"]
MAX_SPZ_BYTES = 1 << 32
SPZ_AXES = (
    "its coordinates are taken as they stand, as Open3D and Spark take them; programs that hold to SPZ's own axes, such as "
    "splat-transform, turn them by 180° about x"
)
_SAFETENSORS_HEADER = 8
_READABLE = "a .ply, .compressed.ply, .spz, .splat, .sog, lod-meta.json or model.safetensors"
_OTHERS = {
    b"glTF": "a GLB, which is written here and not read",
    b"PAR1": "a Parquet file",
    b"LASF": "a LAS or LAZ point cloud, which has no Gaussians",
    b"\x89PNG": "a picture",
    b"\xff\xd8\xff": "a picture",
}


def model_kind(path: Path) -> ModelKind | None:
    """What kind of model a file is by its content; None where it is none that is read, or cannot be
    opened."""
    try:
        with open(path, "rb", opener=open_without_waiting) as file:
            head = file.read(16)
    except (OSError, ValueError):
        return None
    if head.startswith((b"ply\n", b"ply\r")):
        return "ply"
    if head.startswith(b"PK\3\4"):
        return "sog"
    if head.startswith((b"\x1f\x8b", b"NGSP")):
        return "spz"
    if head[_SAFETENSORS_HEADER : _SAFETENSORS_HEADER + 1] == b"{" and not head.startswith(b"{"):
        return "safetensors"
    if head.lstrip().startswith(b"{") or path.suffix.lower() == ".json":
        return _json_kind(path)
    if path.suffix.lower() == ".splat":
        return "splat"
    endings: dict[str, ModelKind] = {f".{kind}": kind for kind in get_args(ModelKind)}
    # Named as a model and begun as none: its own reader says what is wrong with it.
    return None if any(head.startswith(start) for start in _OTHERS) else endings.get(path.suffix.lower())


def read_model(path: Path) -> ModelFile:
    """The model in a user's file, and sentences about what of it was left out or changed.

    Raises BadInput, or StoreDamaged for a broken file, which name it.
    """
    kind = model_kind(path)
    if kind is None:
        raise BadInput(f"{path} is neither a run nor a model that is read here, but {_what_it_is(path)}: give {_READABLE}, or a run.")
    try:
        model = usable(_READERS[kind](path))
    except OSError as error:
        raise BadInput(f"cannot read {path}: {error.strerror or error}: check the path.") from error
    except BadInput as error:
        if str(path) in str(error):
            raise
        raise BadInput(f"cannot use {path}: {str(error).rstrip('.')}: export it anew, or as a binary 3DGS PLY file.") from error
    return ModelFile(splats=model.splats, notes=tuple(f"{path.name}: {note}." for note in model.notes))


def _json_kind(path: Path) -> ModelKind | None:
    if path.name == "lod-meta.json":
        return "lod"
    if path.name == "meta.json":
        return "sog"
    try:
        record: Any = parse_json(read_bounded(path, MAX_META_BYTES))
    except (StoreDamaged, ValueError, RecursionError):
        return None
    return "lod" if isinstance(record, dict) and {"lodLevels", "filenames", "tree"} <= record.keys() else None


def _what_it_is(path: Path) -> str:
    """What a file that is no model is, for a sentence."""
    if path.is_dir():
        return "a folder without a model"
    try:
        with open(path, "rb", opener=open_without_waiting) as file:
            head = file.read(16)
    except (OSError, ValueError) as error:
        return f"no file that can be read ({getattr(error, 'strerror', None) or error})"
    description = next((kind for start, kind in _OTHERS.items() if head.startswith(start)), None)
    if path.suffix.lower() == ".ksplat":
        description = "a .ksplat, which is not read"
    return description or f"a file that begins with {head!r}"


def _spz(path: Path) -> StoredGaussians:
    data = read_bounded(path, MAX_SPZ_BYTES)
    if data.startswith(b"NGSP"):
        from radiant_core.io.open3d_formats import splats_from_any_spz

        return stored(splats_from_any_spz(data), (SPZ_AXES,))
    stored_model = gaussians_of_gzip_spz(data)
    return StoredGaussians(**{**vars(stored_model), "notes": (SPZ_AXES,)})


def _lod(path: Path) -> StoredGaussians:
    """The finest level and the far field, as one model."""
    parts = [usable(part) for part in read_lod_level(path)]
    notes = [note for part in parts for note in part.notes]
    return stored(concatenate_splats([part.splats for part in parts]), tuple(notes))


def _safetensors(path: Path) -> StoredGaussians:
    from radiant_core.io.transport.upload import load_upload

    return stored(load_upload(path))


_READERS: dict[ModelKind, Callable[[Path], StoredGaussians]] = {
    "ply": read_ply,
    "sog": read_sog,
    "spz": _spz,
    "lod": _lod,
    "safetensors": _safetensors,
    "splat": lambda path: gaussians_of_splat(read_bounded(path, MAX_SPLAT_BYTES)),
}
