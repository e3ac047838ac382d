"""The surface of a model as facets: what three views of it agree on, open cells filled from around.
Once per map of what is known.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.next_flight.facets import Facets, facets_of
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from radiant_core.survey.heights import MEASURED, RENDERING, UNKNOWN, HeightMap, filled, height_map
from radiant_core.survey.map_grid import MapFrame, MapGrid
from radiant_core.survey.seen_ground import SeenGround
from radiant_core.survey.surface_points import points_of_model
from radiant_core.train.dense.fuse import DensePoints


@dataclass(frozen=True, kw_only=True)
class MapView:
    """On which map, by pictures of which size; keeps: which points (P,3) of the world count."""

    map_frame: MapFrame
    long_side_px: int
    keeps: Callable[[FloatArray], NDArray[np.bool_]] = lambda points: np.ones(len(points), bool)
    report: Callable[[int, int], None] = lambda num_done, total: None


def facets_of_model(splats: Splats, scene: SfmScene, ground: SeenGround, grid: MapGrid, view: MapView) -> Facets:
    """Facets of the ground that was seen, and of measured cells beside it; BadInput where no three
    views agree on any point."""

    def to_map(part: DensePoints) -> FloatArray:
        return view.map_frame.from_world(part.points[view.keeps(part.points)])

    parts = list(points_of_model(splats, scene, view.long_side_px, ground.reach, view.report, to_map))
    if not any(len(part) for part in parts):
        raise BadInput("no three views of the model agree on any point of the surface: train it further, or add photographs that overlap.")
    widest = float(np.median(scene.cameras.sizes_wh.max(axis=1)))
    gsd = ground.gsd * max(1.0, widest / view.long_side_px)
    inside = ground.mask(grid)
    surface = filled(height_map(np.concatenate(parts), grid, gsd, RENDERING), inside, reach_cells=max(grid.shape))
    usable = inside | (surface.source == MEASURED)
    heights, source = np.where(usable, surface.heights, np.nan), np.where(usable, surface.source, UNKNOWN).astype(np.uint8)
    return facets_of(HeightMap(grid=grid, heights=heights, sigma=surface.sigma, source=source))
