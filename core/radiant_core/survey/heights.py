"""A raster of heights from points of the surface, with what is known of each cell. N points.

    top    = 90 % quantile of the heights in a cell
    height = mean of those within `SLAB_GSD` · GSD below and above it: the topmost surface
    σ      = √(s² / n + m² GSD²),  s the spread of these n heights, m of `MATCHING` or `RENDERING`
A point that two thirds of its cell lie far below is a stray; a cell of few points that stands alone
above or below its neighbours is taken out. What stays open is filled from around (`filled`), and
says so. Once per surface.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array
from radiant_core.survey.map_grid import MapGrid
from radiant_core.threads import in_order, usual_threads

UNKNOWN, MEASURED, FILLED = 0, 1, 2
"""Values of `HeightMap.source`."""
SLAB_GSD = 4.0
MATCHING, RENDERING = 0.4, 1.6
"""Error in height, in GSD, of points from photographs and from the model alone, that their
neighbours share, so that no number of them averages it out (docs/survey.md)."""
LONE_POINTS, LONE_GSD = 3, 15.0
"""Cells of fewer points, higher or lower than the median of 5 × 5 cells by so many GSD, are
taken out."""
FILL_CELLS = 25
"""Cells farther than this from any measured one stay unknown."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HeightMap:
    """heights (H,W) float64 on the map, NaN where unknown; sigma (H,W) float32, its standard
    deviation, NaN where unknown; source (H,W) uint8: 0 unknown, 1 measured, 2 filled."""

    grid: MapGrid
    heights: FloatArray
    sigma: NDArray[np.float32]
    source: NDArray[np.uint8]

    @property
    def measured(self) -> float:
        """Share of the cells that were measured."""
        return float((self.source == MEASURED).mean())

    def at(self, places: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Heights and σ (P,) of the cells that places (P,2) fall into; NaN outside and where
        unknown."""
        cells = np.floor(self.grid.cells_of(np.asarray(places, np.float64)))
        inside = np.asarray(((cells >= 0) & (cells < np.array(self.grid.shape))).all(axis=1))
        rows, columns = np.where(inside[:, None], cells, 0).astype(np.int64).T
        return np.where(inside, self.heights[rows, columns], np.nan), np.where(inside, self.sigma[rows, columns], np.nan).astype(np.float64)

    def bands(self, no_data: float) -> NDArray[np.float32]:
        """Height, σ and source (H,W,3), `no_data` where unknown."""
        layers = np.dstack([self.heights, self.sigma, self.source]).astype(np.float32)
        return np.where(self.source[..., None] != UNKNOWN, layers, np.float32(no_data))


def height_map(points: FloatArray, grid: MapGrid, gsd: float, shared_error: float = MATCHING) -> HeightMap:
    """Heights of N points (N,3) on the map, `gsd` the width of a photograph's pixel there, and
    `shared_error` what neighbouring points are off by together, in GSD.

    Raises BadInput for points that are not finite, and where none lies on the grid.
    """
    points = check_array("points", points, (None, 3))
    cells = np.floor(grid.cells_of(points[:, :2]))
    inside = ((cells >= 0) & (cells < np.array(grid.shape))).all(axis=1)
    if not inside.any():
        raise BadInput(
            f"none of {len(points):,} points lies on the raster: three photographs agree on no surface; look at the scene first."
        )
    flat = cells[inside, 0].astype(np.int64) * grid.columns + cells[inside, 1].astype(np.int64)
    heights = points[inside, 2]
    order = _by_cell_and_height(flat, heights, grid)
    flat, heights = flat[order], heights[order]
    owners, first, counts = np.unique(flat, return_index=True, return_counts=True)
    top = heights[first + np.floor(0.9 * (counts - 1)).astype(np.int64)]
    near = np.abs(heights - np.repeat(top, counts)) <= SLAB_GSD * gsd
    share = np.add.reduceat(near, first) / counts
    # A third of the points on top is a surface; fewer, above many, are strays: then the median.
    middle = heights[first + (counts - 1) // 2]
    near = np.where(np.repeat(share < 1 / 3, counts), np.abs(heights - np.repeat(middle, counts)) <= SLAB_GSD * gsd, near)
    number = np.add.reduceat(near, first)
    mean = np.add.reduceat(np.where(near, heights - np.repeat(top, counts), 0.0), first) / number
    spread2 = np.add.reduceat(np.where(near, np.square(heights - np.repeat(top + mean, counts)), 0.0), first) / np.maximum(number - 1, 1)
    # One point has no spread: that of a usual cell.
    usual = float(np.median(spread2[number > 2])) if (number > 2).any() else gsd**2
    sigma = np.sqrt(np.where(number > 2, spread2, usual) / number + (shared_error * gsd) ** 2)
    raster = _scattered(grid, owners, top + mean)
    counted = _scattered(grid, owners, number.astype(np.float64))
    lone = (counted < LONE_POINTS) & (np.abs(raster - _local_median(raster)) > LONE_GSD * gsd)
    reliable = np.isfinite(raster) & ~lone
    return HeightMap(
        grid=grid,
        heights=np.where(reliable, raster, np.nan),
        sigma=np.where(reliable, _scattered(grid, owners, sigma), np.nan).astype(np.float32),
        source=np.where(reliable, MEASURED, UNKNOWN).astype(np.uint8),
    )


def _by_cell_and_height(flat: NDArray[np.int64], heights: FloatArray, grid: MapGrid) -> NDArray[np.int64]:
    """Rows (N,) by cell, those of a cell by height, equal ones in any order. As `np.lexsort`; a
    stable sort of 16 bits, enough for a usual map, counts in place of comparing."""
    cells = flat.astype(np.uint16 if grid.rows * grid.columns <= 1 << 16 else np.int64)
    is_south = flat >= np.median(flat[:: max(1, len(flat) // 1000)])

    def sorted_rows(rows: NDArray[np.int64]) -> NDArray[np.int64]:
        by_height = rows[np.argsort(heights[rows])]
        return by_height[np.argsort(cells[by_height], kind="stable")]

    # Two halves of the map, which two threads sort.
    return np.concatenate(list(in_order(sorted_rows, (np.flatnonzero(~is_south), np.flatnonzero(is_south)), min(2, usual_threads()))))


def filled(surface: HeightMap, within: NDArray[np.bool_] | None = None, reach_cells: int = FILL_CELLS) -> HeightMap:
    """Cells `within` (H,W), by default all, and in reach of measured ones filled from around, by
    averages of ever larger squares (Gortler et al., SIGGRAPH 1996: push and pull); their σ is the
    spread of the heights around."""
    measured = surface.source == MEASURED
    if not measured.any() or measured.all():
        return surface
    away = cv2.distanceTransform((~measured).astype(np.uint8), cv2.DIST_L2, 5)
    open_ = ~measured & (away <= reach_cells) & (True if within is None else within)
    level = float(np.nanmedian(surface.heights))
    values = np.where(measured, surface.heights - level, 0.0).astype(np.float32)
    guess = push_pull(values, measured)
    spread = np.sqrt(np.maximum(push_pull(np.square(values), measured) - np.square(push_pull(values, measured, floor=2)), 0))
    return replace(
        surface,
        heights=np.where(open_, guess.astype(np.float64) + level, surface.heights),
        sigma=np.where(open_, np.maximum(spread, np.nanmedian(surface.sigma)) * (1 + away / 4), surface.sigma).astype(np.float32),
        source=np.where(open_, FILLED, surface.source).astype(np.uint8),
    )


def push_pull(values: NDArray[np.float32], is_known: NDArray[np.bool_], floor: int = 0) -> NDArray[np.float32]:
    """Values (H,W) everywhere: those known, and elsewhere the mean of the smallest square of 2, 4,
    8 … cells' side, smoothly joined, that holds known ones. `floor`: squares below 2^floor are
    averaged even where known."""
    weight = is_known.astype(np.float32)
    sums = values * weight
    pyramid: list[tuple[NDArray[Any], NDArray[Any]]] = [(sums, weight)]
    while max(pyramid[-1][0].shape) > 1:
        halves = [_halved(layer) for layer in pyramid[-1]]
        # Weights are capped: one well known corner does not outvote its square.
        scale = 1 / np.maximum(halves[1], 1)
        pyramid.append((halves[0] * scale, halves[1] * scale))
    result = np.zeros((1, 1), np.float32)
    for depth, (total, share) in zip(reversed(range(len(pyramid))), reversed(pyramid), strict=True):
        size = total.shape[1], total.shape[0]
        coarser = np.asarray(cv2.resize(result, size, interpolation=cv2.INTER_LINEAR), np.float32).reshape(total.shape)
        level_mean = total / np.maximum(share, 1e-6)
        part = np.minimum(share, 1) if depth >= floor else np.zeros_like(share)
        result = np.where(share > 0, part * level_mean + (1 - part) * coarser, coarser).astype(np.float32)
    return result


def _halved(layer: NDArray[np.float32]) -> NDArray[np.float32]:
    height, width = layer.shape
    padded = np.pad(layer, ((0, height % 2), (0, width % 2)))
    return padded[::2, ::2] + padded[1::2, ::2] + padded[::2, 1::2] + padded[1::2, 1::2]


def _scattered(grid: MapGrid, owners: NDArray[np.int64], values: FloatArray) -> FloatArray:
    raster = np.full(grid.rows * grid.columns, np.nan)
    raster[owners] = values
    return raster.reshape(grid.shape)


def _local_median(raster: FloatArray) -> NDArray[Any]:
    """Median of 5 × 5 cells (H,W), unknown ones taking part as filled from around."""
    is_finite = np.isfinite(raster)
    level = float(np.nanmedian(raster))
    whole = push_pull(np.where(is_finite, raster - level, 0).astype(np.float32), is_finite)
    return cv2.medianBlur(whole, 5).astype(np.float64) + level
