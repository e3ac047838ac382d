"""Houses that change between two dates: which ones, how, and where every house stands.

    removed      nothing is left of it, not even its foundation
    raised       every height of it grows by half: a storey more
    repainted    other tiles and plaster, in a colour far from the old one
    extended     a flat-roofed wing of 5 × 5 m beside it
Everything else draws the same random numbers on both dates. Once per scene.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from scenegen.ground import linear
from scenegen.layout import BLOCK_U_M, BLOCK_V_M, LOTS_U, LOTS_V, Block, Layout, lot_center_m
from scenegen.mesh import Look, Material, MeshBuilder, Placement, add_lid, add_prism, rectangle

Alteration = Literal["removed", "raised", "repainted", "extended"]
ALTERATIONS: tuple[Alteration, ...] = ("removed", "raised", "repainted", "extended")
HouseKey = tuple[int, int, int, int]
"""Block i, j and lot u, v."""
INNER_SHARE = 0.8
"""Of the area's sides, within which houses are altered: the rest few photographs see."""
RAISED_BY, WING_M, WING_HEIGHT_M = 1.5, 5.0, 3.2
_PAINTS = (linear(0.20, 0.30, 0.55), linear(0.86, 0.84, 0.80), linear(0.12, 0.12, 0.13))
_WING_ROOF = linear(0.82, 0.80, 0.76)


@dataclass(frozen=True, kw_only=True)
class House:
    """The middle of a house's lot in the world, m, and how it is altered, if it is."""

    key: HouseKey
    x: float
    y: float
    alteration: Alteration | None


def houses_of(layout: Layout, num_altered: int) -> list[House]:
    """All houses in the inner part of the area; `num_altered` of them, drawn by the layout's seed,
    are altered in turn in each way. Fewer where there are not so many."""
    places: list[tuple[HouseKey, float, float]] = []
    for i, j, kind in layout.blocks():
        if kind != Block.HOUSES:
            continue
        for lot_u in range(LOTS_U):
            for lot_v in range(LOTS_V):
                a, b = lot_center_m(lot_u, lot_v)
                x, y = layout.world_from_town(a + (i + 0.5) * BLOCK_U_M, b + (j + 0.5) * BLOCK_V_M)
                if abs(x) < INNER_SHARE / 2 * layout.extent_m[0] and abs(y) < INNER_SHARE / 2 * layout.extent_m[1]:
                    places.append(((i, j, lot_u, lot_v), x, y))
    chosen = np.random.default_rng([layout.seed, 5]).permutation(len(places))[:num_altered].tolist()
    way_of: dict[int, Alteration] = {row: ALTERATIONS[turn % len(ALTERATIONS)] for turn, row in enumerate(chosen)}
    return [House(key=key, x=x, y=y, alteration=way_of.get(row)) for row, (key, x, y) in enumerate(places)]


def alterations_of(layout: Layout, num_altered: int) -> Mapping[HouseKey, Alteration]:
    """How each altered house is altered."""
    return {house.key: house.alteration for house in houses_of(layout, num_altered) if house.alteration}


def add_altered(builder: MeshBuilder, house: MeshBuilder, place: Placement, way: Alteration | None) -> None:
    """Add the pieces of a `house` built apart at `place`, altered in one way or, for None, as they
    are."""
    if way == "removed":
        return
    start = 0
    for piece in house.pieces:
        vertices = piece.vertices.astype(np.float64)
        if way == "raised":
            vertices[:, 2] = place.z + RAISED_BY * (vertices[:, 2] - place.z)
        tint = piece.tints[0]
        material = Material(int(piece.materials[0]))
        if way == "repainted" and material in (Material.TILES, Material.WALL):
            tint = max(_PAINTS, key=lambda paint: float(np.abs(paint - piece.tints[0]).sum()))
        look = Look(material=material, tint=tint, number=int(piece.numbers[0]))
        builder.add(vertices, piece.triangles.astype(np.int64) - start, piece.normals, piece.uvs, look)
        start += len(piece.vertices)
    if way == "extended":
        _add_wing(builder, place)


def _add_wing(builder: MeshBuilder, place: Placement) -> None:
    x, y, z = place.world(np.array([[0.0, 5.5, 0.0]]))[0]
    wing = Placement(x=float(x), y=float(y), z=float(z), heading_rad=place.heading_rad)
    outline, look = rectangle(WING_M, WING_M), Look(material=Material.PLAIN, tint=_WING_ROOF)
    add_prism(builder, wing, (outline, outline), (-1.0, WING_HEIGHT_M), look)
    add_lid(builder, wing, outline, WING_HEIGHT_M, look)
