"""Views that a drone may take: where from, where to, and which of them are safe. Once per proposal.

Aims lie on a square grid over the known ground; each is looked at from `DISTANCES` times the usual
distance at every pitch, from `NUM_HEADINGS` sides unless straight down. A place is safe where

    z ≥ safe + highest surface within `safe` around it          on the map: a vertical cylinder
    z − take-off ≥ lowest,   z − ground below ≤ highest,   outside of every no-fly polygon

so that it is at least `safe` away from every facet. Where the surface within `safe` is not known
the highest known height counts. C candidates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.next_flight.facets import Facets
from radiant_core.numerics import FloatArray
from radiant_core.plan.heights import USUAL_LIMIT_M
from radiant_core.render.trajectories import Lens, cameras_looking_at
from radiant_core.survey.map_grid import MapFrame

PITCHES_DEG = (-90.0, -60.0, -40.0)
DISTANCES = (1.0, 0.6)
NUM_HEADINGS = 8
AIMS = 32
"""About so many aims, unless the cells are fewer."""
TAKE_OFF_SHARE = 0.2
"""Take-off is as high as this share of the ground's cells, unless it is given."""


@dataclass(frozen=True, kw_only=True)
class FlightRules:
    """What a flight must keep to, in the map's unit; BadInput for what no flight can."""

    safe: float
    """Distance to every surface."""
    take_off: float
    """Height of take-off on the map."""
    lowest: float = 0.0
    """Least height above take-off."""
    highest: float = USUAL_LIMIT_M
    """Largest height above the ground below, and above take-off."""
    no_fly: tuple[shapely.Polygon, ...] = ()
    """Land on the map that is not flown over."""

    def __post_init__(self) -> None:
        if not (np.isfinite(self.safe) and self.safe > 0):
            raise BadInput(f"a safe distance of {self.safe} came, expected a number above zero.")
        if not self.lowest < self.highest:
            raise BadInput(f"flights between {self.lowest:g} and {self.highest:g} above take-off were asked for: raise the upper limit.")


@dataclass(frozen=True, kw_only=True, eq=False)
class Air:
    """Where a drone may be over facets: floor (H,W), the lowest safe height at each cell, and
    is_known (H,W), whether all of the surface within `safe` of it is."""

    facets: Facets
    rules: FlightRules
    floor: FloatArray
    is_known: NDArray[np.bool_]
    land: shapely.Geometry = field(default_factory=shapely.Polygon)
    """All that is not flown over."""

    def floors_at(self, places: FloatArray) -> FloatArray:
        """Lowest safe heights (P,) at places (P,2 or 3), above the raster's cells and beyond."""
        inside, rows, columns = self._cells(places)
        return np.where(inside, self.floor[rows, columns], self.facets.highest + self.rules.safe)

    def knows(self, places: FloatArray) -> NDArray[np.bool_]:
        """Over which places (P,2 or 3) the floor is that of known surface alone."""
        inside, rows, columns = self._cells(places)
        return inside & self.is_known[rows, columns]

    def _cells(self, places: FloatArray) -> tuple[NDArray[np.bool_], NDArray[np.int64], NDArray[np.int64]]:
        """Which places are on the raster, and rows and columns (P,), 0 for others."""
        cells = np.floor(self.facets.surface.grid.cells_of(places[:, :2])).astype(np.int64)
        inside = np.asarray(((cells >= 0) & (cells < self.floor.shape)).all(axis=1))
        rows, columns = np.where(inside[:, None], cells, 0).T
        return inside, rows, columns

    def is_safe(self, places: FloatArray) -> NDArray[np.bool_]:
        """Which places (P,3) may be flown to."""
        above = places[:, 2] - self.rules.take_off
        low = (places[:, 2] >= self.floors_at(places)) & (above >= self.rules.lowest)
        ground, _ = self.facets.surface.at(places[:, :2])
        over_ground = places[:, 2] - np.where(np.isfinite(ground), ground, self.rules.take_off)
        return low & (np.maximum(above, over_ground) <= self.rules.highest) & ~shapely.intersects_xy(self.land, places[:, :2])


def air_over(facets: Facets, rules: FlightRules) -> Air:
    """Where a drone may be."""
    surface = facets.surface
    tall = np.where(np.isfinite(surface.heights), surface.heights, facets.highest)
    # A cell more: what is within `safe` of a cell's middle is not all that is of its corners.
    reach = int(np.ceil(rules.safe / surface.grid.cell)) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    level = float(tall.min())
    padded = np.pad(tall - level, reach, constant_values=facets.highest - level).astype(np.float32)
    dilated = cv2.dilate(padded, disc)[reach:-reach, reach:-reach].astype(np.float64)
    # float32 rounds: a floor may be higher, never lower.
    floor = dilated * (1 + 1e-6) + level + rules.safe
    is_known = cv2.erode(np.isfinite(surface.heights).astype(np.uint8), disc, borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0
    return Air(facets=facets, rules=rules, floor=floor, is_known=is_known, land=shapely.union_all(list(rules.no_fly)))


def usual_take_off(facets: Facets) -> float:
    """The height of take-off where none is given: that of low ground."""
    return float(np.quantile(facets.places[~facets.is_wall, 2], TAKE_OFF_SHARE))


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidates:
    """places (C,3) and aims (C,3) on the map, heading_pitch_deg (C,2): clockwise from north, −90
    down; cameras in the world."""

    places: FloatArray
    aims: FloatArray
    heading_pitch_deg: FloatArray
    cameras: Cameras

    def __len__(self) -> int:
        return len(self.places)


def candidate_views(air: Air, map_frame: MapFrame, lens: Lens, distance: float, pitches_deg: Sequence[float] = PITCHES_DEG) -> Candidates:
    """All safe views; `distance`: how far from the ground photographs usually are. BadInput where
    none is safe."""
    aims = _aims(air.facets)
    rows = [
        (share, pitch, heading)
        for share in DISTANCES
        for pitch in pitches_deg
        for heading in ([0.0] if pitch <= -89 else np.arange(NUM_HEADINGS) * 360 / NUM_HEADINGS)
    ]
    shares, pitches, headings = np.array(rows, np.float64).T
    turn, dip = np.radians(headings), np.radians(pitches)
    ahead = np.column_stack([np.sin(turn) * np.cos(dip), np.cos(turn) * np.cos(dip), np.sin(dip)])
    away = distance * shares[:, None] * ahead
    places = (aims[:, None] - away[None]).reshape(-1, 3)
    targets = np.repeat(aims, len(rows), axis=0)
    angles = np.tile(np.column_stack([headings, pitches]), (len(aims), 1))
    is_safe = air.is_safe(places)
    if not is_safe.any():
        raise BadInput(
            f"none of {len(places)} views is at least {air.rules.safe:g} from the surface, {air.rules.lowest:g} to {air.rules.highest:g} "
            "above take-off and outside of the no-fly land: lower the safe distance, or raise the upper limit."
        )
    places, targets, angles = places[is_safe], targets[is_safe], angles[is_safe]
    cameras = cameras_looking_at(map_frame.to_world(places), map_frame.to_world(targets), lens)
    return Candidates(places=places, aims=targets, heading_pitch_deg=angles, cameras=cameras)


def _aims(facets: Facets) -> FloatArray:
    """Places (A,3) of tops on a square grid, about `AIMS` of them."""
    tops = facets.places[~facets.is_wall]
    spacing = max(1, round(np.sqrt(len(tops) / AIMS)))
    cells = facets.cells[~facets.is_wall]
    chosen = ((cells % spacing) == spacing // 2).all(axis=1)
    return tops[chosen] if chosen.any() else tops[:1]
