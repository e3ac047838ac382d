"""A furnished room from inside: walls with hardly any texture, shelves of books, two lamps, and a
window through which the sky shines.

    light = ambient + Σ over lamps of strength · max(0, n·l) / distance² · visible

Cameras stand in the middle of the room and look outwards, all around: neighbours see the same wall
from nearly the same place, and what is behind the window is infinitely far.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from scenegen.config import SceneConfig
from scenegen.ground import linear
from scenegen.mesh import Look, Material, Mesh, MeshBuilder, Placement, add_box
from scenegen.noise import Floats
from scenegen.props import PAINTS, add_bush

ROOM_M = np.array([7.0, 5.2, 2.8])
WINDOW_X_M, WINDOW_Z_M = (-0.9, 1.3), (0.9, 2.2)
LAMPS_M = np.array([[-1.7, 0.4, 2.5], [1.9, -0.5, 2.5]], np.float32)
LAMP_STRENGTH = np.array([2.6, 2.4, 2.1], np.float32)
ROOM_AMBIENT = np.array([0.30, 0.30, 0.32], np.float32)
PLASTER, CEILING, STONE = linear(0.86, 0.83, 0.76), linear(0.92, 0.92, 0.90), linear(0.66, 0.60, 0.52)
BOARDS, WOOD, CLOTH = linear(0.62, 0.46, 0.32), linear(0.50, 0.35, 0.24), linear(0.35, 0.42, 0.50)
PITCHES_DEG = (0.0, -18.0, 12.0)
GOLDEN_TURN = 0.3819660112501051


def room_mesh(seed: int) -> Mesh:
    """Walls, floor, ceiling and furniture around the origin, the floor at height 0."""
    rng = np.random.default_rng([seed, 78])
    builder = MeshBuilder()
    _add_shell(builder)
    _add_shelves(builder, rng)
    _add_picture(builder, (-3.3, -1.9), (1.1, 1.9), 2.58, rng)
    _add_picture(builder, (2.0, 3.2), (1.2, 1.9), 2.58, rng)
    _add_picture(builder, (-2.6, -0.4), (1.0, 2.0), -2.58, rng)
    _add_furniture(builder, rng)
    return builder.build()


def room_views(config: SceneConfig, rng: np.random.Generator) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Centre (3,) and viewing direction (3,) of every photograph: turns by the golden angle, from
    places within the middle of the room."""
    for k in range(config.num_cameras):
        heading = 2.0 * np.pi * GOLDEN_TURN * k + rng.uniform(-0.1, 0.1)
        pitch = np.deg2rad(PITCHES_DEG[k % len(PITCHES_DEG)] + rng.uniform(-4.0, 4.0))
        center = np.array([*(rng.uniform(-0.22, 0.22, 2) * ROOM_M[:2]), rng.uniform(1.3, 1.8)])
        yield center, np.array([np.cos(heading) * np.cos(pitch), np.sin(heading) * np.cos(pitch), np.sin(pitch)])


def lamp_light(points: Floats, normals: Floats) -> Iterator[tuple[Floats, Floats]]:
    """For each lamp the way (N,3) from points (N,3) to it, and its light (N,3) there where nothing
    is between."""
    for lamp in LAMPS_M:
        way = lamp - points
        distance = np.linalg.norm(way, axis=1)
        facing = np.maximum(np.einsum("nc,nc->n", way, normals), 0.0) / distance
        yield way, LAMP_STRENGTH * (facing / np.maximum(distance, 0.4) ** 2)[:, None]


def _add_shell(builder: MeshBuilder) -> None:
    x, y, height = ROOM_M[0] / 2, ROOM_M[1] / 2, ROOM_M[2]
    plaster, stone = Look(material=Material.PLAIN, tint=PLASTER), Look(material=Material.HEAP, tint=STONE)
    _add_quad(builder, [(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)], Look(material=Material.FLAT_ROOF, tint=BOARDS, number=5))
    _add_quad(builder, [(-x, -y, height), (x, -y, height), (x, y, height), (-x, y, height)], Look(material=Material.PLAIN, tint=CEILING))
    _add_quad(builder, [(-x, -y, 0), (-x, y, 0), (-x, y, height), (-x, -y, height)], stone)
    _add_quad(builder, [(x, -y, 0), (x, y, 0), (x, y, height), (x, -y, height)], plaster)
    _add_quad(builder, [(-x, -y, 0), (x, -y, 0), (x, -y, height), (-x, -y, height)], plaster)
    (left, right), (low, high) = WINDOW_X_M, WINDOW_Z_M
    for a, b, c, d in ((-x, left, 0, height), (right, x, 0, height), (left, right, 0, low), (left, right, high, height)):
        _add_quad(builder, [(a, y, c), (b, y, c), (b, y, d), (a, y, d)], plaster)


def _add_shelves(builder: MeshBuilder, rng: np.random.Generator) -> None:
    """Five shelves along the eastern wall, filled with books of all colours."""
    wood, x = Look(material=Material.PLAIN, tint=WOOD), ROOM_M[0] / 2
    for level in range(5):
        z = 0.25 + 0.42 * level
        add_box(builder, _at(x - 0.15, 0.0), (0.30, 3.6), (z - 0.03, z), wood)
        y = -1.75
        while y < 1.7:
            width, tall = float(rng.uniform(0.03, 0.10)), float(rng.uniform(0.20, 0.35))
            book = Look(material=Material.PLAIN, tint=(rng.uniform(0.02, 0.7, 3)).astype(np.float32))
            add_box(builder, _at(x - 0.14, y + width / 2), (float(rng.uniform(0.16, 0.24)), width), (z, z + tall), book)
            y += width + (0.25 if rng.random() < 0.06 else 0.005)


def _add_picture(builder: MeshBuilder, across: tuple[float, float], up: tuple[float, float], y: float, rng: np.random.Generator) -> None:
    """A framed picture of patches on the wall at y, a hand's breadth before it."""
    tints = rng.uniform(0.03, 0.8, (5, 6, 3)).astype(np.float32)
    columns, rows = np.linspace(*across, 7), np.linspace(*up, 6)
    for row in range(5):
        for column in range(6):
            (a, b), (c, d) = columns[column : column + 2], rows[row : row + 2]
            look = Look(material=Material.PLAIN, tint=tints[row, column])
            _add_quad(builder, [(a, y, c), (b, y, c), (b, y, d), (a, y, d)], look)


def _add_furniture(builder: MeshBuilder, rng: np.random.Generator) -> None:
    wood, cloth = Look(material=Material.PLAIN, tint=WOOD), Look(material=Material.HEAP, tint=CLOTH)
    add_box(builder, _at(-0.3, -0.2), (1.8, 0.9), (0.70, 0.75), wood)
    for x, y in ((-1.1, -0.6), (0.5, -0.6), (-1.1, 0.2), (0.5, 0.2)):
        add_box(builder, _at(x, y), (0.07, 0.07), (0.0, 0.70), wood)
    for x, y in ((-0.8, 0.7), (0.3, 0.8), (-0.7, -1.1), (0.4, -1.0)):
        chair = Look(material=Material.PLAIN, tint=PAINTS[rng.integers(len(PAINTS))])
        add_box(builder, _at(x, y, float(rng.uniform(-0.4, 0.4))), (0.42, 0.42), (0.40, 0.46), chair)
        add_box(builder, _at(x, y + 0.2 * np.sign(y)), (0.42, 0.05), (0.46, 0.95), chair)
    add_box(builder, _at(1.9, -2.1), (2.0, 0.9), (0.0, 0.42), cloth)
    add_box(builder, _at(1.9, -2.45), (2.0, 0.25), (0.42, 0.9), cloth)
    for k in range(9):
        thing = Look(material=Material.PLAIN, tint=PAINTS[rng.integers(len(PAINTS))])
        x, y = (float(value) for value in rng.uniform(-0.4, 0.4, 2) * (1.6, 0.7) + (-0.3, -0.2))
        size = float(rng.uniform(0.06, 0.22))
        add_box(builder, _at(x, y, 0.3 * k), (size, size), (0.75, 0.75 + float(rng.uniform(0.05, 0.28))), thing)
    add_bush(builder, _at(-2.9, 2.0), rng)


def _at(x: float, y: float, heading_rad: float = 0.0) -> Placement:
    return Placement(x=x, y=y, z=0.0, heading_rad=heading_rad)


def _add_quad(builder: MeshBuilder, corners: list[tuple[float, float, float]], look: Look) -> None:
    """A rectangle whose uvs are metres from its first corner."""
    places = np.array(corners, np.float64)
    width, height = np.linalg.norm(places[1] - places[0]), np.linalg.norm(places[3] - places[0])
    builder.add_polygon(places, np.array([[0, 0], [width, 0], [width, height], [0, height]]), look)
