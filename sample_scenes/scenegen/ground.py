"""The colour of the ground: lawns, gardens, car parks, parks, the quarry, streets with their
markings, fields far away.

Albedo (linear RGB) at hit points, evaluated once per ray that meets the ground, some 60 % of them.
One pass computes the shared noise of four sizes; then each kind of block paints its own samples and
the streets are painted over.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from scenegen.layout import (
    BLOCK_U_M,
    BLOCK_V_M,
    LOTS_U,
    LOTS_V,
    PAVEMENT_HALF_M,
    ROAD_HALF_M,
    Block,
    Layout,
    street_distance_m,
)
from scenegen.noise import Floats, detail_noise, hash_unit

STALL_M, STALL_DEPTH_M = 2.7, 5.2


def linear(red: float, green: float, blue: float) -> Floats:
    """Linear RGB of an sRGB colour given in [0, 1]."""
    return np.power(np.array([red, green, blue], np.float32), 2.2).astype(np.float32)


GRASS, DRY_GRASS, DARK_GRASS = linear(0.42, 0.47, 0.29), linear(0.58, 0.56, 0.40), linear(0.28, 0.34, 0.20)
SOIL, GRAVEL, SAND = linear(0.43, 0.34, 0.25), linear(0.66, 0.63, 0.58), linear(0.78, 0.71, 0.57)
ASPHALT, OLD_ASPHALT, NEW_ASPHALT = linear(0.43, 0.43, 0.44), linear(0.52, 0.51, 0.50), linear(0.29, 0.29, 0.31)
PAVING, KERB, PAINT = linear(0.66, 0.64, 0.61), linear(0.76, 0.75, 0.72), linear(0.95, 0.94, 0.91)
BRICK_PAVING, TERRACOTTA = linear(0.60, 0.56, 0.51), linear(0.75, 0.52, 0.40)
POOL, POND, NET = linear(0.40, 0.70, 0.78), linear(0.20, 0.30, 0.29), linear(0.13, 0.14, 0.17)
ROCK, DARK_ROCK = linear(0.70, 0.63, 0.53), linear(0.48, 0.42, 0.36)
FLOWERS = np.stack([linear(0.85, 0.33, 0.36), linear(0.92, 0.82, 0.36), linear(0.93, 0.91, 0.93), linear(0.66, 0.46, 0.74)])
CROPS = np.stack([linear(0.46, 0.51, 0.30), linear(0.68, 0.63, 0.44), linear(0.54, 0.47, 0.38), linear(0.38, 0.44, 0.27)])


@dataclass(frozen=True, kw_only=True)
class GroundSamples:
    """Hit points on the ground (N,): block numbers i j, block coordinates a b, and noise in [-1/2,
    1/2) of four sizes."""

    i: NDArray[np.int32]
    j: NDArray[np.int32]
    a: Floats
    b: Floats
    x: Floats
    y: Floats
    steepness: Floats
    broad: Floats
    patchy: Floats
    fine: Floats
    grain: Floats

    def take(self, chosen: NDArray[np.bool_]) -> GroundSamples:
        """The chosen samples only."""
        return GroundSamples(**{each.name: getattr(self, each.name)[chosen] for each in fields(self)})


def ground_albedo(layout: Layout, points: Floats, normal_z: Floats, footprint_m: Floats) -> Floats:
    """Linear RGB (N,3) of the ground at points (N,3) seen with pixels of footprint_m (N,)."""
    samples = _sample(layout, points, normal_z, footprint_m)
    if layout.scenery == "fields":
        return _infrared_crops(samples)
    kind = layout.block_kind(samples.i, samples.j)
    painters = {
        Block.HOUSES: _gardens, Block.FLATS: _courtyard, Block.PARKING: _car_park,
        Block.PARK: _park, Block.QUARRY: _quarry, Block.OUTSIDE: _fields,
    }  # fmt: skip
    albedo = np.empty((len(points), 3), np.float32)
    for block, painter in painters.items():
        chosen = kind == block
        if chosen.any():
            albedo[chosen] = painter(layout, samples.take(chosen))
    street = (street_distance_m(samples.a, samples.b) < PAVEMENT_HALF_M) & (kind != Block.OUTSIDE)
    albedo[street] = _street(layout, samples.take(street))
    return albedo


def tint(base: Floats, other: Floats, share: NDArray) -> Floats:
    """(N,3) mixture of two colours; share (N,) is clipped to [0, 1]."""
    share = np.clip(share, 0.0, 1.0).astype(np.float32)[:, None]
    return base * (np.float32(1.0) - share) + other * share


def shade(color: Floats, factor: NDArray) -> Floats:
    """Colours (N,3) or (3,) made brighter or darker by factor (N,), never below a fifth."""
    return color * np.maximum(factor, 0.2).astype(np.float32)[:, None]


def _sample(layout: Layout, points: Floats, normal_z: Floats, footprint_m: Floats) -> GroundSamples:
    x, y, z = points[:, 0], points[:, 1], points[:, 2]
    u, v = layout.town_from_world(x, y)
    i, j = np.floor(u / BLOCK_U_M).astype(np.int32), np.floor(v / BLOCK_V_M).astype(np.int32)
    # Slanted by the height, so that the steep walls of the quarry do not show vertical streaks.
    slanted_x, slanted_y = x + np.float32(0.35) * z, y - np.float32(0.3) * z
    noises = {
        name: detail_noise(slanted_x, slanted_y, cell_m, layout.salt(salt), footprint_m)
        for name, cell_m, salt in (("broad", 9.0, 20), ("patchy", 2.3, 21), ("fine", 0.62, 22), ("grain", 0.24, 23))
    }
    return GroundSamples(
        i=i, j=j, a=u - (i + np.float32(0.5)) * np.float32(BLOCK_U_M), b=v - (j + np.float32(0.5)) * np.float32(BLOCK_V_M),
        x=x, y=y, steepness=np.float32(1.0) - normal_z, **noises,
    )  # fmt: skip


def _grass(s: GroundSamples) -> Floats:
    color = tint(GRASS, DRY_GRASS, 0.28 + 0.9 * s.broad + 0.8 * s.patchy)
    color = tint(color, DARK_GRASS, 1.6 * (s.fine + 0.5 * s.broad - 0.12))
    color = tint(color, SOIL, 6.0 * (s.patchy + 0.5 * s.fine - 0.40))
    return shade(color, 1.0 + 1.25 * s.grain + 0.75 * s.fine)


def _stony(color: Floats, s: GroundSamples, contrast: float) -> Floats:
    return shade(color, 1.0 + contrast * (0.5 * s.patchy + 0.6 * s.fine + s.grain))


def _gardens(layout: Layout, s: GroundSamples) -> Floats:
    """Lots with lawns of their own tint, a drive to the street, a terrace behind the house, a bed,
    a pool or a trampoline."""
    width, depth = (BLOCK_U_M - 2 * PAVEMENT_HALF_M) / LOTS_U, (BLOCK_V_M - 2 * PAVEMENT_HALF_M) / LOTS_V
    column = np.clip(np.floor(s.a / width + LOTS_U / 2), 0, LOTS_U - 1).astype(np.int32)
    row = (s.b > 0).astype(np.int32)
    lot_i, lot_j = s.i * LOTS_U + column, s.j * LOTS_V + row
    across = s.a - ((column + 0.5) / LOTS_U - 0.5) * width * LOTS_U
    inward = depth - np.abs(s.b)
    choice = [hash_unit(lot_i, lot_j, layout.salt(30 + k)) for k in range(4)]
    color = tint(_grass(s), DRY_GRASS, 0.55 * choice[0] - 0.1)
    color = shade(color, 0.85 + 0.4 * choice[1])
    side = np.where(choice[2] < 0.5, -1.0, 1.0).astype(np.float32)
    drive = (np.abs(across - side * (width / 2 - 2.6)) < 1.7) & (inward < 9.5)
    color[drive] = tint(_stony(GRAVEL, s, 0.5), _bricks(s, 0.5, 0.25), (choice[1] > 0.5) * 1.0)[drive]
    terrace = (np.abs(across) < 3.2) & (inward > 10.2) & (inward < 13.0)
    color[terrace] = tint(_bricks(s, 0.8, 0.8), TERRACOTTA, 0.6 * (choice[3] > 0.6))[terrace]
    bed = (np.abs(across + side * (width / 2 - 1.4)) < 0.8) & (inward > 2.0)
    color[bed] = _flower_bed(layout, s.take(bed))
    radius = np.hypot(across + side * 4.6, inward - 12.3)
    color[(radius < 1.75) & (choice[3] < 0.3)] = linear(0.32, 0.42, 0.58)
    color[(radius < 1.45) & (choice[3] < 0.3)] = NET
    pool_a, pool_b = np.abs(across + side * 3.9), np.abs(inward - 11.9)
    pool = (choice[3] > 0.72) & (pool_a < 2.9) & (pool_b < 1.9)
    color[pool] = np.where(((pool_a > 2.5) | (pool_b > 1.5))[:, None], PAINT, shade(POOL, 1.0 + s.fine + 0.6 * s.patchy))[pool]
    return color


def _flower_bed(layout: Layout, s: GroundSamples) -> Floats:
    color = _stony(SOIL, s, 0.9)
    cell_x, cell_y = np.floor(s.x / 0.45).astype(np.int32), np.floor(s.y / 0.45).astype(np.int32)
    which = hash_unit(cell_x, cell_y, layout.salt(35))
    bed_x, bed_y = np.floor(s.x / 5.0).astype(np.int32), np.floor(s.y / 5.0).astype(np.int32)
    kind = (hash_unit(bed_x, bed_y, layout.salt(34)) * len(FLOWERS)).astype(np.int32)
    leaves = shade(DARK_GRASS, 1.0 + 1.2 * s.grain + s.fine)
    blossom = tint(leaves, FLOWERS[kind], (which < 0.22) * (0.6 + s.fine))
    return np.where((which < 0.75)[:, None], blossom, color)


def _bricks(s: GroundSamples, length_m: float, width_m: float) -> Floats:
    """Paving of stones with a tone each and dark joints."""
    column, row = np.floor(s.a / length_m), np.floor(s.b / width_m)
    tone = hash_unit(column.astype(np.int32), row.astype(np.int32), 5)
    joint = (s.a / length_m - column < 0.10) | (s.b / width_m - row < 0.10)
    brightness = 0.86 + 0.28 * tone + 0.6 * s.fine + 0.4 * s.patchy + 0.5 * s.grain
    return shade(tint(BRICK_PAVING, PAVING, tone), brightness * np.where(joint, 0.72, 1.0))


def _courtyard(layout: Layout, s: GroundSamples) -> Floats:
    color = _bricks(s, 1.5, 1.0)
    lawn = (np.abs(np.abs(s.b) - 11.0) < 3.0) & (np.abs(np.abs(s.a) - 9.5) < 7.5)
    color[lawn] = _grass(s)[lawn]
    bed = (np.abs(s.b) < 0.9) & (np.abs(np.abs(s.a) - 6.0) < 4.0)
    color[bed] = _flower_bed(layout, s.take(bed))
    return color


def _car_park(layout: Layout, s: GroundSamples) -> Floats:
    color = _asphalt(layout, s)
    stall = s.a / STALL_M - np.floor(s.a / STALL_M)
    row_distance = np.abs(np.abs(s.b) - 7.4)
    line = (np.minimum(stall, 1.0 - stall) * STALL_M < 0.09) | (np.abs(np.abs(s.b) - 7.4) < 0.07)
    inside = (row_distance < STALL_DEPTH_M) & (np.abs(s.a) < 7 * STALL_M)
    return tint(color, PAINT, (line & inside) * (0.85 + 0.5 * s.fine))


def _park(layout: Layout, s: GroundSamples) -> Floats:
    color = _grass(s)
    sporty = hash_unit(s.i, s.j, layout.salt(36)) < 0.5
    path = np.abs(s.b - 5.5 * np.sin(s.a / 7.0) - 2.0) < 1.1
    color[path] = _stony(SAND, s, 0.6)[path]
    field_a, field_b = np.abs(s.a), np.abs(s.b + 1.0)
    pitch = sporty & (field_a < 13.0) & (field_b < 8.0)
    stripe = 0.9 + 0.2 * (np.floor(s.a / 2.6) % 2)
    color[pitch] = shade(tint(_grass(s), GRASS, np.full(len(s.a), 0.5)), stripe)[pitch]
    border = np.minimum(np.abs(field_a - 12.0), np.abs(field_b - 7.0))
    circle = np.abs(np.hypot(field_a, field_b) - 3.0)
    line = pitch & (field_a < 12.1) & (field_b < 7.1) & ((border < 0.1) | (circle < 0.1) | (field_a < 0.1))
    color[line] = PAINT
    wobble = 1.0 + 0.25 * s.broad
    pond = ~sporty & (np.hypot((s.a - 10.0) / 7.5, (s.b + 6.5) / 4.0) < wobble)
    lily = tint(shade(POND, 1.0 + 0.8 * s.patchy + 0.5 * s.fine), linear(0.42, 0.55, 0.30), 12.0 * (s.fine + s.patchy - 0.35))
    color[pond] = lily[pond]
    return color


def _quarry(layout: Layout, s: GroundSamples) -> Floats:
    radius = np.hypot(s.a / 19.5, s.b / 13.5) + 0.12 * s.broad
    strata = np.clip(4.0 * s.steepness, 0.0, 1.0)
    rock = tint(_stony(ROCK, s, 1.1), DARK_ROCK, 0.35 + 1.2 * s.broad + 0.9 * s.patchy + 0.4 * strata)
    rock = tint(rock, linear(0.72, 0.50, 0.33), 1.2 * (s.broad - 0.12))
    tracks = np.abs(np.abs(s.b - 0.25 * s.a - 1.0) - 0.9) < 0.22
    rock = shade(rock, np.where(tracks & (radius < 0.8), 0.72, 1.0))
    return tint(rock, _grass(s), 8.0 * (radius - 1.02))


def _fields(layout: Layout, s: GroundSamples) -> Floats:
    """Meadow near the town, further out a patchwork of crops in rows, and woods."""
    column, row = np.floor((s.x + 0.35 * s.y) / 140.0), np.floor((s.y - 0.35 * s.x) / 95.0)
    which = hash_unit(column.astype(np.int32), row.astype(np.int32), layout.salt(37))
    crop = CROPS[(which * len(CROPS)).astype(np.int32)]
    rows = np.sin((s.x + 0.35 * s.y + (which > 0.5) * s.y) * 0.9)
    distance = np.hypot(s.x, s.y)
    color = tint(_grass(s), shade(crop, 1.0 + 0.5 * s.patchy + 0.5 * s.fine), 0.2 + (distance - 150.0) / 150.0)
    color = shade(color, 1.0 + 0.12 * rows * np.clip(1.4 - distance / 300.0, 0.0, 1.0))
    return tint(color, linear(0.19, 0.27, 0.15), 2.0 * (distance - 420.0) / 300.0 * (which > 0.55))


def _infrared_crops(s: GroundSamples) -> Floats:
    """Crops as an infrared camera sees them: bright, grey, faint rows, fields of unlike vigour."""
    rows = np.sin(2 * np.pi * (s.x + 0.2 * s.y) / 0.75)
    vigour = 0.42 + 0.16 * s.broad + 0.16 * s.patchy + 0.16 * s.fine + 0.12 * s.grain + 0.02 * rows
    return np.repeat(np.clip(vigour, 0.05, 1.0).astype(np.float32)[:, None], 3, axis=1)


def _asphalt(layout: Layout, s: GroundSamples) -> Floats:
    color = tint(ASPHALT, OLD_ASPHALT, 0.4 + 0.8 * s.broad + 0.4 * s.patchy)
    column, row = np.floor(s.a / 6.5).astype(np.int32), np.floor(s.b / 6.5).astype(np.int32)
    patched = hash_unit(column + 8 * s.i, row + 8 * s.j, layout.salt(38)) < 0.16
    inset = (np.abs(s.a / 6.5 - column - 0.5) < 0.33) & (np.abs(s.b / 6.5 - row - 0.5) < 0.20)
    color = tint(color, NEW_ASPHALT, (patched & inset) * 0.8)
    crack = (np.abs(s.patchy + 0.25 * s.fine) < 0.011) | (np.abs(s.broad + 0.1 * s.fine) < 0.004)
    return _stony(shade(color, np.where(crack, 0.74, 1.0)), s, 0.8)


def _street(layout: Layout, s: GroundSamples) -> Floats:
    from_u, from_v = BLOCK_U_M / 2 - np.abs(s.a), BLOCK_V_M / 2 - np.abs(s.b)
    nearest = np.minimum(from_u, from_v)
    color = _asphalt(layout, s)
    pavement = nearest > ROAD_HALF_M
    color[pavement] = shade(_bricks(s, 1.0, 1.0), np.full(len(s.a), 1.0))[pavement]
    color[np.abs(nearest - ROAD_HALF_M) < 0.14] = KERB
    crossing = np.maximum(from_u, from_v)
    along = np.where(from_u < from_v, s.b, s.a)
    dash = (along / 3.0 - np.floor(along / 3.0)) < 0.5
    marking = (nearest < 0.09) & dash & (crossing > 9.0)
    bars = (nearest / 1.1 - np.floor(nearest / 1.1)) < 0.5
    marking |= (crossing > 5.6) & (crossing < 8.2) & (nearest < 3.0) & bars
    marking |= (np.abs(nearest - 2.95) < 0.06) & (crossing > 9.0)
    color = tint(color, PAINT, marking * np.clip(0.85 + 0.9 * s.fine + 0.4 * s.patchy, 0.2, 1.0))
    cell_a, cell_b = np.floor(s.a / 5.0), np.floor(s.b / 5.0)
    lid = np.hypot(s.a - (cell_a + 0.5) * 5.0, s.b - (cell_b + 0.45) * 5.0) < 0.36
    chosen = hash_unit((cell_a + 32 * s.i).astype(np.int32), (cell_b + 32 * s.j).astype(np.int32), layout.salt(39)) < 0.3
    color[lid & chosen & (nearest < 2.8)] = linear(0.26, 0.25, 0.24)
    return color
