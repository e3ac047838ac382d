"""Where things lie: streets, blocks and the height of the ground, as functions of the position
alone.

    (u, v) = warp(R (x, y))          town coordinates, streets the lines u = k·52 m and v = l·40 m
    z = height_m(x, y)               rolling ground + mounds in parks + a terraced quarry + hills

The same functions place the buildings (once per scene) and paint the ground (once per ray), so both
always agree.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from scenegen.noise import Floats, hash_unit, value_noise

BLOCK_U_M, BLOCK_V_M = 52.0, 40.0
ROAD_HALF_M, PAVEMENT_HALF_M = 3.3, 5.1
LOTS_U, LOTS_V = 3, 2
TOWN_MARGIN_M = 70.0
QUARRY_DEPTH_M, MOUND_M = 6.5, 2.6

_TURN_RAD = np.deg2rad(14.0)
_BEND_U_M, _BEND_V_M, _PERIOD_U_M, _PERIOD_V_M = 2.6, 2.0, 37.0, 53.0


class Block(IntEnum):
    """What stands between four streets."""

    HOUSES = 0
    FLATS = 1
    PARKING = 2
    PARK = 3
    QUARRY = 4
    OUTSIDE = 5


@dataclass(frozen=True, kw_only=True)
class Layout:
    """The plan of the town around the area (width, height) that is flown over."""

    extent_m: tuple[float, float]
    seed: int
    scenery: str = "town"

    def salt(self, which: int) -> int:
        """The salt of this seed's noise number `which` (0 to 63)."""
        return self.seed * 64 + which

    def town_from_world(self, x: NDArray, y: NDArray) -> tuple[NDArray, NDArray]:
        """Town coordinates u, v in metres of world positions x, y: turned, then gently bent."""
        c, s = np.float32(np.cos(_TURN_RAD)), np.float32(np.sin(_TURN_RAD))
        across, along = c * x + s * y, c * y - s * x
        u = across + _BEND_U_M * np.sin(along / _PERIOD_U_M)
        v = along + _BEND_V_M * np.sin(u / _PERIOD_V_M)
        return u, v

    def world_from_town(self, u: float, v: float) -> tuple[float, float]:
        """World position of town coordinates u, v: the exact inverse of `town_from_world`."""
        along = v - _BEND_V_M * np.sin(u / _PERIOD_V_M)
        across = u - _BEND_U_M * np.sin(along / _PERIOD_U_M)
        c, s = np.cos(_TURN_RAD), np.sin(_TURN_RAD)
        return float(c * across - s * along), float(s * across + c * along)

    def heading_rad(self, u: float, v: float) -> float:
        """Angle in the world of the street direction +u at u, v."""
        x0, y0 = self.world_from_town(u - 0.5, v)
        x1, y1 = self.world_from_town(u + 0.5, v)
        return float(np.arctan2(y1 - y0, x1 - x0))

    def block_kind(self, i: NDArray[np.integer], j: NDArray[np.integer]) -> NDArray[np.int8]:
        """The `Block` of each block with whole numbers i, j (N,)."""
        lot = hash_unit(i, j, self.salt(11))
        kind = np.searchsorted(np.array([0.60, 0.74, 0.86]), lot, side="right").astype(np.int8)
        quarry_i, quarry_j = self.quarry_block
        kind[(i == quarry_i) & (j == quarry_j)] = Block.QUARRY
        kind[~self._is_town(i, j)] = Block.OUTSIDE
        return kind

    @property
    def quarry_block(self) -> tuple[int, int]:
        """Whole numbers of the block with the quarry: the one south-east of the middle."""
        u, v = self.town_from_world(np.array([0.3 * self.extent_m[0]]), np.array([-0.3 * self.extent_m[1]]))
        return int(np.floor(u[0] / BLOCK_U_M)), int(np.floor(v[0] / BLOCK_V_M))

    def blocks(self) -> list[tuple[int, int, Block]]:
        """All blocks of the town with their kind."""
        reach_u, reach_v = self._reach_blocks()
        i, j = (axis.ravel() for axis in np.mgrid[-reach_u : reach_u + 1, -reach_v : reach_v + 1])
        kinds = self.block_kind(i, j)
        return [(int(a), int(b), Block(k)) for a, b, k in zip(i, j, kinds, strict=True) if k != Block.OUTSIDE]

    def height_m(self, x: NDArray, y: NDArray) -> Floats:
        """Height of the ground at x, y (N,)."""
        if self.scenery == "fields":
            return np.zeros(np.shape(x), np.float32)
        x, y = x.astype(np.float32), y.astype(np.float32)
        z = 4.0 * (value_noise(x, y, 85.0, self.salt(1)) - 0.5) + 1.4 * (value_noise(x, y, 27.0, self.salt(2)) - 0.5)
        u, v = self.town_from_world(x, y)
        i, j = np.floor(u / BLOCK_U_M).astype(np.int32), np.floor(v / BLOCK_V_M).astype(np.int32)
        kind = self.block_kind(i, j)
        a, b = u - (i + 0.5) * BLOCK_U_M, v - (j + 0.5) * BLOCK_V_M
        off_road = np.clip(street_distance_m(a, b) - PAVEMENT_HALF_M, 0.0, 2.0) / 2.0
        z += off_road * 0.45 * (value_noise(x, y, 3.7, self.salt(3)) - 0.5)
        z += np.where(kind == Block.PARK, MOUND_M * np.exp(-2.5 * ((a / 20.0) ** 2 + (b / 14.0) ** 2)), 0.0)
        z -= np.where(kind == Block.QUARRY, QUARRY_DEPTH_M * _terraces(np.hypot(a / 19.5, b / 13.5)), 0.0)
        distance = np.hypot(x, y)
        far = np.clip((distance - 0.5 * max(self.extent_m) - 150.0) / 1500.0, 0.0, 1.0)
        z += far * 130.0 * value_noise(x, y, 610.0, self.salt(4))
        return z.astype(np.float32)

    def _reach_blocks(self) -> tuple[int, int]:
        reach_m = np.hypot(*self.extent_m) / 2.0 + TOWN_MARGIN_M
        return int(np.ceil(reach_m / BLOCK_U_M)) + 1, int(np.ceil(reach_m / BLOCK_V_M)) + 1

    def _is_town(self, i: NDArray[np.integer], j: NDArray[np.integer]) -> NDArray[np.bool_]:
        """Whether the middle of block i, j lies within the margin around the area."""
        if self.scenery == "fields":
            return np.zeros(np.shape(i), bool)
        u, v = (i + 0.5) * BLOCK_U_M, (j + 0.5) * BLOCK_V_M
        c, s = np.cos(_TURN_RAD), np.sin(_TURN_RAD)
        x, y = c * u - s * v, s * u + c * v
        return (np.abs(x) < self.extent_m[0] / 2.0 + TOWN_MARGIN_M) & (np.abs(y) < self.extent_m[1] / 2.0 + TOWN_MARGIN_M)


def street_distance_m(a: NDArray, b: NDArray) -> NDArray:
    """Distance to the nearest street's middle line from block coordinates a, b (N,), measured from
    the block's middle."""
    return np.minimum(BLOCK_U_M / 2.0 - np.abs(a), BLOCK_V_M / 2.0 - np.abs(b))


def lot_center_m(lot_u: int, lot_v: int) -> tuple[float, float]:
    """Block coordinates of the middle of a lot."""
    a = (lot_u + 0.5) / LOTS_U - 0.5
    b = (lot_v + 0.5) / LOTS_V - 0.5
    return a * (BLOCK_U_M - 2.0 * PAVEMENT_HALF_M), b * (BLOCK_V_M - 2.0 * PAVEMENT_HALF_M)


def _terraces(radius: NDArray) -> NDArray:
    """Depth in [0, 1] of a pit with three benches: 0 outside radius 1, 1 in the middle."""
    level = np.clip((1.0 - radius) / 0.55, 0.0, 1.0) * 3.0
    bench = np.floor(level)
    return np.clip(bench + np.clip((level - bench - 0.5) / 0.5, 0.0, 1.0), 0.0, 3.0) / 3.0
