"""What is known of a surface as layers of a map and as shapes. Once per map. K facets, H × W cells.

Cells have the figures of their tops; a wall stands in the cell that it faces, where its area, and
how much of that no photograph shows, are bands of their own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from radiant_core.geometry.support import Support
from radiant_core.next_flight.facets import Facets
from radiant_core.next_flight.sightings import Knowledge
from radiant_core.numerics import FloatArray
from radiant_core.splats import Splats
from radiant_core.survey.geojson import coordinates_of
from radiant_core.survey.map_grid import MapFrame

BANDS = (
    "photographs",
    "largest parallax in degrees",
    "ground sampling distance",
    "share of the Gaussians there that photographs constrain",
    "PSNR in dB predicted for views like the photographs",
    "PSNR that nine of ten cells exceed in dB",
    "1 known, 2 weak, 3 hole",
    "area of walls",
    "area of walls that no photograph shows",
)
WELL_KNOWN, WEAK, HOLE = 1, 2, 3
CLASSES = (6,)


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownMap:
    """Facets, what is known of each, and its error in dB (K,) as predicted and as nine of ten
    exceed, NaN where it is not; support (H,W), NaN where the model has nothing."""

    facets: Facets
    knowledge: Knowledge
    support: FloatArray
    error_db: FloatArray
    margin_db: float | None

    @property
    def kinds(self) -> NDArray[np.int64]:
        """Known, weak or hole (K,)."""
        return np.where(self.knowledge.unseen, HOLE, np.where(self.knowledge.weak, WEAK, WELL_KNOWN))

    def area_of(self, kind: int, *, walls: bool) -> float:
        """Area of the walls, or of the tops, of one kind."""
        return float(self.facets.areas[(self.kinds == kind) & (self.facets.is_wall == walls)].sum())

    def bands(self, no_data: float) -> NDArray[np.float32]:
        """The layers (H,W,9) in the order of `BANDS`, `no_data` where nothing is known."""
        shape = self.facets.surface.grid.shape
        tops = ~self.facets.is_wall
        rows, columns = self.facets.cells[tops].T
        low_db = self.error_db - (np.nan if self.margin_db is None else self.margin_db)
        per_facet = (self.knowledge.num_views, self.knowledge.parallax_deg, self.knowledge.gsd, None, self.error_db, low_db, self.kinds)
        layers = np.full((*shape, len(BANDS)), np.nan)
        for band, values in enumerate(per_facet):
            if values is not None:
                layers[rows, columns, band] = np.where(np.isfinite(values[tops]), values[tops], np.nan)
        layers[..., 3] = self.support
        walls = self.facets.is_wall
        for band, chosen in ((7, walls), (8, walls & self.knowledge.unseen)):
            area = np.zeros(shape)
            np.add.at(area, tuple(self.facets.cells[chosen].T), self.facets.areas[chosen])
            layers[rows, columns, band] = area[rows, columns]
        # A cell that no facet stands on is unknown in every band.
        layers[self.facets.surface.source == 0] = np.nan
        return np.where(np.isfinite(layers), layers, no_data).astype(np.float32)


def support_raster(facets: Facets, map_frame: MapFrame, splats: Splats, support: Support) -> FloatArray:
    """Share (H,W) of the Gaussians in each cell that photographs constrain, each by the pixels that
    it makes in them; NaN where there is none."""
    grid = facets.surface.grid
    cells = np.floor(grid.cells_of(map_frame.from_world(splats.means.astype(np.float64))[:, :2])).astype(np.int64)
    inside = ((cells >= 0) & (cells < grid.shape)).all(axis=1)
    total, fixed = np.zeros(grid.shape), np.zeros(grid.shape)
    np.add.at(total, tuple(cells[inside].T), support.shown_px[inside])
    is_fixed = inside & support.constrained()
    np.add.at(fixed, tuple(cells[is_fixed].T), support.shown_px[is_fixed])
    return np.where(total > 0, fixed / np.maximum(total, 1e-300), np.nan)


def weak_features(known_map: KnownMap, map_frame: MapFrame) -> list[dict[str, Any]]:
    """Holes and weak ground as polygons, holes in walls as lines with their heights; GeoJSON's
    features, the largest first."""
    features: list[dict[str, Any]] = []
    for kind, name in ((HOLE, "hole"), (WEAK, "weak")):
        features += _ground_features(known_map, map_frame, kind, name)
        features += _wall_features(known_map, map_frame, kind, name)
    return sorted(features, key=lambda feature: -feature["properties"]["area"])


def _ground_features(known_map: KnownMap, map_frame: MapFrame, kind: int, name: str) -> list[dict[str, Any]]:
    facets, half = known_map.facets, known_map.facets.surface.grid.cell / 2
    chosen = (known_map.kinds == kind) & ~facets.is_wall
    x, y = facets.places[chosen, 0], facets.places[chosen, 1]
    land = shapely.union_all(shapely.box(x - half, y - half, x + half, y + half), grid_size=half / 1e4)
    parts = [part for part in shapely.get_parts(land) if isinstance(part, shapely.Polygon) and not part.is_empty]
    features = []
    for part in parts:
        rings = [np.array(ring.coords) for ring in (shapely.orient_polygons(part).exterior, *shapely.orient_polygons(part).interiors)]
        geometry = {"type": "Polygon", "coordinates": [coordinates_of(map_frame, ring) for ring in rings]}
        features.append(_feature(geometry, {"kind": name, "on": "ground or roof", "area": round(part.area, 3)}))
    return features


def _wall_features(known_map: KnownMap, map_frame: MapFrame, kind: int, name: str) -> list[dict[str, Any]]:
    """The walls that stand on edges of cells that touch, as one feature each."""
    facets, half = known_map.facets, known_map.facets.surface.grid.cell / 2
    rows = np.flatnonzero((known_map.kinds == kind) & facets.is_wall)
    if not len(rows):
        return []
    # Along the wall: across its normal.
    along = np.column_stack([-facets.normals[rows, 1], facets.normals[rows, 0]]) * half
    ends = np.stack([facets.places[rows, :2] - along, facets.places[rows, :2] + along])
    corners, corner = np.unique(np.rint(ends.reshape(-1, 2) / half).astype(np.int64), axis=0, return_inverse=True)
    first, second = corner.reshape(2, -1)
    graph = coo_array((np.ones(len(rows)), (first, second)), shape=(len(corners), len(corners)))
    owner = connected_components(graph, directed=False)[1][first]
    features = []
    for number in np.unique(owner):
        members = np.flatnonzero(owner == number)
        edges = np.unique(np.sort(np.column_stack([first[members], second[members]]), axis=1), axis=0)
        lines = shapely.line_merge(shapely.MultiLineString(list(corners[edges] * half)))
        parts = [coordinates_of(map_frame, np.array(part.coords)) for part in shapely.get_parts(lines)]
        heights = facets.places[rows[members], 2]
        about = {"kind": name, "on": "wall", "area": round(float(facets.areas[rows[members]].sum()), 3)}
        span = {"lowest": round(float(heights.min() - half), 3), "highest": round(float(heights.max() + half), 3)}
        features.append(_feature({"type": "MultiLineString", "coordinates": parts}, {**about, **span}))
    return features


def _feature(geometry: Mapping[str, Any], properties: Mapping[str, Any]) -> dict[str, Any]:
    return {"type": "Feature", "geometry": dict(geometry), "properties": dict(properties)}
