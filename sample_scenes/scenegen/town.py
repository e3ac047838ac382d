"""The whole town as one mesh: the ground, then block by block what stands on it.

Built once per scene. Every block draws from a random stream of its own, so apart from the quarry a
town keeps its blocks when its area grows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from scenegen.alterations import Alteration, HouseKey, add_altered
from scenegen.buildings import add_flats, add_house, add_shed
from scenegen.ground import STALL_M
from scenegen.layout import BLOCK_U_M, BLOCK_V_M, LOTS_U, LOTS_V, TOWN_MARGIN_M, Block, Layout, lot_center_m
from scenegen.mesh import Look, Material, Mesh, MeshBuilder, Placement
from scenegen.props import add_bush, add_car, add_container, add_heap, add_hedge, add_lamp, add_tree

GROUND_STEP_M, GROUND_GROWTH, GROUND_REACH_M = 0.9, 1.22, 3000.0
LAMP_SPACING_M = 17.0


def build_town(layout: Layout, altered: Mapping[HouseKey, Alteration] | None = None) -> Mesh:
    """The ground out to the horizon and everything that stands on it; `altered`: houses that are
    not as they were."""
    builder = MeshBuilder()
    _add_ground(builder, layout)
    fillers = {
        Block.HOUSES: _fill_houses, Block.FLATS: _fill_flats, Block.PARKING: _fill_parking,
        Block.PARK: _fill_park, Block.QUARRY: _fill_quarry,
    }  # fmt: skip
    for i, j, kind in layout.blocks():
        rng = np.random.default_rng([layout.seed, i + 10_000, j + 10_000])
        site = _Site(layout=layout, i=i, j=j, altered=altered or {})
        fillers[kind](builder, site, rng)
        _line_streets(builder, site, rng)
    if layout.scenery == "town":
        _plant_surroundings(builder, layout)
    return builder.build()


@dataclass(frozen=True, kw_only=True)
class _Site:
    """One block: turns block coordinates into placements on the ground."""

    layout: Layout
    i: int
    j: int
    altered: Mapping[HouseKey, Alteration] = field(default_factory=dict)

    def at(self, a: float, b: float, turn_rad: float = 0.0) -> Placement:
        """Placement at block coordinates a, b with a heading relative to the street."""
        u, v = a + (self.i + 0.5) * BLOCK_U_M, b + (self.j + 0.5) * BLOCK_V_M
        x, y = self.layout.world_from_town(u, v)
        z = float(self.layout.height_m(np.array([x]), np.array([y]))[0])
        return Placement(x=x, y=y, z=z, heading_rad=self.layout.heading_rad(u, v) + turn_rad)


def _add_ground(builder: MeshBuilder, layout: Layout) -> None:
    """A grid of 0.9 m in the town whose cells grow towards the horizon."""
    lines_x, lines_y = (_grid_lines(extent / 2.0 + TOWN_MARGIN_M) for extent in layout.extent_m)
    x, y = (axis.ravel() for axis in np.meshgrid(lines_x, lines_y))
    z = layout.height_m(x, y)
    vertices = np.column_stack([x, y, z])
    columns = len(lines_x)
    slope_y, slope_x = np.gradient(z.reshape(-1, columns), lines_y, lines_x)
    normals = np.column_stack([-slope_x.ravel(), -slope_y.ravel(), np.ones(len(x))])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    row, column = np.meshgrid(np.arange(len(lines_y) - 1), np.arange(columns - 1), indexing="ij")
    corner = (row * columns + column).ravel()
    lower = np.column_stack([corner, corner + 1, corner + columns])
    upper = np.column_stack([corner + 1, corner + columns + 1, corner + columns])
    triangles = np.concatenate([lower, upper])
    look = Look(material=Material.GROUND, tint=np.ones(3, np.float32))
    builder.add(vertices, triangles, normals, np.zeros((len(x), 2)), look)


def _grid_lines(half_m: float) -> NDArray[np.float64]:
    """Coordinates from -3 km to 3 km: evenly spaced within ± half_m, then ever further apart."""
    inner = np.arange(0.0, half_m, GROUND_STEP_M)
    outer, step = [], GROUND_STEP_M
    position = float(inner[-1])
    while position < GROUND_REACH_M:
        step *= GROUND_GROWTH
        position += step
        outer.append(position)
    positive = np.concatenate([inner, outer])
    return np.concatenate([-positive[:0:-1], positive])


def _fill_houses(builder: MeshBuilder, site: _Site, rng: np.random.Generator) -> None:
    """A house, a shed, hedges and trees on each of the lots."""
    for lot_u in range(LOTS_U):
        for lot_v in range(LOTS_V):
            a, b = lot_center_m(lot_u, lot_v)
            street = 1.0 if lot_v else -1.0
            turn = 0.0 if rng.random() < 0.6 else np.pi / 2
            size = (float(rng.uniform(7.5, 9.0)), float(rng.uniform(6.2, 7.2)))
            if turn:
                size = (min(size[0], 7.6), size[1])
            place, house = site.at(a + float(rng.uniform(-0.4, 0.4)), b + 1.2 * street, turn), MeshBuilder()
            add_house(house, place, size, rng)
            add_altered(builder, house, place, site.altered.get((site.i, site.j, lot_u, lot_v)))
            if rng.random() < 0.55:
                add_shed(builder, site.at(a + float(rng.choice([-5.0, 5.0])), b - 5.4 * street, 0.0), rng)
            if rng.random() < 0.7:
                add_hedge(builder, site.at(a, b - 7.2 * street), 11.0, rng)
            if rng.random() < 0.6:
                add_hedge(builder, site.at(a + 6.8, b - 1.0 * street, np.pi / 2), 9.0, rng)
            for _ in range(int(rng.integers(1, 4))):
                spot = site.at(a + float(rng.choice([-1.0, 1.0]) * rng.uniform(4.4, 6.4)), b + float(rng.uniform(-6.4, 6.4)))
                add_tree(builder, spot, float(rng.uniform(2.6, 6.5)), rng)
            for _ in range(int(rng.integers(1, 5))):
                add_bush(builder, site.at(a + float(rng.uniform(-6.5, 6.5)), b + 6.6 * street), rng)
            if rng.random() < 0.5:
                add_car(builder, site.at(a + float(rng.choice([-4.4, 4.4])), b + 5.0 * street, np.pi / 2), rng)


def _fill_flats(builder: MeshBuilder, site: _Site, rng: np.random.Generator) -> None:
    for a in (-11.5, 11.5):
        width = float(rng.uniform(9.5, 12.0))
        add_flats(builder, site.at(a, float(rng.uniform(-2.5, 2.5)), np.pi / 2), (19.0, width), rng)
    _scatter_trees(builder, site, rng, 12)


def _fill_parking(builder: MeshBuilder, site: _Site, rng: np.random.Generator) -> None:
    for row in (-7.4, 7.4):
        for half in (-2.6, 2.6):
            for stall in range(-6, 6):
                if rng.random() < 0.62:
                    turn = np.pi / 2 if rng.random() < 0.5 else -np.pi / 2
                    add_car(builder, site.at((stall + 0.5) * STALL_M, row + half, turn + float(rng.normal(0.0, 0.03))), rng)
    for a in (-19.5, 19.5):
        for b in np.arange(-11.0, 12.0, 5.5):
            add_tree(builder, site.at(a, float(b)), float(rng.uniform(4.5, 7.0)), rng)


def _fill_park(builder: MeshBuilder, site: _Site, rng: np.random.Generator) -> None:
    for _ in range(22):
        a, b = float(rng.uniform(-20.0, 20.0)), float(rng.uniform(-14.5, 14.5))
        if abs(a) > 14.5 or abs(b) > 10.0:
            add_tree(builder, site.at(a, b), float(rng.uniform(5.0, 10.0)), rng)
    for _ in range(14):
        add_bush(builder, site.at(float(rng.uniform(-19.0, 19.0)), float(rng.choice([-1.0, 1.0]) * rng.uniform(9.5, 14.0))), rng)


def _fill_quarry(builder: MeshBuilder, site: _Site, rng: np.random.Generator) -> None:
    for _ in range(5):
        spot = site.at(float(rng.uniform(-8.0, 8.0)), float(rng.uniform(-5.0, 5.0)))
        add_heap(builder, spot, float(rng.uniform(1.2, 2.6)), rng)
    for a, b, turn in ((-17.0, -12.0, 0.2), (16.5, 12.5, 0.1), (-18.0, 11.5, 1.4)):
        add_container(builder, site.at(a, b, turn), rng)
    for _ in range(10):
        add_bush(builder, site.at(float(rng.choice([-1.0, 1.0]) * rng.uniform(15.0, 20.0)), float(rng.uniform(-14.0, 14.0))), rng)
    add_car(builder, site.at(17.5, -12.5, 0.7), rng)


def _scatter_trees(builder: MeshBuilder, site: _Site, rng: np.random.Generator, count: int) -> None:
    """Trees along the edge of a block."""
    for _ in range(count):
        a, b = float(rng.uniform(-20.0, 20.0)), float(rng.choice([-1.0, 1.0]) * rng.uniform(12.4, 14.2))
        add_tree(builder, site.at(a, b), float(rng.uniform(3.5, 7.5)), rng)


def _line_streets(builder: MeshBuilder, site: _Site, rng: np.random.Generator) -> None:
    """Parked cars and lamps along the lower and the left street of the block."""
    half_u, half_v = BLOCK_U_M / 2.0, BLOCK_V_M / 2.0
    for a in np.arange(-half_u + 12.0, half_u - 11.0, 6.2):
        if rng.random() < 0.42:
            add_car(builder, site.at(float(a), -half_v + 2.05, float(rng.normal(0.0, 0.02))), rng)
    for b in np.arange(-half_v + 12.0, half_v - 11.0, 6.2):
        if rng.random() < 0.42:
            add_car(builder, site.at(-half_u + 2.05, float(b), np.pi / 2 + float(rng.normal(0.0, 0.02))), rng)
    for a in np.arange(-half_u + 8.0, half_u - 6.0, LAMP_SPACING_M):
        add_lamp(builder, site.at(float(a), -half_v + 4.0, -np.pi / 2))


def _plant_surroundings(builder: MeshBuilder, layout: Layout) -> None:
    """Groups of trees on the meadows around the town."""
    rng = np.random.default_rng([layout.seed, 77])
    reach_m = np.hypot(*layout.extent_m) / 2.0 + TOWN_MARGIN_M
    for _ in range(26):
        distance, angle = float(rng.uniform(reach_m * 1.1, reach_m * 2.2)), float(rng.uniform(0.0, 2.0 * np.pi))
        for _ in range(int(rng.integers(2, 9))):
            offset = rng.normal(0.0, 7.0, 2)
            x, y = distance * np.cos(angle) + offset[0], distance * np.sin(angle) + offset[1]
            z = float(layout.height_m(np.array([x]), np.array([y]))[0])
            add_tree(builder, Placement(x=float(x), y=float(y), z=z, heading_rad=0.0), float(rng.uniform(6.0, 12.0)), rng)
