"""The surface of a height map as facets, and which of them a place sees. Once per map.

    top    a facet per known cell, facing up along its slope
    wall   where neighbours differ in height by more than `STEP_CELLS` cells: a stack of facets of a
           cell's height between them, facing the lower cell

A ray from a facet to an eye is followed from cell to cell up to the highest surface; it is blocked
where it runs more than `TOLERANCE_CELLS` cells below the height there. Cells that are not known
block nothing. A surface that hangs over is not described. K facets; H × W cells of side c.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.survey.heights import UNKNOWN, HeightMap

STEP_CELLS = 1.5
TOLERANCE_CELLS = 0.25
LIFT_CELLS = 0.6
"""How far before its facet a ray begins, so that the facet's cell does not block it."""
DROPPED_SHARE = 0.2
"""Rays that are blocked are dropped once they are such a share of those that go on."""
Rows = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Facets:
    """places (K,3) on the map, normals (K,3) of length 1, areas (K,) in square units, is_wall (K,),
    cells (K,2): row and column of the cell that a top is of, or that a wall faces."""

    surface: HeightMap
    places: FloatArray
    normals: FloatArray
    areas: FloatArray
    is_wall: NDArray[np.bool_]
    cells: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.places)

    def sample(self, most: int) -> Facets:
        """At most so many of the facets, drawn evenly with a fixed seed; each stands for as many
        as were left out, so that areas keep their sum."""
        if len(self) <= most:
            return self
        rows = np.sort(np.random.default_rng(0).choice(len(self), most, replace=False))
        return Facets(
            surface=self.surface,
            places=self.places[rows],
            normals=self.normals[rows],
            areas=self.areas[rows] * (self.areas.sum() / self.areas[rows].sum()),
            is_wall=self.is_wall[rows],
            cells=self.cells[rows],
        )

    @cached_property
    def highest(self) -> float:
        """The highest known height."""
        return float(np.nanmax(self.surface.heights))

    @cached_property
    def _ringed(self) -> FloatArray:
        """The heights within a ring of cells (H+2,W+2) that are not known."""
        return np.pad(self.surface.heights, 1, constant_values=np.nan)

    def seen_from(self, eye: FloatArray, rows: Rows) -> NDArray[np.bool_]:
        """Which facets (R,), of `rows`, no other surface hides from an eye (3,) on the map; whether
        they face it does not count."""
        grid, cell = self.surface.grid, self.surface.grid.cell
        start = self.places[rows] + LIFT_CELLS * cell * self.normals[rows]
        ahead = eye - start
        level = np.maximum(np.linalg.norm(ahead[:, :2], axis=1), 1e-9 * cell)
        rise = ahead[:, 2] / level
        # A ray above everything, or at its eye, meets nothing any more.
        climb = np.where(rise > 0, (self.highest - start[:, 2]) / np.maximum(rise, 1e-12), np.inf)
        ends = np.floor(np.minimum(level, climb) / cell)
        visible = np.ones(len(rows), bool)
        # The longest rays first: those that go on are a beginning of all, which needs no copies.
        going = np.flatnonzero(ends >= 1)
        going = going[np.argsort(-ends[going])]
        step = (np.column_stack([ahead[:, :2] / level[:, None], rise]) * cell)[going].T.copy()
        at, last, is_hit = start[going].T.copy(), -ends[going], np.zeros(len(going), bool)
        for number in range(1, int(-last.min(initial=0)) + 1):
            count = int(np.searchsorted(last, -number, side="right"))
            if not count:
                break
            at[:, :count] += step[:, :count]
            x, y, z = at[:, :count]
            row = np.clip(np.floor((grid.north_west[1] - y) / cell), -1, grid.rows).astype(np.int64)
            column = np.clip(np.floor((x - grid.north_west[0]) / cell), -1, grid.columns).astype(np.int64)
            # NaN, where nothing is known, compares as false.
            is_hit[:count] |= self._ringed[row + 1, column + 1] > z + TOLERANCE_CELLS * cell
            if np.count_nonzero(is_hit[:count]) > DROPPED_SHARE * count:
                visible[going[is_hit]] = False
                going, at, step, last = going[~is_hit], at[:, ~is_hit], step[:, ~is_hit], last[~is_hit]
                is_hit = np.zeros(len(going), bool)
        visible[going[is_hit]] = False
        return visible


def facets_of(surface: HeightMap) -> Facets:
    """The facets of all known cells, their heights smoothed by the median of 3 × 3 cells; BadInput
    where none is known."""
    is_known = surface.source != UNKNOWN
    if not is_known.any():
        raise BadInput("no height of the surface is known, so it has no facets: train the model further.")
    smooth = _median(surface.heights, is_known)
    surface = HeightMap(grid=surface.grid, heights=smooth, sigma=surface.sigma, source=surface.source)
    parts = [_tops(surface, is_known), *(_walls(surface, is_known, axis) for axis in (0, 1))]
    places, normals, areas = (np.concatenate([part[index] for part in parts]).astype(np.float64) for index in range(3))
    cells = np.concatenate([part[3] for part in parts])
    is_wall = np.arange(len(places)) >= len(parts[0][0])
    return Facets(surface=surface, places=places, normals=normals, areas=areas, is_wall=is_wall, cells=cells)


_Part = tuple[FloatArray, FloatArray, FloatArray, NDArray[np.int64]]


def _median(heights: FloatArray, is_known: NDArray[np.bool_]) -> FloatArray:
    """The median of each 3 × 3 cells; what is not known stays so, and takes part as its own cell's
    mean of the known ones."""
    level = float(np.nanmedian(heights))
    filled = np.where(is_known, heights - level, 0.0).astype(np.float32)
    weights = cv2.blur(is_known.astype(np.float32), (3, 3))
    around = cv2.blur(filled, (3, 3)) / np.maximum(weights, 1e-6)
    middle = cv2.medianBlur(np.where(is_known, filled, around).astype(np.float32), 3)
    return np.where(is_known, middle.astype(np.float64) + level, np.nan)


def _tops(surface: HeightMap, is_known: NDArray[np.bool_]) -> _Part:
    east, north = surface.grid.centers()
    rows, columns = np.nonzero(is_known)
    # Rows run south: the slope northwards is against them.
    slopes = [_slope(surface.heights, 1)[rows, columns], -_slope(surface.heights, 0)[rows, columns]]
    normals = np.column_stack([-slopes[0], -slopes[1], np.full(len(rows), surface.grid.cell)])
    lengths = np.linalg.norm(normals, axis=1)
    places = np.column_stack([east[columns], north[rows], surface.heights[rows, columns]])
    areas = surface.grid.cell**2 * lengths / surface.grid.cell
    return places, normals / lengths[:, None], areas, np.column_stack([rows, columns])


def _slope(heights: FloatArray, axis: int) -> FloatArray:
    """Rise (H,W) to the next cell along an axis: the smaller one of both sides, 0 where they
    differ in sign, so that a step beside a cell does not tilt it."""
    step = np.diff(heights, axis=axis)
    pad = [(0, 0), (0, 0)]
    pad[axis] = (1, 0)
    before = np.nan_to_num(np.pad(step, pad))
    pad[axis] = (0, 1)
    after = np.nan_to_num(np.pad(step, pad))
    smaller = np.where(np.abs(before) < np.abs(after), before, after)
    return np.where(before * after > 0, smaller, 0.0)


def _walls(surface: HeightMap, is_known: NDArray[np.bool_], axis: int) -> _Part:
    """The walls between each cell and the next one along an axis: 0 southwards, 1 eastwards."""
    cell, grid, heights = surface.grid.cell, surface.grid, surface.heights
    first = (slice(None, -1), slice(None)) if axis == 0 else (slice(None), slice(None, -1))
    second = (slice(1, None), slice(None)) if axis == 0 else (slice(None), slice(1, None))
    rise = np.where(is_known[first] & is_known[second], heights[second] - heights[first], 0.0)
    rows, columns = np.nonzero(np.abs(rise) > STEP_CELLS * cell)
    steps = rise[rows, columns]
    counts = np.maximum(1, np.rint(np.abs(steps) / cell).astype(np.int64))
    of = np.repeat(np.arange(len(rows)), counts)
    number = np.arange(len(of)) - np.repeat(np.cumsum(counts) - counts, counts)
    share = (number + 0.5) / np.maximum(counts[of], 1)
    z = heights[first][rows, columns][of] + steps[of] * share
    east, north = grid.north_west[0] + cell * (columns[of] + 0.5), grid.north_west[1] - cell * (rows[of] + 0.5)
    east, north = (east, north - cell / 2) if axis == 0 else (east + cell / 2, north)
    # The wall faces the lower cell: against the rise.
    sign = -np.sign(steps[of])
    normals = np.zeros((len(of), 3))
    normals[:, 0 if axis == 1 else 1] = sign if axis == 1 else -sign
    cells = np.column_stack([rows[of], columns[of]])
    cells[:, axis] += steps[of] < 0
    areas = cell * np.abs(steps[of]) / np.maximum(counts[of], 1)
    return np.column_stack([east, north, z]), normals, areas, cells
