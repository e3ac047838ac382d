"""The fronts of three houses in a row across a street: one plane with balconies, and the sky.

Passes along the row at the heights of an eye, a ladder and a mast, looking straight at it and to
either side by turns. Nothing is seen from behind, and above the roofs there is sky alone.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from scenegen.buildings import METAL, add_flats
from scenegen.config import SceneConfig
from scenegen.ground import linear
from scenegen.mesh import Look, Material, Mesh, MeshBuilder, Placement, add_box, add_lid, rectangle
from scenegen.props import add_bush, add_car

HOUSE_M = (13.0, 9.0)
NUM_HOUSES = 3
DISTANCE_M = 13.0
HEIGHTS_M = (1.7, 5.0, 8.5)
TURNS_DEG = (0.0, 25.0, -25.0)
STREET, GROUND_REACH_M = linear(0.47, 0.46, 0.45), 250.0


def facade_mesh(seed: int) -> Mesh:
    """Houses whose fronts stand on the x axis and look to the south, the street before them."""
    rng = np.random.default_rng([seed, 79])
    builder = MeshBuilder()
    side = 2 * GROUND_REACH_M
    add_lid(builder, _at(0.0, 0.0), rectangle(side, side), 0.0, Look(material=Material.HEAP, tint=STREET))
    for house in range(NUM_HOUSES):
        x = (house - (NUM_HOUSES - 1) / 2) * HOUSE_M[0]
        add_flats(builder, _at(x, HOUSE_M[1] / 2), HOUSE_M, rng)
        _add_balconies(builder, x, rng)
    for x in (-11.0, 4.0, 13.5):
        add_car(builder, _at(x, -3.0 + float(rng.uniform(-0.3, 0.3))), rng)
    for x in (-16.0, -5.0, 0.5, 9.0):
        add_bush(builder, _at(x, -0.9), rng)
    return builder.build()


def facade_views(config: SceneConfig, rng: np.random.Generator) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Centre (3,) and viewing direction (3,) of every photograph, pass after pass."""
    half = NUM_HOUSES * HOUSE_M[0] / 2 - 3.0
    passes = np.array_split(np.arange(config.num_cameras), min(len(HEIGHTS_M), config.num_cameras))
    for number, part in enumerate(passes):
        for k in range(len(part)):
            x = half * (2.0 * (k + 0.5) / len(part) - 1.0) * (-1.0) ** number
            center = np.array([x, -DISTANCE_M + rng.uniform(-0.8, 0.8), HEIGHTS_M[number] + rng.uniform(-0.2, 0.2)])
            turn = np.deg2rad(TURNS_DEG[k % len(TURNS_DEG)] + rng.uniform(-3.0, 3.0))
            yield center, np.array([np.sin(turn), np.cos(turn), (4.5 - center[2]) / DISTANCE_M])


def _add_balconies(builder: MeshBuilder, x: float, rng: np.random.Generator) -> None:
    for storey in (1, 2):
        for aside in (-3.8, 0.0, 3.8):
            if rng.random() < 0.7:
                low = 2.8 * storey
                place = _at(x + aside, -0.6)
                add_box(builder, place, (2.4, 1.2), (low - 0.15, low), Look(material=Material.PLAIN, tint=METAL))
                rail = Look(material=Material.PLAIN, tint=rng.uniform(0.1, 0.6, 3).astype(np.float32))
                add_box(builder, _at(x + aside, -1.17), (2.4, 0.06), (low, low + 0.9), rail)


def _at(x: float, y: float) -> Placement:
    return Placement(x=x, y=y, z=0.0, heading_rad=0.0)
