"""Terrain without buildings and trees, contour lines, and both from a raster of heights.

Terrain: openings by ever larger squares of 2 r + 1 cells; a cell that one lowers by more than
    slope · growth of r + `STEP_GSD` · GSD
stands on the ground and is taken out; what is left open is filled from around (Pingel, Clarke and
McBride, ISPRS 77, 2013, after Zhang 2003). By OpenCV's morphology on the raster: the cloth of
`cloth-simulation-filter` 1.1.7 finds the same buildings, but writes to standard output, wants the
raster as points and takes a hundred times as long. Contours are contourpy's. Once per export.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from contourpy import contour_generator

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.survey.heights import FILLED, UNKNOWN, HeightMap, filled, push_pull

MAX_OBJECT = 30.0
"""Wider objects are taken for ground; metres, or the model's unit."""
SLOPE = 0.25
STEP_GSD = 5.0
NUM_RADII = 12
EDGE_CELLS = 2
"""So many cells around an object go with it: walls lean into them."""
MAX_LEVELS = 2000
MIN_LINE_CELLS = 8
"""Shorter closed lines are stones and noise."""


def terrain(surface: HeightMap, gsd: float) -> HeightMap:
    """The ground of a surface: objects narrower than `MAX_OBJECT` are taken out and filled, marked
    as filled. Raises BadInput where nothing is known."""
    is_known = surface.source != UNKNOWN
    if not is_known.any():
        raise BadInput("no cell of the surface is known, so there is no terrain: look at the surface model first.")
    level = float(np.nanmedian(surface.heights))
    whole = push_pull(np.where(is_known, surface.heights - level, 0).astype(np.float32), is_known)
    cell = surface.grid.cell
    objects = np.zeros(is_known.shape, bool)
    ground = whole
    radii = np.unique(np.rint(np.geomspace(1, max(2.0, MAX_OBJECT / 2 / cell), NUM_RADII)).astype(int))
    for before, radius in zip([0, *radii[:-1]], radii, strict=True):
        opened = _opened(ground, int(radius))
        # What this opening alone may lower: a slope over the growth of the square.
        objects |= ground - opened > SLOPE * (radius - before) * cell + STEP_GSD * gsd
        ground = opened
    objects = cv2.dilate(objects.astype(np.uint8), np.ones((2 * EDGE_CELLS + 1,) * 2, np.uint8)) > 0
    bare = replace(
        surface,
        heights=np.where(objects, np.nan, surface.heights),
        sigma=np.where(objects, np.nan, surface.sigma).astype(np.float32),
        source=np.where(objects, UNKNOWN, surface.source).astype(np.uint8),
    )
    # Whatever was filled before is as good a support as any: it is a mean of measured cells.
    support = replace(bare, source=np.where(bare.source == FILLED, 1, bare.source).astype(np.uint8))
    closed = filled(support, is_known, int(np.ceil(MAX_OBJECT / cell)))
    return replace(closed, source=np.where((bare.source == FILLED) & ~objects, FILLED, closed.source).astype(np.uint8))


def _opened(heights: np.ndarray, radius: int) -> np.ndarray:
    """Opening by a square of 2 r + 1 cells, which OpenCV does row by row and column by column."""
    kernel = cv2.getStructuringElement(cv2.MORPH_RECT, (2 * radius + 1, 2 * radius + 1))
    return cv2.morphologyEx(heights, cv2.MORPH_OPEN, kernel, borderType=cv2.BORDER_REPLICATE)


@dataclass(frozen=True, kw_only=True, eq=False)
class Contour:
    """A line (K,2) on the map at one height; closed lines end where they begin."""

    height: float
    line: FloatArray


def contours(surface: HeightMap, interval: float) -> list[Contour]:
    """Lines of equal height at multiples of `interval`, over known cells.

    Raises BadInput for an interval that is no positive number or gives more than 2,000 levels.
    """
    if not (np.isfinite(interval) and interval > 0):
        raise BadInput(f"an interval of {interval} came, expected a number above zero.")
    is_known = surface.source != UNKNOWN
    if not is_known.any():
        return []
    low, high = float(np.nanmin(surface.heights)), float(np.nanmax(surface.heights))
    first, last = int(np.ceil(low / interval)), int(np.floor(high / interval))
    if last - first >= MAX_LEVELS:
        raise BadInput(f"an interval of {interval} gives {last - first + 1} levels, more than {MAX_LEVELS}: choose a larger one.")
    east, north = surface.grid.centers()
    generator = contour_generator(x=east, y=north, z=np.ma.masked_invalid(np.where(is_known, surface.heights, np.nan)))
    lines = []
    for number in range(first, last + 1):
        for line in generator.lines(number * interval):
            points = np.asarray(line, np.float64)
            if np.linalg.norm(np.diff(points, axis=0), axis=1).sum() >= MIN_LINE_CELLS * surface.grid.cell:
                lines.append(Contour(height=number * interval, line=points))
    return lines
