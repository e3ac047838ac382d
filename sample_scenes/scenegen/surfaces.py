"""The colour of walls, roofs, leaves, heaps, cars and the sky, evaluated once per ray; all surfaces
are matte.

Each painter turns `Hits` of one material into albedo (N,3) linear RGB; `paint` sends every hit to
its painter.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from scenegen.ground import ground_albedo, linear, shade, tint
from scenegen.layout import Layout
from scenegen.mesh import Material
from scenegen.noise import Floats, detail_noise, hash_unit, value_noise

TILE_WIDTH_M, TILE_ROW_M = 0.30, 0.42
WINDOW_LOW_M, WINDOW_HIGH_M, STOREY_M = 0.9, 2.2, 2.8
PANE, FRAME = linear(0.20, 0.25, 0.30), linear(0.94, 0.94, 0.92)
SHUTTER, PLINTH = linear(0.32, 0.42, 0.34), linear(0.48, 0.46, 0.44)
PANEL, MOSS = linear(0.10, 0.14, 0.27), linear(0.42, 0.44, 0.27)
ZENITH, HORIZON, CLOUD = linear(0.36, 0.56, 0.84), linear(0.80, 0.87, 0.94), linear(0.99, 0.99, 1.0)


@dataclass(frozen=True, kw_only=True)
class Hits:
    """Where rays met surfaces (N,…): position, unit normal, uv, the triangle's look, and the width
    of a pixel there."""

    points: Floats
    normals: Floats
    uvs: Floats
    materials: NDArray[np.uint8]
    tints: Floats
    numbers: NDArray[np.int32]
    footprint_m: Floats

    def take(self, chosen: NDArray[np.bool_]) -> Hits:
        """The chosen hits only."""
        return Hits(**{each.name: getattr(self, each.name)[chosen] for each in fields(self)})


def paint(layout: Layout, hits: Hits) -> Floats:
    """Albedo (N,3) of every hit."""
    painters = {
        Material.GROUND: _ground, Material.WALL: _wall, Material.TILES: _tiles, Material.FLAT_ROOF: _flat_roof,
        Material.PLAIN: _plain, Material.GLASS: _plain, Material.FOLIAGE: _foliage, Material.HEAP: _heap,
    }  # fmt: skip
    albedo = np.empty((len(hits.points), 3), np.float32)
    for material, painter in painters.items():
        chosen = hits.materials == material
        if chosen.any():
            albedo[chosen] = painter(layout, hits.take(chosen))
    return albedo


def ruffle_leaves(layout: Layout, hits: Hits) -> Floats:
    """Normals (N,3) with those of leaves turned at random per handful of leaves, so that crowns
    catch light in spots."""
    normals = hits.normals.copy()
    leaves = hits.materials == Material.FOLIAGE
    if leaves.any():
        crown = hits.take(leaves)
        turned = normals[leaves]
        for axis in range(3):
            turned[:, axis] += np.float32(3.0) * _solid_noise(layout, crown, 0.36, 40 + axis)
        normals[leaves] = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    return normals


def sky_color(layout: Layout, directions: Floats) -> Floats:
    """Linear RGB (N,3) of the sky in unit directions (N,3): a gradient and a few clouds."""
    height = np.maximum(directions[:, 2], 0.02)
    color = tint(HORIZON, ZENITH, 1.0 - np.exp(-3.0 * height))
    x, y = directions[:, 0] / (height + np.float32(0.15)), directions[:, 1] / (height + np.float32(0.15))
    cover = 0.6 * value_noise(x, y, 1.9, layout.salt(50)) + 0.28 * value_noise(x, y, 0.7, layout.salt(51))
    cover += 0.12 * value_noise(x, y, 0.25, layout.salt(52))
    return tint(color, CLOUD, 3.5 * (cover - 0.52) * np.clip(height * 14.0, 0.0, 1.0))


def _solid_noise(layout: Layout, hits: Hits, cell_m: float, which: int) -> Floats:
    """detail_noise on a slanted slice of space, so that it varies along every surface."""
    x, y, z = hits.points.T
    slanted_x, slanted_y = x + np.float32(0.83) * z, y - np.float32(0.71) * z
    return detail_noise(slanted_x, slanted_y, cell_m, layout.salt(which), hits.footprint_m)


def _ground(layout: Layout, hits: Hits) -> Floats:
    return ground_albedo(layout, hits.points, hits.normals[:, 2], hits.footprint_m)


def _plain(layout: Layout, hits: Hits) -> Floats:
    return shade(hits.tints, 1.0 + 0.18 * _solid_noise(layout, hits, 0.35, 44))


def _wall(layout: Layout, hits: Hits) -> Floats:
    """Plaster with stains, a plinth, and framed windows on every storey, some with shutters."""
    column, storey = np.floor(hits.uvs[:, 0]), np.floor(hits.uvs[:, 1] / STOREY_M)
    across, up = np.abs(hits.uvs[:, 0] - column - 0.5), hits.uvs[:, 1] - storey * STOREY_M
    color = shade(hits.tints, 1.0 + 0.4 * _solid_noise(layout, hits, 1.7, 45) + 0.5 * _solid_noise(layout, hits, 0.4, 46))
    color = tint(color, PLINTH, (hits.uvs[:, 1] < 0.45) * 1.0)
    choice = hash_unit(column.astype(np.int32) + hits.numbers, storey.astype(np.int32), layout.salt(47))
    there = (choice > 0.18) & (hits.uvs[:, 1] > 0.45)
    within = (up > WINDOW_LOW_M) & (up < WINDOW_HIGH_M)
    color = np.where((there & within & (across < 0.40) & (choice > 0.6))[:, None], SHUTTER, color)
    color = np.where((there & within & (across < 0.25))[:, None], FRAME, color)
    bar = np.abs(up - 1.55) < 0.04
    pane = there & (up > WINDOW_LOW_M + 0.1) & (up < WINDOW_HIGH_M - 0.1) & (across < 0.21) & ~bar
    return np.where(pane[:, None], shade(PANE, 0.7 + 1.4 * choice + 0.25 * (up - 1.5)), color)


def _tiles(layout: Layout, hits: Hits) -> Floats:
    """Rows of tiles of their own tone, moss, and on some roofs windows or solar panels."""
    along, up = hits.uvs.T
    row = np.floor(up / TILE_ROW_M)
    column = np.floor(along / TILE_WIDTH_M + 0.5 * (row % 2))
    tone = hash_unit(column.astype(np.int32) + hits.numbers, row.astype(np.int32), layout.salt(48)) - np.float32(0.5)
    fade = np.clip(TILE_ROW_M / hits.footprint_m / 2.0 - 0.5, 0.0, 1.0)
    edge = (up / TILE_ROW_M - row < 0.22) * np.float32(-0.26)
    broad, patchy = _solid_noise(layout, hits, 2.6, 49), _solid_noise(layout, hits, 0.7, 53)
    color = shade(hits.tints, 1.0 + fade * (0.75 * tone + edge) + 0.55 * broad + 0.45 * patchy)
    color = tint(color, MOSS, 2.5 * (broad + 0.6 * patchy - 0.25))
    slope = np.where(up > 25.0, 1, 0)
    style = hash_unit(hits.numbers, slope, layout.salt(54))
    return _roof_fittings(color, np.stack([along, np.where(slope == 1, up - 50.0, up)]), style)


def _roof_fittings(color: Floats, place: Floats, style: Floats) -> Floats:
    """Solar panels on slopes with style below 0.25, two roof windows on those below 0.6; place is
    (along, up) in metres."""
    along, up = place
    solar = (style < 0.25) & (np.abs(along) < 3.0) & (np.abs(up - 2.6) < 1.6)
    panel_a, panel_b = along - np.floor(along), (up - 1.0) / 1.6 - np.floor((up - 1.0) / 1.6)
    rim = (panel_a < 0.07) | (panel_b < 0.05)
    color = np.where(solar[:, None], np.where(rim[:, None], FRAME * np.float32(0.6), PANEL), color)
    from_window = np.maximum(np.abs(np.abs(along) - 1.9), np.abs(up - 2.4) * 0.8)
    with_windows = (style >= 0.25) & (style < 0.6)
    color = np.where((with_windows & (from_window < 0.56))[:, None], FRAME * np.float32(0.7), color)
    return np.where((with_windows & (from_window < 0.42))[:, None], PANE, color)


def _flat_roof(layout: Layout, hits: Hits) -> Floats:
    """Felt in strips with seams and stains."""
    strip = np.floor(hits.uvs[:, 1] / 1.1)
    seam = hits.uvs[:, 1] / 1.1 - strip < 0.06
    tone = hash_unit(strip.astype(np.int32), hits.numbers, layout.salt(55)) - np.float32(0.5)
    stains = 0.6 * _solid_noise(layout, hits, 2.4, 56)
    stains += 0.5 * _solid_noise(layout, hits, 0.8, 57) + 0.5 * _solid_noise(layout, hits, 0.25, 58)
    return shade(hits.tints, (1.0 + 0.3 * tone + stains) * np.where(seam, 0.75, 1.0))


def _foliage(layout: Layout, hits: Hits) -> Floats:
    """Leaves in clumps, with dark gaps between them."""
    clumps, leaves = _solid_noise(layout, hits, 0.9, 59), _solid_noise(layout, hits, 0.3, 60)
    return shade(hits.tints, 1.05 + 1.1 * clumps + 1.7 * leaves)


def _heap(layout: Layout, hits: Hits) -> Floats:
    stones = 0.7 * _solid_noise(layout, hits, 0.8, 61) + 1.0 * _solid_noise(layout, hits, 0.3, 62)
    return shade(hits.tints, 1.0 + stones)
