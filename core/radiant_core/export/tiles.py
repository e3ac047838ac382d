"""A model as 3D Tiles 1.1: levels of detail as GLB with KHR_gaussian_splatting, compressed as SPZ
or plain. Once per export.

    tileset.json     root ─ far field, whole
                     └ per chunk: the coarsest level ─ … ─ the finest, each for the last
    {level}_{n}.glb  as in `export.lod`, about the chunk's own middle

The root's transform puts east, north and up of the scene's origin on the globe, in doubles; each
tile's adds its middle, so that float32 has to hold no more than a chunk. A tile's error in metres
is the radius of its median Gaussian, which is what a level fails to show.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from radiant_core import __version__
from radiant_core.choices import TileContent
from radiant_core.errors import BadInput
from radiant_core.export.glb import EXTENSIONS, glb_bytes
from radiant_core.export.lod import FAR_NAME, MAX_REGIONS
from radiant_core.frames import Frame, ecef_from_local
from radiant_core.io.run_store import write_atomic
from radiant_core.lod.cells import LodRegion, ellipsoid_box
from radiant_core.lod.levels import DEVIATIONS, Chunk, LodLimits, chunks_of, far_field, lay_out
from radiant_core.lod.merging import covariances
from radiant_core.numerics import FloatArray
from radiant_core.splats import Splats

TILESET_NAME = "tileset.json"
TILE_LIMITS = LodLimits(chunk_count=64 * 1024)
"""A plain GLB takes 56 bytes a Gaussian and 12 for each harmonic above degree 0; SPZ a fifth."""


@dataclass(frozen=True, kw_only=True)
class TileOptions:
    """How tiles are written; a frame with GPS puts them on the globe."""

    frame: Frame | None = None
    limits: LodLimits = TILE_LIMITS
    form: TileContent = "spz"


DEFAULT_OPTIONS = TileOptions()


def save_tiles(
    folder: Path,
    splats: Splats,
    regions: Sequence[LodRegion],
    options: TileOptions = DEFAULT_OPTIONS,
    report: Callable[[int, int], None] = lambda num_done, total: None,
) -> tuple[int, ...]:
    """Write a model of at least one Gaussian into the existing empty `folder`. Returns the
    Gaussians of each level; raises BadInput as `save_lod`."""
    form, frame = options.form, options.frame
    if not len(splats) or len(regions) > MAX_REGIONS:
        raise BadInput(f"cannot write {folder}: {len(splats)} Gaussians in {len(regions)} regions, expected at least 1 in at most 1000.")
    layout = lay_out(splats, regions, options.limits)
    counts, tiles = np.zeros(layout.num_levels, np.int64), []
    if len(layout.far):
        far = far_field(splats, layout)
        tiles.append(_placed(_tile(folder / f"{FAR_NAME}.glb", far, _box(far), 0.0, form), _box(far)))
    for chunk in chunks_of(splats, layout, report):
        box = np.stack([np.min([leaf.box[0] for leaf in chunk.leaves], axis=0), np.max([leaf.box[1] for leaf in chunk.leaves], axis=0)])
        tiles.append(_placed(_chain(folder, chunk, box, form), box))
        counts += [len(level) for level in chunk.levels]
    low = np.min([_corner(tile, -1) for tile in tiles], axis=0)
    high = np.max([_corner(tile, 1) for tile in tiles], axis=0)
    error_m = 2 * max((tile["geometricError"] for tile in tiles), default=0.0) + float(np.linalg.norm(high - low)) / 16
    root: dict[str, Any] = {"boundingVolume": _volume(np.stack([low, high])), "geometricError": error_m, "refine": "ADD"}
    if frame is not None and frame.kind == "metric":
        root["transform"] = ecef_from_local(frame.origin_lat_lon_alt).T.ravel().tolist()
    # CesiumJS takes content for Gaussians only where both extensions are required.
    keys = ("extensionsUsed", "extensionsRequired") if form == "spz" else ("extensionsUsed",)
    tileset = {
        "asset": {"version": "1.1", "generator": f"radiant {__version__}"},
        "extensionsUsed": ["3DTILES_content_gltf"],
        "extensions": {"3DTILES_content_gltf": dict.fromkeys(keys, EXTENSIONS[form])},
        "geometricError": 2 * error_m,
        "root": {**root, "children": tiles},
    }
    write_atomic(folder / TILESET_NAME, json.dumps(tileset, allow_nan=False).encode())
    return tuple(counts.tolist())


def _chain(folder: Path, chunk: Chunk, box: FloatArray, form: TileContent) -> dict[str, Any]:
    """The levels of a chunk, each the only child of the coarser one, which it replaces."""
    n = MAX_REGIONS * chunk.number + chunk.region
    tile: dict[str, Any] = {}
    for level, splats in enumerate(chunk.levels):
        # The finest has no error; a coarser one is as wrong as its Gaussians are large.
        error_m = 0.0 if level == 0 else max(_radius(splats), 1.001 * tile["geometricError"])
        finer = {"children": [tile]} if tile else {}
        tile = {**_tile(folder / f"{level}_{n}.glb", splats, box, error_m, form), **finer}
    return tile


def _tile(path: Path, splats: Splats, box: FloatArray, error_m: float, form: TileContent) -> dict[str, Any]:
    middle = _middle(box)
    write_atomic(path, glb_bytes(splats, middle, form))
    return {"boundingVolume": _volume(box - middle), "geometricError": error_m, "refine": "REPLACE", "content": {"uri": path.name}}


def _placed(tile: dict[str, Any], box: FloatArray) -> dict[str, Any]:
    """A tile about the middle of its box, moved there with all below it."""
    return {**tile, "transform": [1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, *_middle(box).tolist(), 1]}


def _middle(box: FloatArray) -> FloatArray:
    # A millimetre is a number that a reader sees whole; the chunk's place itself is in doubles.
    return np.round(box.mean(axis=0), 3)


def _box(splats: Splats) -> FloatArray:
    return ellipsoid_box(splats.means.astype(np.float64), covariances(splats), DEVIATIONS)


def _radius(splats: Splats) -> float:
    return float(np.median(np.exp(splats.log_scales.astype(np.float64)).max(axis=1)))


def _volume(box: FloatArray) -> dict[str, list[float]]:
    half = np.maximum((box[1] - box[0]) / 2, 1e-6)
    return {"box": [*box.mean(axis=0).tolist(), *np.diag(half).ravel().tolist()]}


def _corner(tile: dict[str, Any], sign: int) -> FloatArray:
    numbers = np.array(tile["boundingVolume"]["box"])
    return numbers[:3] + np.array(tile["transform"][12:15]) + sign * numbers[[3, 7, 11]]
