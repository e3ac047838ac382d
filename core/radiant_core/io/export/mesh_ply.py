"""A coloured triangle mesh as binary PLY, as CloudCompare, MeshLab and Blender open it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from radiant_core.errors import BadInput
from radiant_core.io.run_store import atomic_writer
from radiant_core.numerics import check_array

_VERTEX = np.dtype([("position", "<f8", 3), ("color", "u1", 3)])
_FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


def save_mesh(path: Path, vertices: ArrayLike, triangles: ArrayLike, colors: ArrayLike) -> None:
    """Write vertices (V,3), triangles (T,3), colors (V,3) uint8, atomically; BadInput if unfit."""
    positions = check_array("vertices", vertices, (None, 3))
    corners = check_array("triangles", triangles, (None, 3), np.int64)
    shades = check_array("colors", colors, (len(positions), 3), np.uint8)
    if len(corners) and not (corners.min() >= 0 and corners.max() < len(positions)):
        raise BadInput(f"a triangle names vertex {int(corners.max())} of {len(positions)}: check the indices.")
    rows = np.zeros(len(positions), _VERTEX)
    rows["position"], rows["color"] = positions, shades
    faces = np.zeros(len(corners), _FACE)
    faces["count"], faces["corners"] = 3, corners
    properties = "".join(f"property double {axis}\n" for axis in "xyz") + "".join(f"property uchar {c}\n" for c in ("red", "green", "blue"))
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n{properties}element face {len(faces)}\n"
    with atomic_writer(path) as file:
        file.write(f"{header}property list uchar int vertex_indices\nend_header\n".encode())
        file.write(rows.tobytes())
        file.write(faces.tobytes())
