"""Level of detail of a large cloud: few points while a view moves, every visible one at rest.

    moving:  at most 50,000: one per occupied cell of the finest octree level with so few cells, the
             rest from the next level
    at rest: of all N points the nearest to the camera in each cell of the picture

The first is chosen once per cloud, O(N log N), 0.27 to 0.36 s of CPU for a million points and 0.3
to 0.5 s for five; the second once per view, O(N), 0.10 to 0.16 s per million (`radiant bench
viewer`, four runs). Both are deterministic. A software rasterizer spends 1 µs per point, also on
hidden ones.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array, require_finite
from radiant_viewer.layers.layer import Layer

MOVING_POINTS = 50_000
"""Points of all clouds together while a view moves."""
WHOLE_POINTS = 200_000
"""Largest cloud that is drawn whole at rest; of larger ones, the visible points."""
BITS_PER_AXIS = 16
"""An octree of 16 levels: cells of 1.5 cm where a scene is 1 km wide, however far a stray lies."""
_SORTED_POINTS = 1_000_000
"""Larger clouds are subsampled first: sorting five million points takes 1.5 s."""
_CHUNK = 1 << 18
"""Points projected at a time, so that they stay in the cache."""


def even_subset(points: NDArray[np.floating], limit: int) -> NDArray[np.int64]:
    """Return ascending indices (K,) of at most `limit` points (N,3), evenly over occupied space.

    A point's level is the first octree level at which it has its own cell along the Morton curve,
    so the points up to level L are one per occupied cell of that level. Raises BadInput for a limit
    below 1 or a coordinate that is not finite.
    """
    if limit < 1:
        raise BadInput(f"{limit} points were asked for, expected at least 1.")
    if len(points) <= limit:
        return np.arange(len(points))
    step = max(1, min(len(points) // _SORTED_POINTS, len(points) // limit))
    require_finite("points to thin", points)
    codes = _morton_codes(check_array("points to thin", points[::step], (None, 3)))
    order = np.argsort(codes, kind="stable")
    levels = _first_levels(codes[order])
    last = int(np.searchsorted(np.cumsum(np.bincount(levels)), limit, side="right"))
    cells = _pick_per_cell(np.flatnonzero(levels < last), len(order))
    free = levels == last
    free[cells] = False
    below = np.flatnonzero(free)
    # Spread along the curve: a prefix would fill one corner.
    fillers = below[np.linspace(0, len(below) - 1, min(limit - len(cells), len(below))).astype(np.int64)]
    return np.sort(order[np.concatenate([cells, fillers])]) * step


def _pick_per_cell(starts: NDArray[np.int64], stop: int) -> NDArray[np.int64]:
    """Return one point per cell that begins at `starts`; always the first would draw a grid."""
    sizes = np.diff(np.append(starts, stop))
    shares = (np.arange(len(starts)) * 0.6180339887498949) % 1.0
    return starts + (shares * sizes).astype(np.int64)


def _morton_codes(positions: FloatArray) -> NDArray[np.uint64]:
    """Return Morton codes (N,): interleaved bits of the axes' cells in a cube around everything."""
    low = positions.min(axis=0)
    side = float((positions.max(axis=0) - low).max())
    scale = (2**BITS_PER_AXIS - 1) / side if side > 0 else 0.0
    codes = np.empty(len(positions), np.uint64)
    for start in range(0, len(positions), _CHUNK):
        cells = ((positions[start : start + _CHUNK] - low) * scale).astype(np.uint64)
        spread = _spread_bits(cells) << np.arange(3, dtype=np.uint64)
        codes[start : start + _CHUNK] = spread[:, 0] | spread[:, 1] | spread[:, 2]
    return codes


def _spread_bits(cells: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Insert two empty bits between any two of 16: 0b11 gives 0b1001."""
    for shift, mask in ((16, 0xFF0000FF), (8, 0xF00F00F00F), (4, 0xC30C30C30C3), (2, 0x249249249249)):
        cells = (cells | (cells << np.uint64(shift))) & np.uint64(mask)
    return cells


def _first_levels(sorted_codes: NDArray[np.uint64]) -> NDArray[np.int64]:
    """Return the level (N,) at which each code first differs from the previous one: 0 for the
    first, 17 for equal codes."""
    differing = sorted_codes[1:] ^ sorted_codes[:-1]
    # Bit lengths up to 48 are exact in float64.
    lengths = np.frexp(differing.astype(np.float64))[1].astype(np.int64)
    return np.append(0, BITS_PER_AXIS + 1 - (lengths + 2) // 3)


def visible_subset(points: NDArray[np.float32], clip_from_world: FloatArray, size_wh: tuple[int, int], cell_px: float) -> NDArray[np.int64]:
    """Return ascending indices (K,) of the points (N,3) nearest to the camera in their cell of
    `cell_px` px of a picture `size_wh`. clip_from_world (4,4) maps to OpenGL's clip space; points
    behind the camera or outside the picture are in no cell, near and far planes do not clip.
    Raises BadInput for a cell or a picture without size."""
    columns, rows = (int(np.ceil(side / cell_px)) if cell_px > 0 else 0 for side in size_wh)
    if columns < 1 or rows < 1:
        raise BadInput(f"cells of {cell_px} px in a picture of {size_wh[0]} × {size_wh[1]} px came, expected positive sizes.")
    nearest = np.full(columns * rows, np.iinfo(np.uint64).max, np.uint64)
    matrix = np.asarray(clip_from_world, np.float32).T
    cells_wh = np.array([size_wh[0] / cell_px, size_wh[1] / cell_px], np.float32)
    for start in range(0, len(points), _CHUNK):
        clip = points[start : start + _CHUNK] @ matrix[:3] + matrix[3]
        before = np.flatnonzero(clip[:, 3] > 0)
        scaled = clip[before, :3] / clip[before, 3:]
        xy = (scaled[:, :2] + 1) * (cells_wh / 2)
        inside = np.flatnonzero(((xy >= 0) & (xy < cells_wh)).all(axis=1))
        cells = xy[inside].astype(np.int64)
        keys = _sortable_bits(scaled[inside, 2]) << np.uint64(32) | (before[inside] + start).astype(np.uint64)
        np.minimum.at(nearest, cells[:, 1] * columns + cells[:, 0], keys)
    nearest_keys = nearest[nearest != np.iinfo(np.uint64).max]
    return np.sort((nearest_keys & np.uint64(0xFFFFFFFF)).astype(np.int64))


def _sortable_bits(depths: NDArray[np.float32]) -> NDArray[np.uint64]:
    """Return integers of 32 bits in the order of the floats."""
    bits = np.ascontiguousarray(depths).view(np.uint32)
    return np.where(bits >> 31, ~bits, bits | np.uint32(0x80000000)).astype(np.uint64)


def is_thinned(layer: Layer) -> bool:
    """Return whether a layer is a cloud that is thinned while the view moves."""
    return len(layer.points) > MOVING_POINTS and not layer.point_rim


def moving_note(layer: Layer) -> str | None:
    """Return the legend's note on a thinned layer; None for others."""
    if not is_thinned(layer):
        return None
    return f"at most {MOVING_POINTS:,} while the view moves"
