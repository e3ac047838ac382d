"""PlayCanvas's compressed PLY (SuperSplat's NAME.compressed.ply): 16 bytes a Gaussian. Once per
file.

    chunk   per 256 Gaussians: least and greatest centre, log scale and, in later files, colour
    vertex  packed_position, packed_scale  11, 10, 11 bits of x y z between those
            packed_rotation  2 bits which of w x y z is left out, 10 each of the rest in ±1/√2
            packed_color     8 bits each of r g b between those, else 0 to 1, and of the opacity
    sh      bytes of f_rest_*, ±4 in steps of 1/32: all bases of red, then of green, then of blue

Source: gsplat 1.5.3 (`exporter.py`), checked against it and splat-transform 2.7.1.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.io.ply_elements import Table
from radiant_core.io.stored_gaussians import END_OPACITY, StoredGaussians
from radiant_core.numerics import FloatArray
from radiant_core.splats import SH_C0

ROWS_OF = {"chunk": "chunks", "sh": "rows of harmonics"}
"""The elements beside "vertex", and what their rows are."""
PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
CHUNK_ROWS = 256
_AXES, _COLORS = ("x", "y", "z"), ("r", "g", "b")
_STORED_COMPONENTS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])


def gaussians_of_chunks(tables: Mapping[str, Table], *, antialiased: bool) -> StoredGaussians:
    """The N Gaussians of the elements vertex, chunk and sh; BadInput where they do not fit each
    other."""
    vertices, chunks = tables["vertex"], tables.get("chunk")
    count = len(vertices)
    wanted = [f"{end}{of}{axis}" for of in ("", "scale_") for end in ("min_", "max_") for axis in _AXES]
    if chunks is None or len(chunks) != -(-count // CHUNK_ROWS) or not all(chunks.has(name, "f") for name in wanted):
        raise BadInput(f"its {count} packed Gaussians do not have a chunk with its bounds for every {CHUNK_ROWS}")
    packed = vertices.columns(PACKED, np.uint32)
    chunk = np.arange(count) // CHUNK_ROWS
    color_bytes = packed[:, 3, None] >> np.array([24, 16, 8, 0], np.uint32) & 255
    colors = color_bytes[:, :3] / 255
    if all(chunks.has(f"{end}{name}", "f") for end in ("min_", "max_") for name in _COLORS):
        colors = _between(chunks, "", _COLORS, chunk, colors)
    opacity = np.clip(color_bytes[:, 3] / 255, END_OPACITY, 1 - END_OPACITY)
    return StoredGaussians(
        means=_between(chunks, "", _AXES, chunk, _three(packed[:, 0])),
        quats=_quats(packed[:, 1]),
        log_scales=_between(chunks, "scale_", _AXES, chunk, _three(packed[:, 2])),
        logit_opacities=np.log(opacity) - np.log1p(-opacity),
        sh0=((colors - 0.5) / SH_C0)[:, None, :],
        shN=_harmonics(tables.get("sh"), count),
        antialiased=antialiased,
    )


def _three(words: NDArray[np.uint32]) -> FloatArray:
    """Shares (N,3) of 11, 10 and 11 bits."""
    return np.column_stack([(words >> 21) / 2047, (words >> 11 & 1023) / 1023, (words & 2047) / 2047])


def _between(chunks: Table, of: str, names: tuple[str, ...], chunk: NDArray[np.int64], share: FloatArray) -> FloatArray:
    """Values (N,3) at shares of the way from the least to the greatest of each one's chunk."""
    low, high = (chunks.columns([f"{end}{of}{name}" for name in names], np.float64)[chunk] for end in ("min_", "max_"))
    # A bound that is not finite makes its Gaussians such, which are counted where they are read.
    with np.errstate(invalid="ignore", over="ignore"):
        return low * (1 - share) + high * share


def _quats(words: NDArray[np.uint32]) -> FloatArray:
    rows, largest = np.arange(len(words)), (words >> 30).astype(np.int64)
    components = np.column_stack([(words >> shift & 1023) / 1023 - 0.5 for shift in (20, 10, 0)]) * math.sqrt(2)
    quats = np.empty((len(words), 4))
    quats[rows[:, None], _STORED_COMPONENTS[largest]] = components
    quats[rows, largest] = np.sqrt(np.maximum(0, 1 - (components**2).sum(axis=1)))
    return quats


def _harmonics(table: Table | None, count: int) -> NDArray[np.float32]:
    if table is None:
        return np.zeros((count, 0, 3), np.float32)
    names = [f"f_rest_{index}" for index in range(len(table.element.properties))]
    if len(names) not in (0, 9, 24, 45) or len(table) != count or not all(table.has(name, "iu") for name in names):
        raise BadInput(f"its element 'sh' has {len(table)} rows of {len(names)} properties, expected {count} of 9, 24 or 45")
    stored = table.columns(names, np.uint8)
    # The middle of each step, but for the ends, which are ±4 themselves.
    share = np.where(stored == 0, 0.0, np.where(stored == 255, 1.0, (stored + 0.5) / 256))
    return np.asarray(8 * (share - 0.5), np.float32).reshape(count, 3, -1).transpose(0, 2, 1)
