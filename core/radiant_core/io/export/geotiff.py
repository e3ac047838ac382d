"""A grid of heights as GeoTIFF (OGC 19-008): float32, north up, unknown −9999. Once per surface.

Cell (row, column) covers east₀ + column · cell … + cell and north₀ − row · cell … − cell. With an
EPSG code the grid is that projected system's; without one it stands in the model's own coordinates.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from radiant_core import __version__
from radiant_core.errors import BadInput
from radiant_core.io.run_store import write_atomic
from radiant_core.numerics import FloatArray

NO_DATA = -9999.0
_PIXEL_SCALE, _TIEPOINT, _GEO_KEYS, _GDAL_NODATA = 33550, 33922, 34735, 42113
_MODEL_TYPE, _RASTER_TYPE, _PROJECTED_CRS, _LINEAR_UNITS = 1024, 1025, 3072, 3076
_VERTICAL_CRS, _VERTICAL_UNITS = 4096, 4099
_PROJECTED, _USER_DEFINED, _PIXEL_IS_AREA, _METRE = 1, 32767, 1, 9001
_SHORT, _DOUBLE, _ASCII = 3, 12, 2


@dataclass(frozen=True, kw_only=True, eq=False)
class HeightGrid:
    """heights (H,W) float64, NaN where nothing was seen; north_west (2,) the outer corner; cell
    > 0; epsg None in the model's own frame."""

    heights: FloatArray
    north_west: FloatArray
    cell: float
    epsg: int | None
    vertical_epsg: int | None = None
    """What heights count from, where it has a code."""

    def __post_init__(self) -> None:
        if self.heights.ndim != 2 or 0 in self.heights.shape or np.isinf(self.heights).any():
            raise BadInput(f"heights of shape {self.heights.shape} came, expected (H, W) of finite numbers or NaN.")
        if not (np.isfinite(self.cell) and self.cell > 0 and np.isfinite(self.north_west).all()):
            raise BadInput(f"a grid with cells of {self.cell} from {self.north_west} came, expected finite numbers and cells above zero.")

    @property
    def known(self) -> float:
        """Share of the cells that have a height."""
        return float(np.isfinite(self.heights).mean())

    def at(self, places: FloatArray) -> FloatArray:
        """Heights (P,) of the cells that places (P,2) fall into; NaN outside and where unknown."""
        columns = np.floor((places[:, 0] - self.north_west[0]) / self.cell)
        rows = np.floor((self.north_west[1] - places[:, 1]) / self.cell)
        inside = (columns >= 0) & (rows >= 0) & (columns < self.heights.shape[1]) & (rows < self.heights.shape[0])
        found = np.full(len(places), np.nan)
        found[inside] = self.heights[rows[inside].astype(np.int64), columns[inside].astype(np.int64)]
        return found


def save_geotiff(path: Path, grid: HeightGrid) -> None:
    """Write the grid to `path`, atomically, as float32 (0.03 mm at 500 m); BadInput if it fails."""
    import tifffile

    values = np.where(np.isfinite(grid.heights), grid.heights, NO_DATA).astype(np.float32)
    content = io.BytesIO()
    tifffile.imwrite(
        content,
        values,
        photometric="minisblack",
        compression="zlib",
        rowsperstrip=64,
        metadata=None,
        software=f"radiant {__version__}",
        extratags=_geo_tags(grid),
    )
    write_atomic(path, content.getvalue())


def _geo_tags(grid: HeightGrid) -> list[tuple[int, int, int, object, bool]]:
    keys = [(_MODEL_TYPE, _PROJECTED if grid.epsg else _USER_DEFINED), (_RASTER_TYPE, _PIXEL_IS_AREA)]
    if grid.epsg:
        keys += [(_PROJECTED_CRS, grid.epsg), (_LINEAR_UNITS, _METRE)]
    if grid.epsg and grid.vertical_epsg:
        keys += [(_VERTICAL_CRS, grid.vertical_epsg), (_VERTICAL_UNITS, _METRE)]
    # 1.1 of the standard: its vertical keys are EPSG's codes.
    directory = [1, 1, 1 if grid.vertical_epsg else 0, len(keys), *(number for key, value in keys for number in (key, 0, 1, value))]
    tiepoint = (0.0, 0.0, 0.0, float(grid.north_west[0]), float(grid.north_west[1]), 0.0)
    return [
        (_PIXEL_SCALE, _DOUBLE, 3, (grid.cell, grid.cell, 0.0), True),
        (_TIEPOINT, _DOUBLE, 6, tiepoint, True),
        (_GEO_KEYS, _SHORT, len(directory), tuple(directory), True),
        (_GDAL_NODATA, _ASCII, 0, f"{NO_DATA:.0f}", True),
    ]
