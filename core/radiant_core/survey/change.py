"""What changed between two dates, from heights and orthophotos on one grid. Once per pair.

    height:  |z₂ − z₁| > max(h, `HEIGHT_SIGMAS` √(σ₁² + σ₂²)),  where both were measured
    colour:  |g ⊙ blur c₂ − blur c₁| > max(`COLOR_LEVELS`, `COLOR_SPREADS` · usual difference)
The gain g of each channel is the median ratio of both dates in the neighbourhood: exposure and
light differ from date to date, and slowly over the ground. Each mask is opened, so that slivers
along walls and leaves fall away; connected cells are patches. Those below `min_area` are dropped,
and those of colour alone below twice of it: a badly seen car is one. Only cells that enough
photographs saw at both dates are compared (`DateRasters.is_known`). H, W cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.survey.heights import HeightMap
from radiant_core.survey.map_grid import MapGrid
from radiant_core.survey.orthophoto import OrthoTile

HEIGHT_SIGMAS, HEIGHT_GSD = 6.0, 5.0
COLOR_LEVELS, COLOR_SPREADS = 24.0, 3.5
BLUR_CELLS = 2.0
LIGHT_SHARE = 0.08
"""Light is compared over squares of this share of the raster's long side."""
OPEN_CELLS = 5
"""What is narrower is a wall or a leaf."""
CLOSE_CELLS = 7
VIEWS_SHARE = 0.6
COLOR_AREAS = 2.0
MIN_AREA_GSD2 = 600.0
"""Smaller patches are dropped: cars at GSD 10 cm, 10 m² at 13 cm."""

Kind = Literal["height", "colour", "both"]


@dataclass(frozen=True, kw_only=True, eq=False)
class DateRasters:
    """One date on the common grid: heights, image (H,W,3) uint8 and where it is known (H,W)."""

    heights: HeightMap
    image: NDArray[np.uint8]
    is_known: NDArray[np.bool_]

    @staticmethod
    def of(heights: HeightMap, tile: OrthoTile) -> DateRasters:
        """Heights and an orthophoto, known where at least `VIEWS_SHARE` of the usual number of
        photographs saw it: towards the rim of a flight models are made of few."""
        usual = float(np.median(tile.views[tile.is_known])) if tile.is_known.any() else 0.0
        return DateRasters(heights=heights, image=tile.image, is_known=tile.is_known & (tile.views >= VIEWS_SHARE * usual))


@dataclass(frozen=True, kw_only=True, eq=False)
class Patch:
    """A patch of change: outline (K,2) on the map; area; height_change, its median, and volume,
    their sum times area, both NaN where heights are unknown; color_change in levels of 255."""

    kind: Kind
    outline: FloatArray
    area: float
    height_change: float
    volume: float
    color_change: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Change:
    """by_height, by_color (H,W) masks; height_change (H,W), NaN where not comparable; color_change
    (H,W) levels; comparable (H,W); patches, the largest first."""

    grid: MapGrid
    by_height: NDArray[np.bool_]
    by_color: NDArray[np.bool_]
    height_change: FloatArray
    color_change: NDArray[np.float32]
    comparable: NDArray[np.bool_]
    patches: tuple[Patch, ...]


def find_change(older: DateRasters, newer: DateRasters, gsd: float, min_area: float | None = None) -> Change:
    """What changed from the older to the newer date, on one grid; `min_area` by default 600 GSD².

    Raises BadInput for rasters of unlike shapes and where no cell is known in both.
    """
    grid = older.heights.grid
    if not (older.image.shape == newer.image.shape == (*grid.shape, 3) and newer.heights.grid.shape == grid.shape):
        raise BadInput(f"rasters of {older.image.shape} and {newer.image.shape} came, expected two of one grid.")
    is_known = older.is_known & newer.is_known
    measured = (older.heights.source == 1) & (newer.heights.source == 1)
    if not (is_known | measured).any():
        raise BadInput("no cell is known at both dates: the two runs show different ground.")
    rise = np.where(measured, newer.heights.heights - older.heights.heights, np.nan)
    sigma = np.hypot(older.heights.sigma, newer.heights.sigma)
    with np.errstate(invalid="ignore"):
        higher = measured & (np.abs(rise) > np.maximum(HEIGHT_GSD * gsd, HEIGHT_SIGMAS * sigma))
    color = color_difference(older.image, newer.image, is_known)
    usual = float(np.median(color[is_known])) if is_known.any() else 0.0
    by_height, by_color = _cleaned(higher), _cleaned(is_known & (color > max(COLOR_LEVELS, COLOR_SPREADS * usual)))
    least = MIN_AREA_GSD2 * gsd**2 if min_area is None else min_area
    patches = _patches(by_height, by_color, rise, color, grid, least)
    return Change(
        grid=grid,
        by_height=by_height,
        by_color=by_color,
        height_change=rise,
        color_change=color,
        comparable=is_known & measured,
        patches=tuple(sorted(patches, key=lambda patch: -patch.area)),
    )


def color_difference(older: NDArray[np.uint8], newer: NDArray[np.uint8], mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Difference of two pictures (H,W,3) in levels (H,W), the largest of the channels, after the
    newer's light is made the older's; 0 outside the mask (H,W)."""
    old, new = (_blurred(image, mask) for image in (older, newer))
    gain = _gain(old, new, mask)
    return np.where(mask, np.abs(old - gain * new).max(axis=-1), 0).astype(np.float32)


def _blurred(image: NDArray[np.uint8], mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Means of the cells around that the mask has."""
    weight = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), BLUR_CELLS)
    sums = cv2.GaussianBlur(np.where(mask[..., None], image, 0).astype(np.float32), (0, 0), BLUR_CELLS)
    return (sums / np.maximum(weight, 1e-3)[..., None]).astype(np.float32)


def _gain(older: NDArray[np.float32], newer: NDArray[np.float32], mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Gain (H,W,3) that makes `newer` as bright as `older`: medians of the ratio over squares of
    the raster, smoothly joined; a house that changed is no median of 20 × 20 m."""
    height, width = mask.shape
    side = max(8, int(LIGHT_SHARE * max(height, width)))
    rows, columns = -(-height // side), -(-width // side)
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log(np.maximum(older, 1)) - np.log(np.maximum(newer, 1))
    whole = np.median(logs[mask], axis=0) if mask.any() else np.zeros(3)
    coarse = np.empty((rows, columns, 3), np.float32)
    for row in range(rows):
        for column in range(columns):
            # Twice as wide as the square: neighbours share half, so no step stands between them.
            part = (
                slice(max(0, int((row - 0.5) * side)), int((row + 1.5) * side)),
                slice(max(0, int((column - 0.5) * side)), int((column + 1.5) * side)),
            )
            chosen = logs[part][mask[part]]
            coarse[row, column] = np.median(chosen, axis=0) if len(chosen) > side * side / 4 else whole
    return np.exp(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_LINEAR)).astype(np.float32)


def _cleaned(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    opened = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((OPEN_CELLS,) * 2, np.uint8))
    return cv2.morphologyEx(opened, cv2.MORPH_CLOSE, np.ones((CLOSE_CELLS,) * 2, np.uint8)) > 0


def _patches(
    by_height: NDArray[np.bool_], by_color: NDArray[np.bool_], rise: FloatArray, color: NDArray[np.float32], grid: MapGrid, min_area: float
) -> list[Patch]:
    either = (by_height | by_color).astype(np.uint8)
    count, labels, figures, _ = cv2.connectedComponentsWithStats(either, connectivity=8)
    patches = []
    for label in range(1, count):
        left, top, width, height, cells = figures[label].tolist()
        part = (slice(top, top + height), slice(left, left + width))
        inside = labels[part] == label
        high, low = by_height[part][inside].mean(), by_color[part][inside].mean()
        kind: Kind = "both" if min(high, low) > 0.25 else ("height" if high >= low else "colour")
        if cells * grid.cell**2 < min_area * (COLOR_AREAS if kind == "colour" else 1.0):
            continue
        rises = rise[part][inside]
        finite = rises[np.isfinite(rises)]
        patches.append(
            Patch(
                kind=kind,
                outline=_outline(inside, grid, (top, left)),
                area=cells * grid.cell**2,
                height_change=float(np.median(finite)) if len(finite) else float("nan"),
                # Cells without a height count as the mean of those that have one.
                volume=float(finite.mean()) * cells * grid.cell**2 if len(finite) else float("nan"),
                color_change=float(np.median(color[part][inside])),
            )
        )
    return patches


def _outline(mask: NDArray[np.bool_], grid: MapGrid, corner: tuple[int, int]) -> FloatArray:
    """The outer border of a patch (K,2) on the map, simplified to half a cell."""
    lines, _ = cv2.findContours(np.pad(mask, 1).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    line = cv2.approxPolyDP(max(lines, key=len), 0.7, True)[:, 0].astype(np.float64) - 1
    cells = line + np.array([corner[1], corner[0]]) + 0.5
    if len(cells) < 3:
        low, high = cells.min(axis=0) - 0.5, cells.max(axis=0) + 0.5
        cells = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    return grid.north_west + grid.cell * cells * [1, -1]
