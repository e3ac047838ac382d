"""Triangles over the known cells of a raster of heights, for a textured mesh. Once per export."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiant_core.numerics import FloatArray
from radiant_core.survey.heights import UNKNOWN, HeightMap

MAX_VERTICES = 1_000_000
"""A browser still turns so many."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HeightMesh:
    """vertices (V,3) on the map, less an offset; triangles (T,3), counter-clockwise from above; uv
    (V,2) in the raster's picture, v upwards; step: every so many cells."""

    vertices: FloatArray
    triangles: NDArray[np.int64]
    uv: FloatArray
    step: int


def height_mesh(surface: HeightMap, offset: FloatArray, max_vertices: int = MAX_VERTICES) -> HeightMesh:
    """Two triangles for each square of four known cells, of every n-th cell so that no more than
    `max_vertices` are there; T may be 0. `offset` (3,) is taken off the map's coordinates."""
    rows, columns = surface.grid.shape
    step = int(np.ceil(np.sqrt(max(1.0, rows * columns / max_vertices))))
    heights = np.where(surface.source != UNKNOWN, surface.heights, np.nan)[::step, ::step]
    east, north = (axis[::step] for axis in surface.grid.centers())
    is_finite = np.isfinite(heights)
    number = np.full(heights.shape, -1)
    number[is_finite] = np.arange(is_finite.sum())
    at, across = np.nonzero(is_finite)
    vertices = np.column_stack([east[across], north[at], heights[is_finite]]) - offset
    uv = np.column_stack([(across * step + 0.5) / columns, 1 - (at * step + 0.5) / rows])
    nw, ne, sw, se = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    whole = (nw >= 0) & (ne >= 0) & (sw >= 0) & (se >= 0)
    triangles = np.concatenate([np.stack([nw, sw, se], axis=-1)[whole], np.stack([nw, se, ne], axis=-1)[whole]])
    return HeightMesh(vertices=vertices, triangles=triangles.astype(np.int64), uv=uv, step=step)
