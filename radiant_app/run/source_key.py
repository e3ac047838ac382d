"""The key of structure from motion: the used files of its source, by content. Once per (re)start.

    sfm/source.json     file by name: size in bytes, time of change in ns, SHA-256

A file whose size and time are those of the record keeps its hash; any other is read again. So a
note beside the photographs, a copy without times or a `touch` changes nothing, and a warning about
changed files precedes the new reconstruction.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

from radiant_app.config.run_config import RunConfig
from radiant_app.events import Listener, Warned
from radiant_app.workers.sources import detect_source
from radiant_app.workers.tasks import SfmTask
from radiant_core import __version__
from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.hierarchy.codec import message_record
from radiant_core.io.colmap.image_files import match_images
from radiant_core.io.colmap.model import image_names, model_files
from radiant_core.io.colmap.records import is_image_name
from radiant_core.io.film.formats import films_in, srt_beside
from radiant_core.io.photos.folders import SUFFIXES, photograph_names
from radiant_core.io.photos.masks import find_masks
from radiant_core.io.poses.recognise import alignment_files
from radiant_core.io.run_store import SEAL_NAME, content_key, file_sha256, read_json, write_json

RECORD_NAME = "source.json"
NUM_READERS = 4
MAX_NAMED = 5
"""Files named in one warning."""
OLDER = "an older version made this scene"
UNREADABLE = ""
"""In place of a hash: structure from motion itself reports files it cannot read."""
Files = dict[str, list[Any]]
"""The content of source.json: name → size, modification time, SHA-256."""


def source_key(config: RunConfig, task: SfmTask, folder: Path, listen: Listener) -> str:
    """The key of structure from motion by a task in `folder`; warns if the result is outdated."""
    recorded = _read_record(folder)
    masks = None if task.masks is None else Path(task.masks)
    files = _describe_files(used_files(config.source, masks, config.sfm.poses), recorded or {})
    refined = ["refine_poses"] if task.refine_poses else []
    settings = [message_record(task.sfm), message_record(task.placement), message_record(task.intake), *refined]
    key = content_key(__version__, settings, {name: digest for name, (_, _, digest) in files.items()}, masks is None)
    if (folder / SEAL_NAME).is_file():
        reason = OLDER if recorded is None else _change(recorded, files)
        if reason is not None:
            listen(Warned(stage="sfm", message=f"{reason}: structure from motion and everything after it run again."))
    if files != recorded:
        write_json(folder / RECORD_NAME, files)
    return key


def used_files(source: Path, masks: Path | None, poses_source: Path | None = None) -> dict[str, Path]:
    """Name → file that structure from motion uses; of a COLMAP project its model and images;
    `poses_source`: what --poses names."""
    kind, images, model = detect_source(source, poses_source)
    if kind == "film":
        films = films_in(images)
        subtitles = [srt for film in films if (srt := srt_beside(film)) is not None]
        # Which frames there will be, and so which masks fit, is known once they are taken.
        pictures = [] if masks is None or not masks.is_dir() else sorted(masks.rglob("*"))
        inside = {f"mask {path.relative_to(masks or source).as_posix()}": path for path in pictures if path.suffix.lower() in SUFFIXES}
        return {path.name: path for path in (*films, *subtitles)} | {name: path for name, path in inside.items() if path.is_file()}
    if kind == "mill19":
        poses = [path for split in ("train", "val") for path in sorted((source / split / "metadata").glob("*.pt"))]
        posed = {(path.parts[-3], path.stem) for path in poses}
        pictures = [path for path in sorted(source.glob("*/rgbs/*")) if path.suffix.lower() in SUFFIXES]
        names = [path.relative_to(source).as_posix() for path in pictures if (path.parts[-3], path.stem) in posed]
        others = [source / "coordinates.pt", *poses]
    elif kind == "alignment":
        assert model is not None
        names, others = list(photograph_names(images)), [*alignment_files(model)]
    elif model is not None:
        names, others = list(match_images(image_names(model), images).files.values()), model_files(model)
    else:
        names, others = list(photograph_names(images)), []
    names = [name for name in names if is_image_name(name)]
    path_of = {name: images / name for name in names} | {_name_of(path, source): path for path in others}
    if masks is not None:
        # Structure from motion itself reports masks that fit no photograph.
        with suppress(BadInput):
            path_of |= {f"mask of {name}": path for name, path in find_masks(masks, names).items()}
    return {os.fsencode(name).decode(errors="backslashreplace"): path for name, path in path_of.items() if path.is_file()}


def _name_of(path: Path, source: Path) -> str:
    """How a file is named: below the source where it lies there."""
    path = path if path.is_relative_to(source) else path.resolve()
    return str(path.relative_to(source) if path.is_relative_to(source) else path)


def _read_record(folder: Path) -> Files | None:
    try:
        record = read_json(folder / RECORD_NAME)
    except StoreDamaged:
        return None
    whole = isinstance(record, dict) and all(isinstance(row, list) and len(row) == 3 for row in record.values())
    return record if whole else None


def _describe_files(paths: Mapping[str, Path], recorded: Files) -> Files:
    """Size, time and hash of each file; a known hash is kept if size and time are unchanged."""

    def describe(name: str) -> list[Any]:
        status = paths[name].stat()
        size_and_time = [status.st_size, status.st_mtime_ns]
        if name in recorded and recorded[name][:2] == size_and_time:
            return recorded[name]
        try:
            return [*size_and_time, file_sha256(paths[name])]
        except StoreDamaged:
            return [*size_and_time, UNREADABLE]

    with ThreadPoolExecutor(NUM_READERS) as pool:
        return dict(zip(paths, pool.map(describe, paths), strict=True))


def _change(recorded: Files, files: Files) -> str | None:
    changes = {
        "new": [name for name in files if name not in recorded],
        "gone": [name for name in recorded if name not in files],
        "with other content": [name for name, row in files.items() if name in recorded and recorded[name][2] != row[2]],
    }
    changed = [f"{len(names)} {how} ({_list_names(names)})" for how, names in changes.items() if names]
    return f"photographs changed: {', '.join(changed)}" if changed else None


def _list_names(names: Sequence[str]) -> str:
    return ", ".join(names[:MAX_NAMED]) + (" …" if len(names) > MAX_NAMED else "")
