"""What a folder is that was given for another kind: one sentence that names it. Once per
command."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from radiant_core.errors import BadInput, RadiantError
from radiant_core.io.colmap.candidates import PICTURE_SUFFIXES
from radiant_core.io.run_store import read_json

MODEL_SUFFIXES = (".ply", ".spz", ".sog", ".splat")
PHOTOGRAPHS = "a folder of photographs, a COLMAP project or a Mill 19 folder"


class FolderKind(NamedTuple):
    """What a folder is, and what is done with one."""

    name: str
    use: str


def kind_of(folder: Path) -> FolderKind | None:
    """The kind of a folder that holds no photographs to read; None of one that may."""
    holds = {path.name for path in folder.iterdir()}
    if "manifest.json" in holds and holds & {"plan.json", "devices", "sfm", "scene.ply", "events.jsonl"}:
        return _run(folder, holds)
    if {"scene.safetensors", "result.json"} <= holds:
        return FolderKind("the result of `radiant sfm`", f"`radiant train {folder}` makes a model of it")
    if any({f"cameras{suffix}", f"images{suffix}"} <= holds for suffix in (".bin", ".txt")):
        return FolderKind(
            "a COLMAP model, which holds no photographs", "give the folder that has it in sparse/ and the photographs in images/"
        )
    if holds & {"lod-meta.json", "tileset.json"}:
        return FolderKind("an export of a model with levels of detail", "give the run or the photographs that it was made from")
    if "scene.ply" in holds:
        return FolderKind("a folder with a model", "`radiant inspect` shows it")
    return None


def require_photographs(source: Path) -> None:
    """Raise BadInput, naming what it is, for a source that is no folder or one of another kind."""
    if not source.is_dir():
        correction = "but a model" if source.suffix.lower() in MODEL_SUFFIXES and source.is_file() else ""
        raise BadInput(f"{' '.join(filter(None, (str(source), 'is no folder', correction)))}: give {PHOTOGRAPHS}.")
    if _holds_photographs(source):
        return
    kind = kind_of(source)
    if kind is not None:
        raise BadInput(f"{source} is {kind.name}: {kind.use}; here {PHOTOGRAPHS} is expected.")


def named_folder(folder: Path) -> str:
    """`folder` and what it is, for a command that expects a run: "x, which has 2 photographs,"."""
    if not folder.is_dir():
        return str(folder)
    if _holds_photographs(folder):
        pictures = folder / "images" if (folder / "images").is_dir() else folder
        count = sum(path.suffix.lower() in PICTURE_SUFFIXES for path in pictures.iterdir())
        return f"{folder}, which has {count} photographs,"
    kind = kind_of(folder)
    return str(folder) if kind is None else f"{folder}, {kind.name},"


def _holds_photographs(folder: Path) -> bool:
    inner = (folder / "images", folder / "train" / "metadata")
    return any(path.is_dir() for path in inner) or any(path.suffix.lower() in PICTURE_SUFFIXES for path in folder.iterdir())


def _run(folder: Path, holds: set[str]) -> FolderKind:
    trained = "plan.json" not in holds and "devices" not in holds
    noun = "training" if trained else "run"
    try:
        is_finished = read_json(folder / "manifest.json").get("status") == "done"
    except (RadiantError, AttributeError):
        is_finished = False
    # A training has no status: its figures come last.
    if is_finished or (trained and "metrics.json" in holds):
        return FolderKind(f"a finished {noun}", f"`radiant inspect {folder}` shows it, `radiant export {folder}` writes its model")
    return FolderKind(f"an unfinished {noun}", f"give the photographs it was made from, and --out {folder} --resume to go on with it")
