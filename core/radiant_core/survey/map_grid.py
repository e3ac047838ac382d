"""`MapFrame` and `MapGrid`: which map a model lies on, and the cells of a raster there.

    cell (r, c) covers  east₀ + c · cell … + cell,   north₀ − r · cell … − cell
With GPS the map is a UTM zone, or the system that is asked for, and heights are those of the
photographs' GPS; without, both are the model's own. Once per raster.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from radiant_core.errors import BadInput
from radiant_core.frames import Frame, Sim3, enu_from_geodetic, geodetic_from_enu
from radiant_core.georef.crs import Crs, parse_crs
from radiant_core.map_projection import utm_epsg
from radiant_core.numerics import FloatArray, check_array

MAX_CELLS = 400_000_000
"""Larger rasters are refused: a slip in the size of a cell would fill the disk."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MapFrame:
    """The map of a world frame: its system, None where the world is the map."""

    frame: Frame
    system: Crs | None
    map_from_world: Sim3 | None = None
    """Where the scene was given in coordinates of this map, or in metres that no map has: what
    leads back to them, exactly."""

    @property
    def epsg(self) -> int | None:
        """Code of the map, None where the world is the map."""
        return None if self.system is None else self.system.horizontal_epsg

    @property
    def vertical_epsg(self) -> int | None:
        """Code of the datum of its heights, None where they count from none."""
        return None if self.system is None else self.system.vertical_epsg

    def from_world(self, points: ArrayLike) -> FloatArray:
        """East, north, height (P,3) on the map of points (P,3) of the world."""
        points = check_array("points", points, (None, 3))
        if self.map_from_world is not None and len(points):
            return self.map_from_world.apply(points)
        if self.system is None or not len(points):
            return points.copy()
        return self.system.from_geodetic(geodetic_from_enu(points, self.frame.origin_lat_lon_alt))

    def to_world(self, places: ArrayLike) -> FloatArray:
        """Points (P,3) of the world of east, north, height (P,3) on the map."""
        places = check_array("places", places, (None, 3))
        if self.map_from_world is not None and len(places):
            return self.map_from_world.inverse().apply(places)
        if self.system is None or not len(places):
            return places.copy()
        return enu_from_geodetic(self.system.to_geodetic(places), self.frame.origin_lat_lon_alt)

    @property
    def crs(self) -> str:
        """The map in words."""
        owner = "model" if self.map_from_world is None else "alignment"
        return f"none, the {owner}'s own coordinates" if self.system is None else self.system.title


def map_frame_of(frame: Frame, system: Crs | None = None, map_from_world: Sim3 | None = None) -> MapFrame:
    """The map of a frame: `system`, by default the UTM zone of its origin; `map_from_world`, where
    the scene was given in coordinates of that map. BadInput for one where the frame has no place
    on the globe."""
    if frame.kind != "metric":
        if system is not None:
            raise BadInput(
                f"{system.title} was asked for, but the scene has no place on the globe: leave it out, or give photographs with GPS."
            )
        return MapFrame(frame=frame, system=None, map_from_world=map_from_world)
    lat, lon, _ = frame.origin_lat_lon_alt.tolist()
    if system is None:
        return MapFrame(frame=frame, system=parse_crs(f"EPSG:{utm_epsg(lat, lon)}"))
    return MapFrame(frame=frame, system=system.at(lat, lon), map_from_world=map_from_world)


@dataclass(frozen=True, kw_only=True, eq=False)
class MapGrid:
    """rows × columns cells of `cell` > 0 south and east of the corner north_west (2,) of a map."""

    north_west: FloatArray
    cell: float
    rows: int
    columns: int
    epsg: int | None
    vertical_epsg: int | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "north_west", check_array("north_west", self.north_west, (2,)))
        if not (np.isfinite(self.cell) and self.cell > 0):
            raise BadInput(f"a grid with cells of {self.cell} came, expected a number above zero.")
        if self.rows < 1 or self.columns < 1:
            raise BadInput(f"a grid of {self.columns} × {self.rows} cells came, expected at least one.")
        if self.rows * self.columns > MAX_CELLS:
            raise BadInput(
                f"cells of {self.cell:.3g} give a grid of {self.columns} × {self.rows}, more than {MAX_CELLS:,}: choose larger cells."
            )

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.rows, self.columns

    def cells_of(self, places: FloatArray) -> FloatArray:
        """Rows and columns (P,2), not rounded, of places (P,2): the middle of cell (0, 0) is (0.5,
        0.5)."""
        return np.column_stack([self.north_west[1] - places[:, 1], places[:, 0] - self.north_west[0]]) / self.cell

    def centers(self) -> tuple[FloatArray, FloatArray]:
        """East (columns,) and north (rows,) of the cells' middles."""
        east = self.north_west[0] + (np.arange(self.columns) + 0.5) * self.cell
        return east, self.north_west[1] - (np.arange(self.rows) + 0.5) * self.cell


def grid_over(low: FloatArray, high: FloatArray, cell: float, map_frame: MapFrame) -> MapGrid:
    """The grid of whole multiples of `cell` that covers a box of the map, corners (2,)."""
    if not (np.isfinite(cell) and cell > 0):
        raise BadInput(f"cells of {cell} came, expected a number above zero.")
    first, last = np.floor(low[:2] / cell), np.ceil(high[:2] / cell)
    # Python's integers: a slip by a million overflows no array.
    columns, rows = (max(1, int(last[axis] - first[axis])) for axis in (0, 1))
    return MapGrid(
        north_west=np.array([first[0], last[1]]) * cell,
        cell=cell,
        rows=rows,
        columns=columns,
        epsg=map_frame.epsg,
        vertical_epsg=map_frame.vertical_epsg,
    )
