"""A block 8 m high on level ground, and cameras that look at it, for the next flight."""

from __future__ import annotations

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.frames import Frame
from radiant_core.next_flight.facets import Facets, facets_of
from radiant_core.next_flight.sightings import Sights
from radiant_core.render.trajectories import Lens, cameras_looking_at
from radiant_core.survey.heights import MEASURED, HeightMap
from radiant_core.survey.map_grid import MapFrame, MapGrid

HEIGHT, SIDE = 8.0, 10.0
LENS = Lens(size_wh=(160, 120), field_of_view_deg=70.0)
FRAME = MapFrame(frame=Frame(kind="unscaled", origin_lat_lon_alt=np.zeros(3)), system=None)


def block_facets(cell: float = 1.0) -> Facets:
    """Ground of 40 × 40 m about the origin with a block of 10 × 10 m in its middle."""
    count = round(40 / cell)
    grid = MapGrid(north_west=np.array([-20.0, 20.0]), cell=cell, rows=count, columns=count, epsg=None)
    east, north = grid.centers()
    inside = (np.abs(east)[None] < SIDE / 2) & (np.abs(north)[:, None] < SIDE / 2)
    heights = np.where(inside, HEIGHT, 0.0)
    known = np.full(grid.shape, MEASURED, np.uint8)
    return facets_of(HeightMap(grid=grid, heights=heights, sigma=np.ones(grid.shape, np.float32), source=known))


def block_sights(cell: float = 1.0) -> Sights:
    """Looks at it, map and world being one."""
    return Sights(block_facets(cell), FRAME)


def looks(*places: tuple[float, float, float], at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Cameras:
    """Cameras at places that look at one; straight down where they are above it."""
    return cameras_looking_at(np.array(places), np.tile(at, (len(places), 1)), LENS)
