"""A model as streamed SOG 1: levels of detail that a viewer fetches as it needs them. Once per
export.

    lod-meta.json           the tree of leaves: the box of each; per level its file, offset, count
    {level}_{n}/meta.json   one chunk at one level, an unbundled SOG
    env/meta.json           the far field, drawn whole

n is 1000 · (the chunk's number in its region) + the region's number, so that a region that is
joined later renames nothing. Coordinates stay those of the model. Read by PlayCanvas's engine from
2.10 on, supersplat-viewer and splat-transform, whose writer (3.7) is the format's only description.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from radiant_core import __version__
from radiant_core.errors import BadInput
from radiant_core.export.sog import SogErrors, save_sog_folder
from radiant_core.io.run_store import write_json
from radiant_core.lod.cells import LodRegion
from radiant_core.lod.levels import Chunk, LeafTree, LodLimits, chunks_of, far_field, lay_out
from radiant_core.numerics import FloatArray
from radiant_core.splats import Splats

META_NAME, FAR_NAME = "lod-meta.json", "env"
MAX_REGIONS = 1000
DEFAULT_LIMITS = LodLimits()


@dataclass(frozen=True, kw_only=True)
class LodFigures:
    """What was written: Gaussians by level, of the far field, chunks, and the errors of the finest
    level as `SogErrors` has them."""

    counts: tuple[int, ...]
    num_far: int
    num_chunks: int
    errors: SogErrors


def save_lod(
    folder: Path,
    splats: Splats,
    regions: Sequence[LodRegion],
    limits: LodLimits = DEFAULT_LIMITS,
    report: Callable[[int, int], None] = lambda num_done, total: None,
) -> LodFigures:
    """Write a model into the existing empty `folder`.

    Args:
        folder: where the files go; `lod-meta.json` is written last.
        splats: at least one Gaussian.
        regions: the land that chunks belong to.
        limits: levels and sizes.
        report: called with the Gaussians done and all of them.

    Returns:
        What was written.

    Raises:
        BadInput: there are no Gaussians, too many regions, or a file cannot be written.
    """
    if not len(splats):
        raise BadInput(f"cannot write {folder}: the model has no Gaussians.")
    if len(regions) > MAX_REGIONS:
        raise BadInput(f"cannot write {folder}: {len(regions)} regions, expected at most {MAX_REGIONS}: give a plan with fewer.")
    layout = lay_out(splats, regions, limits)
    files, trees, errors = [], [], []
    counts = np.zeros(layout.num_levels, np.int64)
    if len(layout.far):
        save_sog_folder(folder / FAR_NAME, far_field(splats, layout))
    for chunk in chunks_of(splats, layout, report):
        for level, model in enumerate(chunk.levels):
            name = f"{level}_{MAX_REGIONS * chunk.number + chunk.region}"
            error = save_sog_folder(folder / name, model)
            errors += [(len(model), error)] if level == 0 else []
            files.append(f"{name}/meta.json")
        counts += [len(model) for model in chunk.levels]
        trees.append(_nodes(chunk.tree, chunk, len(files) - layout.num_levels))
    meta: dict[str, Any] = {
        "version": 1,
        "asset": {"generator": f"radiant {__version__}"},
        "count": int(counts.sum()),
        "counts": counts.tolist(),
        "lodLevels": layout.num_levels,
        **({"environment": f"{FAR_NAME}/meta.json"} if len(layout.far) else {}),
        "filenames": files,
        "tree": _paired(trees),
    }
    write_json(folder / META_NAME, meta)
    return LodFigures(counts=tuple(counts.tolist()), num_far=len(layout.far), num_chunks=len(trees), errors=_together(errors))


def _nodes(tree: LeafTree, chunk: Chunk, first_file: int) -> dict[str, Any]:
    if isinstance(tree, tuple):
        children = [_nodes(half, chunk, first_file) for half in tree]
        return _parent(children)
    leaf = chunk.leaves[tree]
    spans = {
        str(level): {"file": first_file + level, "offset": int(start), "count": int(count)}
        for level, (start, count) in enumerate(leaf.spans)
    }
    return {"bound": _bound(leaf.box), "lods": spans}


def _paired(trees: list[dict[str, Any]]) -> dict[str, Any]:
    """One binary tree over those of the chunks."""
    while len(trees) > 1:
        trees = [_parent(trees[at : at + 2]) if at + 1 < len(trees) else trees[at] for at in range(0, len(trees), 2)]
    return trees[0]


def _parent(children: list[dict[str, Any]]) -> dict[str, Any]:
    low = np.min([child["bound"]["min"] for child in children], axis=0)
    high = np.max([child["bound"]["max"] for child in children], axis=0)
    return {"bound": _bound(np.stack([low, high])), "children": children}


def _bound(box: FloatArray) -> dict[str, list[float]]:
    return {"min": [float(value) for value in box[0]], "max": [float(value) for value in box[1]]}


def _together(errors: list[tuple[int, SogErrors]]) -> SogErrors:
    weights = np.array([count for count, _ in errors], np.float64)
    rms = {
        name: float(np.sqrt(np.average([getattr(error, name) ** 2 for _, error in errors], weights=weights)))
        for name in ("log_scale_rms", "sh0_rms", "shN_rms")
    }
    return replace(errors[0][1], position_max_m=max(error.position_max_m for _, error in errors), **rms)
