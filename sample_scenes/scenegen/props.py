"""Trees, hedges, parked cars, heaps of gravel, containers, lamp posts: what stands between the
houses, as meshes.

Built once per scene. A tree's crown is a sphere whose radius is displaced by noise; its leaves come
from the painter.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenegen.buildings import FOUNDATION_M, METAL, tint_noise
from scenegen.ground import linear
from scenegen.mesh import Look, Material, MeshBuilder, Placement, add_lid, add_prism, rectangle
from scenegen.noise import Floats, value_noise

LEAVES = [linear(*rgb) for rgb in ((0.30, 0.40, 0.19), (0.38, 0.46, 0.22), (0.24, 0.35, 0.19), (0.45, 0.45, 0.22), (0.33, 0.42, 0.28))]
PAINTS = [
    linear(*rgb)
    for rgb in (
        (0.92, 0.92, 0.92), (0.75, 0.76, 0.78), (0.20, 0.21, 0.23), (0.45, 0.46, 0.49), (0.62, 0.20, 0.18),
        (0.22, 0.30, 0.46), (0.83, 0.72, 0.25), (0.25, 0.40, 0.33),
    )
]  # fmt: skip
CONTAINERS = [linear(0.70, 0.45, 0.28), linear(0.28, 0.40, 0.54), linear(0.60, 0.28, 0.25), linear(0.30, 0.50, 0.36)]
BARK, CAR_GLASS, HEAPS = linear(0.34, 0.28, 0.22), linear(0.14, 0.17, 0.20), [linear(0.70, 0.66, 0.58), linear(0.52, 0.50, 0.48)]


def add_tree(builder: MeshBuilder, place: Placement, height_m: float, rng: np.random.Generator) -> None:
    """Add a broad or a slender tree of height_m."""
    slender = rng.random() < 0.25
    radius = height_m * (0.17 if slender else 0.32) * float(rng.uniform(0.85, 1.15))
    crown_half = height_m * (0.43 if slender else 0.36)
    look = _leafy(LEAVES[rng.integers(len(LEAVES))], rng)
    center = np.array([place.x, place.y, place.z + height_m - crown_half])
    _add_blob(builder, center, np.array([radius, radius, crown_half]), look)
    trunk = rectangle(0.35, 0.35)
    bark = Look(material=Material.PLAIN, tint=BARK)
    add_prism(builder, place, (trunk, trunk), (-0.5, height_m - crown_half), bark)


def add_bush(builder: MeshBuilder, place: Placement, rng: np.random.Generator) -> None:
    """Add a round bush of knee to shoulder height."""
    radius = float(rng.uniform(0.5, 1.3))
    look = _leafy(LEAVES[rng.integers(len(LEAVES))], rng)
    _add_blob(builder, np.array([place.x, place.y, place.z + 0.4 * radius]), np.array([radius, radius, 0.8 * radius]), look)


def add_hedge(builder: MeshBuilder, place: Placement, length_m: float, rng: np.random.Generator) -> None:
    """Add a clipped hedge of length_m."""
    bottom, top = rectangle(length_m, 0.9), rectangle(length_m - 0.2, 0.6)
    look = _leafy(LEAVES[0], rng)
    add_prism(builder, place, (bottom, top), (-FOUNDATION_M, 1.2), look)
    add_lid(builder, place, top, 1.2, look)


def add_car(builder: MeshBuilder, place: Placement, rng: np.random.Generator) -> None:
    """Add a car: body, tapered cabin of glass, roof in the body's paint."""
    paint = Look(material=Material.PLAIN, tint=tint_noise(PAINTS[rng.integers(len(PAINTS))], rng, 0.15))
    glass = Look(material=Material.GLASS, tint=CAR_GLASS)
    length = float(rng.uniform(3.8, 4.9))
    body, belt = rectangle(length, 1.8), rectangle(length - 0.15, 1.74)
    roof = rectangle(0.42 * length, 1.36) + np.array([-0.06 * length, 0.0])
    cabin = rectangle(0.62 * length, 1.62) + np.array([-0.06 * length, 0.0])
    add_prism(builder, place, (body, body), (0.25, 0.7), paint)
    add_prism(builder, place, (body, belt), (0.7, 0.9), paint)
    add_lid(builder, place, belt, 0.9, paint)
    add_prism(builder, place, (cabin, roof), (0.9, 1.48), glass)
    add_lid(builder, place, roof, 1.48, paint)


def add_heap(builder: MeshBuilder, place: Placement, radius_m: float, rng: np.random.Generator) -> None:
    """Add a heap of gravel."""
    look = Look(material=Material.HEAP, tint=HEAPS[rng.integers(len(HEAPS))], number=int(rng.integers(1, 2**30)))
    center = np.array([place.x, place.y, place.z - 0.2 * radius_m])
    _add_blob(builder, center, radius_m * np.array([1.0, 1.0, 0.9]), look)


def add_container(builder: MeshBuilder, place: Placement, rng: np.random.Generator) -> None:
    """Add a shipping container."""
    outline = rectangle(6.1, 2.4)
    look = Look(material=Material.FLAT_ROOF, tint=CONTAINERS[rng.integers(len(CONTAINERS))], number=int(rng.integers(1, 2**30)))
    add_prism(builder, place, (outline, outline), (-0.3, 2.5), look)
    add_lid(builder, place, outline, 2.5, look)


def add_lamp(builder: MeshBuilder, place: Placement) -> None:
    """Add a street lamp whose arm points along its heading."""
    post, arm = rectangle(0.18, 0.18), rectangle(1.6, 0.3) + np.array([0.7, 0.0])
    look = Look(material=Material.PLAIN, tint=METAL)
    add_prism(builder, place, (post, post), (-0.3, 6.0), look)
    add_prism(builder, place, (arm, arm), (6.0, 6.15), look)
    add_lid(builder, place, arm, 6.15, look)


def _leafy(tint: Floats, rng: np.random.Generator) -> Look:
    return Look(material=Material.FOLIAGE, tint=tint_noise(tint, rng, 0.2), number=int(rng.integers(1, 2**30)))


def _add_blob(builder: MeshBuilder, center: NDArray, radii: NDArray, look: Look) -> None:
    """Add an ellipsoid with radii (3,) whose surface is displaced by ± 30 % in lumps of a third of
    its size."""
    num_rings, num_sides = (14, 22) if float(radii.max()) > 1.5 else (8, 12)
    polar, around = np.meshgrid(np.linspace(0.0, np.pi, num_rings), 2.0 * np.pi * np.arange(num_sides) / num_sides, indexing="ij")
    unit = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=-1).reshape(-1, 3)
    at = (unit * radii + center).astype(np.float32)
    lump_m = float(radii.max()) * 0.55
    lumps = value_noise(at[:, 0] + 0.7 * at[:, 2], at[:, 1] - 0.8 * at[:, 2], lump_m, look.number % 997) - 0.5
    lumps += 0.5 * (value_noise(at[:, 0] - 0.9 * at[:, 2], at[:, 1] + 0.6 * at[:, 2], 0.4 * lump_m, look.number % 991) - 0.5)
    vertices = center + unit * radii * (1.0 + 0.8 * lumps[:, None])
    normals = unit / radii
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    builder.add(vertices, _ring_triangles(num_rings, num_sides), normals, np.zeros((len(unit), 2)), look)


def _ring_triangles(num_rings: int, num_sides: int) -> NDArray[np.int64]:
    """Triangles (T,3) of a closed grid of rings of vertices."""
    ring, side = np.meshgrid(np.arange(num_rings - 1), np.arange(num_sides), indexing="ij")
    here, beside = (ring * num_sides + side).ravel(), (ring * num_sides + (side + 1) % num_sides).ravel()
    upper = np.column_stack([here, beside, here + num_sides])
    lower = np.column_stack([beside, beside + num_sides, here + num_sides])
    return np.concatenate([upper, lower])
