"""Triangles with what their surface needs to be painted: normals, texture coordinates, material,
colour, object number.

Built once per scene; the ray caster looks the attributes up by triangle number and barycentric
coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from scenegen.noise import Floats


class Material(IntEnum):
    """Which painter colours a triangle."""

    GROUND = 0
    WALL = 1
    TILES = 2
    FLAT_ROOF = 3
    PLAIN = 4
    GLASS = 5
    FOLIAGE = 6
    HEAP = 7


@dataclass(frozen=True, kw_only=True)
class Look:
    """How a piece is painted: its material, its base colour (3,) linear RGB, and its object's
    number."""

    material: Material
    tint: Floats
    number: int = 0


@dataclass(frozen=True, kw_only=True)
class Mesh:
    """Vertices (P,3) m with normals (P,3) and texture coordinates (P,2); triangles (T,3) with the
    parts of their look (T,…)."""

    vertices: Floats
    normals: Floats
    uvs: Floats
    triangles: NDArray[np.uint32]
    materials: NDArray[np.uint8]
    tints: Floats
    numbers: NDArray[np.int32]


@dataclass
class MeshBuilder:
    """Collects pieces; `build` joins them."""

    pieces: list[Mesh] = field(default_factory=list)
    num_vertices: int = 0

    def add(self, vertices: NDArray, triangles: NDArray, normals: NDArray, uvs: NDArray, look: Look) -> None:
        """Add an indexed piece: vertices (P,3), triangles (T,3), normals (P,3), uvs (P,2), one
        look."""
        self.pieces.append(
            Mesh(
                vertices=vertices.astype(np.float32),
                normals=normals.astype(np.float32),
                uvs=uvs.astype(np.float32),
                triangles=(triangles + self.num_vertices).astype(np.uint32),
                materials=np.full(len(triangles), look.material, np.uint8),
                tints=np.broadcast_to(look.tint, (len(triangles), 3)),
                numbers=np.full(len(triangles), look.number, np.int32),
            )
        )
        self.num_vertices += len(vertices)

    def add_polygon(self, corners: NDArray, uvs: NDArray, look: Look) -> None:
        """Add a flat convex polygon of corners (K,3) as a fan, with uvs (K,2)."""
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        normal = normal / np.linalg.norm(normal)
        fan = np.array([[0, k, k + 1] for k in range(1, len(corners) - 1)])
        self.add(corners, fan, np.broadcast_to(normal, corners.shape), uvs, look)

    def build(self) -> Mesh:
        """One mesh of everything added."""
        names = ("vertices", "normals", "uvs", "triangles", "materials", "tints", "numbers")
        return Mesh(**{name: np.concatenate([getattr(piece, name) for piece in self.pieces]) for name in names})


@dataclass(frozen=True, kw_only=True)
class Placement:
    """Where an object stands: the world position of its local origin and its heading."""

    x: float
    y: float
    z: float
    heading_rad: float

    def world(self, local: NDArray) -> NDArray:
        """World positions of local points (K,3)."""
        c, s = np.cos(self.heading_rad), np.sin(self.heading_rad)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return np.asarray(local, np.float64) @ turn.T + np.array([self.x, self.y, self.z])


def add_prism(builder: MeshBuilder, place: Placement, outline: tuple[NDArray, NDArray], z: tuple[float, float], look: Look) -> None:
    """Add the sides between a bottom and a top outline (K,2) at two heights; uvs are metres along
    and up."""
    bottom, top = (np.column_stack([line, np.full(len(line), height)]) for line, height in zip(outline, z, strict=True))
    for k in range(len(bottom)):
        n = (k + 1) % len(bottom)
        length, rise = float(np.linalg.norm(bottom[n] - bottom[k])), z[1] - z[0]
        uvs = np.array([[0.0, 0.0], [length, 0.0], [length, rise], [0.0, rise]])
        builder.add_polygon(place.world(np.array([bottom[k], bottom[n], top[n], top[k]])), uvs, look)


def rectangle(length: float, width: float) -> NDArray[np.float64]:
    """Corners (4,2) of a rectangle around the origin, counter-clockwise."""
    return np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array([length, width]) / 2.0


def add_box(builder: MeshBuilder, place: Placement, size_m: tuple[float, float], z: tuple[float, float], look: Look) -> None:
    """Add the sides and the top of a box of size_m between two heights."""
    outline = rectangle(*size_m)
    add_prism(builder, place, (outline, outline), z, look)
    add_lid(builder, place, outline, z[1], look)


def add_lid(builder: MeshBuilder, place: Placement, outline: NDArray, z: float, look: Look) -> None:
    """Add a flat horizontal polygon with outline (K,2) at height z; uvs are local metres."""
    builder.add_polygon(place.world(np.column_stack([outline, np.full(len(outline), z)])), outline, look)
