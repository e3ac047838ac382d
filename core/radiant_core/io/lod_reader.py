"""`lod-meta.json` of strangers, checked to the last leaf. Once per file.

The format is described in `export.lod`, which writes it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.io.run_store import parse_json, read_bounded
from radiant_core.io.sog_reader import read_sog
from radiant_core.io.stored_gaussians import StoredGaussians, checked
from radiant_core.splats import Splats, concatenate_splats

MAX_META_BYTES, MAX_LEVELS, MAX_FILES, MAX_NODES = 256 << 20, 32, 1 << 20, 1 << 22
_KEYS = {"version", "asset", "count", "counts", "lodLevels", "lodErrors", "environment", "filenames", "tree"}


@dataclass(frozen=True, kw_only=True)
class LodMeta:
    """counts of Gaussians by level; files by level, of the whole, and how many Gaussians each has;
    environment, None without one; num_leaves."""

    counts: tuple[int, ...]
    files: tuple[tuple[str, ...], ...]
    file_counts: tuple[tuple[int, ...], ...]
    environment: str | None
    num_leaves: int


def load_lod_meta(path: Path) -> LodMeta:
    """What a lod-meta.json says; BadInput, which names it, for what is none of version 1, counts
    that differ from those of its leaves, and files that lie elsewhere."""
    try:
        return _checked(parse_json(read_bounded(path, MAX_META_BYTES)))
    except (ValueError, RecursionError) as error:
        reason = "it is nested too deeply" if isinstance(error, RecursionError) else str(error).rstrip(".")
        raise BadInput(f"cannot use {path}: {reason}: export it again.") from error


def load_lod_level(path: Path, level: int = 0) -> Splats:
    """One level of a lod-meta.json with its far field; raises as `load_lod_meta` and `load_sog`."""
    return concatenate_splats([_checked_part(part, path) for part in read_lod_level(path, level)])


def read_lod_level(path: Path, level: int = 0) -> list[StoredGaussians]:
    """The models of one level and the far field, the values unchecked; raises as
    `load_lod_level`."""
    meta = load_lod_meta(path)
    if not 0 <= level < len(meta.counts):
        raise BadInput(f"level {level} of {path} was asked for, which has 0 to {len(meta.counts) - 1}.")
    # Each file is held against what the tree says of it before its textures are decoded.
    parts = [read_sog(path.parent / name, count) for name, count in zip(meta.files[level], meta.file_counts[level], strict=True)]
    return parts + ([read_sog(path.parent / meta.environment)] if meta.environment else [])


def _checked_part(part: StoredGaussians, path: Path) -> Splats:
    try:
        return checked(part)
    except BadInput as error:
        raise BadInput(f"cannot use {path}: {error}") from error


def _checked(record: Any) -> LodMeta:
    if not isinstance(record, dict) or not record.keys() <= _KEYS or not record.keys() >= {"version", "lodLevels", "filenames", "tree"}:
        raise BadInput("it is no lod-meta.json")
    if record["version"] != 1:
        raise BadInput(f"its version is {str(record['version'])[:20]}, expected 1")
    levels = _whole("lodLevels", record["lodLevels"], 1, MAX_LEVELS)
    names = record["filenames"]
    if not isinstance(names, list) or len(names) > MAX_FILES or not all(_lies_below(name) for name in names):
        raise BadInput("its filenames are no list of files below it")
    if len(set(names)) < len(names):
        raise BadInput("its filenames name a file twice")
    environment = record.get("environment")
    if environment is not None and not _lies_below(environment):
        raise BadInput("its environment is no file below it")
    counts, of_file, num_leaves = np.zeros(levels, np.int64), np.zeros(len(names), np.int64), 0
    level_of_file = np.full(len(names), -1)
    for leaf in _leaves(record["tree"]):
        num_leaves += 1
        for level, file, offset, count in _spans(leaf, levels, len(names)):
            if level_of_file[file] not in (-1, level):
                raise BadInput(f"its file {names[file][:60]!r} is of two levels")
            if offset != of_file[file]:
                raise BadInput(f"a leaf begins at {offset} of {names[file][:60]!r}, expected {of_file[file]}")
            level_of_file[file] = level
            of_file[file] += count
            counts[level] += count
    if "counts" in record and record["counts"] != counts.tolist():
        raise BadInput(f"its counts are {str(record['counts'])[:60]}, its leaves have {counts.tolist()}")
    of_level = [np.flatnonzero(level_of_file == level) for level in range(levels)]
    return LodMeta(
        counts=tuple(counts.tolist()),
        files=tuple(tuple(names[file] for file in files) for files in of_level),
        file_counts=tuple(tuple(of_file[files].tolist()) for files in of_level),
        environment=environment,
        num_leaves=num_leaves,
    )


def _leaves(tree: Any) -> Iterator[dict[str, Any]]:
    """The leaves of a tree whose boxes are boxes."""
    waiting, num_nodes = [tree], 0
    while waiting:
        node = waiting.pop()
        num_nodes += 1
        if not isinstance(node, dict) or not isinstance(node.get("bound"), dict) or num_nodes > MAX_NODES:
            raise BadInput("its tree has a node without a bound")
        low, high = (_point(node["bound"].get(end)) for end in ("min", "max"))
        if any(a > b for a, b in zip(low, high, strict=True)):
            raise BadInput(f"a bound of its tree goes from {low} to {high}")
        children = node.get("children")
        if children is None:
            yield node
        elif not isinstance(children, list):
            raise BadInput("its tree has children that are no list")
        else:
            waiting += reversed(children)


def _spans(leaf: dict[str, Any], levels: int, num_files: int) -> Iterator[tuple[int, int, int, int]]:
    spans = leaf.get("lods")
    if not isinstance(spans, dict):
        raise BadInput("its tree has a leaf without lods")
    for key, span in spans.items():
        if not (key.isascii() and key.isdigit() and len(key) <= 3) or not isinstance(span, dict):
            raise BadInput(f"a leaf has the level {key[:20]!r}")
        level = _whole("a level", int(key), 0, levels - 1)
        file = _whole("a file", span.get("file"), 0, num_files - 1)
        yield level, file, _whole("an offset", span.get("offset"), 0, 2**40), _whole("a count", span.get("count"), 0, 2**40)


def _point(value: Any) -> list[float]:
    numbers = isinstance(value, list) and len(value) == 3 and all(isinstance(x, int | float) and not isinstance(x, bool) for x in value)
    if not numbers:
        raise BadInput("a bound of its tree is not three numbers")
    if any(abs(x) > 1e38 for x in value):
        raise BadInput("a bound of its tree lies beyond float32")
    return [float(x) for x in value]


def _whole(name: str, value: Any, low: int, high: int) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise BadInput(f"{name} is {str(value)[:30] if not isinstance(value, int) else 'a number'}, expected {low} to {high}")
    return value


def _lies_below(name: Any) -> bool:
    if not isinstance(name, str) or not 0 < len(name) <= 200 or not name.isprintable() or "\\" in name or ":" in name:
        return False
    return all(part not in ("", ".", "..") and not part.startswith(".") for part in name.split("/"))
