"""Houses with gabled roofs, flats with parapets and roof clutter, sheds: walls, roofs, chimneys,
dormers as meshes.

Built once per scene, a few dozen triangles each. Wall uvs are (window columns, metres above the
floor); roof uvs are metres along the ridge and up the slope.
"""

from __future__ import annotations

import numpy as np

from scenegen.ground import linear
from scenegen.mesh import Look, Material, MeshBuilder, Placement, add_box, add_lid, add_prism, rectangle
from scenegen.noise import Floats

WINDOW_SPACING_M = 2.5
EAVES_M, FOUNDATION_M = 0.45, 1.5
PLASTERS = [
    linear(*rgb)
    for rgb in (
        (0.93, 0.90, 0.82), (0.90, 0.78, 0.55), (0.85, 0.62, 0.50), (0.80, 0.83, 0.84),
        (0.72, 0.77, 0.68), (0.94, 0.94, 0.92), (0.70, 0.50, 0.42),
    )
]  # fmt: skip
TILE_TINTS = [linear(*rgb) for rgb in ((0.62, 0.40, 0.31), (0.54, 0.35, 0.29), (0.45, 0.37, 0.34), (0.37, 0.38, 0.41), (0.66, 0.48, 0.37))]
FLAT_TINTS = [linear(*rgb) for rgb in ((0.62, 0.61, 0.58), (0.48, 0.48, 0.48), (0.72, 0.70, 0.66), (0.55, 0.50, 0.45))]
METAL, BRICK, WHITE = linear(0.70, 0.71, 0.72), linear(0.55, 0.33, 0.27), linear(0.93, 0.93, 0.92)


def add_house(builder: MeshBuilder, place: Placement, size_m: tuple[float, float], rng: np.random.Generator) -> None:
    """Add a house of size_m (along the ridge, across) with a gabled roof, a chimney and perhaps a
    dormer and an annexe."""
    length, width = size_m
    number = int(rng.integers(1, 2**30))
    wall = Look(material=Material.WALL, tint=PLASTERS[rng.integers(len(PLASTERS))], number=number)
    tiles = Look(material=Material.TILES, tint=TILE_TINTS[rng.integers(len(TILE_TINTS))], number=number)
    eaves_z = float(rng.choice([3.0, 5.6]))
    ridge_z = eaves_z + width / 2.0 * float(rng.uniform(0.65, 0.95))
    _add_walls(builder, place, (length, width), eaves_z, wall)
    _add_gabled_roof(builder, place, (length, width), (eaves_z, ridge_z), (wall, tiles))
    chimney = _beside(place, float(rng.uniform(-0.3, 0.3)) * length, float(rng.choice([-1.0, 1.0])) * 0.9)
    add_box(builder, chimney, (0.9, 0.7), (eaves_z, ridge_z + 0.9), Look(material=Material.PLAIN, tint=BRICK))
    if rng.random() < 0.4:
        dormer = _beside(place, float(rng.uniform(-0.2, 0.2)) * length, 0.27 * width)
        _add_walls(builder, dormer, (2.2, 0.40 * width), eaves_z + 1.7, wall)
        add_lid(builder, dormer, rectangle(2.6, 0.46 * width), eaves_z + 1.75, Look(material=Material.PLAIN, tint=METAL))
    if rng.random() < 0.45:
        annexe = _beside(place, (length / 2.0 + 1.4), float(rng.uniform(-0.15, 0.15)) * width)
        _add_flat_block(builder, annexe, (2.9, 0.62 * width), 2.7, rng)


def add_flats(builder: MeshBuilder, place: Placement, size_m: tuple[float, float], rng: np.random.Generator) -> None:
    """Add a block of flats of size_m with a parapet, roof lights and machines on its roof."""
    height = float(rng.choice([8.6, 11.4]))
    _add_flat_block(builder, place, size_m, height, rng)
    for _ in range(int(rng.integers(3, 8))):
        offset = (rng.uniform(-0.4, 0.4, 2) * np.array(size_m)).tolist()
        machine = _beside(place, offset[0], offset[1])
        tint = METAL if rng.random() < 0.6 else WHITE
        look = Look(material=Material.PLAIN, tint=tint)
        size = (float(rng.uniform(0.8, 2.6)), float(rng.uniform(0.8, 1.8)))
        add_box(builder, machine, size, (height - 0.1, height + float(rng.uniform(0.4, 1.6))), look)


def add_shed(builder: MeshBuilder, place: Placement, rng: np.random.Generator) -> None:
    """Add a garden shed with a bright roof."""
    tint = tint_noise(FLAT_TINTS[rng.integers(len(FLAT_TINTS))], rng, 0.4)
    add_box(builder, place, (2.6, 2.0), (-FOUNDATION_M, 2.1), Look(material=Material.PLAIN, tint=BRICK))
    roof = Look(material=Material.FLAT_ROOF, tint=tint, number=int(rng.integers(1, 2**30)))
    add_lid(builder, place, rectangle(3.0, 2.4), 2.15, roof)


def _add_walls(builder: MeshBuilder, place: Placement, size_m: tuple[float, float], top_z: float, look: Look) -> None:
    """Four walls whose uvs count windows, a whole number on every side."""
    corners = rectangle(*size_m)
    for k in range(4):
        a, b = corners[k], corners[(k + 1) % 4]
        columns = max(1, round(float(np.linalg.norm(b - a)) / WINDOW_SPACING_M))
        quad = np.array([[*a, -FOUNDATION_M], [*b, -FOUNDATION_M], [*b, top_z], [*a, top_z]])
        uvs = np.array([[0.0, -FOUNDATION_M], [columns, -FOUNDATION_M], [columns, top_z], [0.0, top_z]])
        builder.add_polygon(place.world(quad), uvs, look)


def _add_gabled_roof(
    builder: MeshBuilder, place: Placement, size_m: tuple[float, float], z: tuple[float, float], looks: tuple[Look, Look]
) -> None:
    """Two gable triangles and two slopes that hang over by the eaves; z are the heights of eaves
    and ridge."""
    (length, width), (eaves_z, ridge_z), (wall, tiles) = size_m, z, looks
    fall = (ridge_z - eaves_z) / (width / 2.0)
    half_l, half_w, low_z = length / 2.0 + EAVES_M, width / 2.0 + EAVES_M, eaves_z - EAVES_M * fall
    slope_m = float(np.hypot(half_w, ridge_z - low_z))
    for side in (-1.0, 1.0):
        x, y = side * length / 2.0, side * half_w
        gable = np.array([[x, -width / 2, eaves_z], [x, width / 2, eaves_z], [x, 0, ridge_z]])
        builder.add_polygon(place.world(gable), np.array([[0.0, 0.2], [0.0, 0.2], [0.0, 0.2]]), wall)
        slope = np.array([[-half_l, y, low_z], [half_l, y, low_z], [half_l, 0, ridge_z], [-half_l, 0, ridge_z]])
        low = 50.0 * (side > 0)
        uvs = np.array([[-half_l, low], [half_l, low], [half_l, low + slope_m], [-half_l, low + slope_m]])
        # Lifted by a hand's breadth so that gables and walls do not show through.
        builder.add_polygon(place.world(slope + np.array([0.0, 0.0, 0.08])), uvs, tiles)


def _add_flat_block(builder: MeshBuilder, place: Placement, size_m: tuple[float, float], height: float, rng: np.random.Generator) -> None:
    """Walls, a parapet and a gravelled or felted roof below its rim."""
    number = int(rng.integers(1, 2**30))
    wall = Look(material=Material.WALL, tint=PLASTERS[rng.integers(len(PLASTERS))], number=number)
    roof = Look(material=Material.FLAT_ROOF, tint=FLAT_TINTS[rng.integers(len(FLAT_TINTS))], number=number)
    outer, inner = rectangle(*size_m), rectangle(size_m[0] - 0.6, size_m[1] - 0.6)
    rim = Look(material=Material.PLAIN, tint=METAL)
    _add_walls(builder, place, size_m, height, wall)
    add_prism(builder, place, (outer, outer), (height, height + 0.45), rim)
    add_prism(builder, place, (outer, inner), (height + 0.45, height + 0.451), rim)
    add_prism(builder, place, (inner, inner), (height, height + 0.45), rim)
    add_lid(builder, place, inner, height + 0.02, roof)


def _beside(place: Placement, along: float, across: float) -> Placement:
    """A placement moved in its own axes."""
    x, y, z = place.world(np.array([[along, across, 0.0]]))[0]
    return Placement(x=float(x), y=float(y), z=float(z), heading_rad=place.heading_rad)


def tint_noise(tint: Floats, rng: np.random.Generator, spread: float) -> Floats:
    """A colour made brighter or darker by up to spread, each channel a little differently."""
    return (tint * (1.0 + rng.uniform(-spread, spread) + rng.uniform(-spread, spread, 3) / 4.0)).astype(np.float32)
