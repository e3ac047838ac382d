"""Where a look from somewhere meets a surface. Once per click.

A ray is followed in steps of half a cell until it lies below the height of its cell, and the
crossing is found by halving the step. Haze before a house does not stop it, as it does a rendered
depth. Where the ray arrives far below the height of the cell that it enters, it met a wall.
"""

from __future__ import annotations

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array
from radiant_core.survey.heights import HeightMap

NUM_HALVINGS = 24
MAX_STEPS = 200_000


def first_hit(surface: HeightMap, eye: FloatArray, through: FloatArray) -> FloatArray:
    """The place (3,) where the ray from `eye` (3,) through a place (3,) of the map first meets the
    known surface; NaN where it does not, or begins below it. BadInput for a ray without a
    direction."""
    eye, through = check_array("eye", eye, (3,)), check_array("through", through, (3,))
    length = float(np.linalg.norm(through - eye))
    if not length > 0:
        raise BadInput("a look from a place to itself has no direction: click anew.")
    along = (through - eye) / length
    heights = surface.heights[np.isfinite(surface.heights)]
    if not len(heights):
        return np.full(3, np.nan)
    near, far = _span(surface, eye, along, (float(heights.min()), float(heights.max())))
    if not 0 < far - near < MAX_STEPS * surface.grid.cell:
        return np.full(3, np.nan)
    count = int(np.ceil((far - near) / (surface.grid.cell / 2))) + 1
    at = np.linspace(near, far, count + 1)
    above = _above(surface, eye + at[:, None] * along)
    below = np.flatnonzero(above < 0)
    if not len(below) or below[0] == 0:
        return np.full(3, np.nan)
    low, high = at[below[0] - 1], at[below[0]]
    for _ in range(NUM_HALVINGS):
        middle = (low + high) / 2
        if _above(surface, (eye + middle * along)[None])[0] < 0:
            high = middle
        else:
            low = middle
    return eye + high * along


def _span(surface: HeightMap, eye: FloatArray, along: FloatArray, heights: tuple[float, float]) -> tuple[float, float]:
    """The part of the ray, lengths from the eye, in the box of the raster and its heights."""
    grid, reach = surface.grid, surface.grid.cell
    west, north = grid.north_west.tolist()
    low = np.array([west, north - grid.rows * grid.cell, heights[0] - reach])
    high = np.array([west + grid.columns * grid.cell, north, heights[1] + reach])
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack([(low - eye) / along, (high - eye) / along])
    # Along an axis without motion the ray is inside all the time, or never.
    inside = (eye >= low) & (eye <= high)
    ends = np.where(along == 0, np.where(inside, [[-np.inf], [np.inf]], [[np.inf], [-np.inf]]), ends)
    first = np.where(along == 0, ends[0], ends.min(axis=0)).max()
    return max(0.0, float(first)), float(np.where(along == 0, ends[1], ends.max(axis=0)).min())


def _above(surface: HeightMap, places: FloatArray) -> FloatArray:
    """How far places (P,3) are above the surface (P,); infinite where it is not known."""
    heights, _ = surface.at(places[:, :2])
    return np.where(np.isfinite(heights), places[:, 2] - heights, np.inf)
