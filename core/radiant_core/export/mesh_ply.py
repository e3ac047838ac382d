"""A coloured triangle mesh as binary PLY for CloudCompare, MeshLab and Blender. Once per mesh."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from radiant_core.errors import BadInput
from radiant_core.io.run_store import atomic_writer
from radiant_core.numerics import check_array

_VERTEX = np.dtype([("position", "<f8", 3), ("color", "u1", 3)])
_FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


def save_mesh(path: Path, vertices: ArrayLike, triangles: ArrayLike, colors: ArrayLike, comments: Sequence[str] = ()) -> None:
    """Write vertices (V,3) as doubles, triangles (T,3) of their indices and colors (V,3) uint8,
    atomically, with lines of text in the header; BadInput for a misfit."""
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
    comment = "".join(f"comment {line}\n" for line in comments)
    header = f"ply\nformat binary_little_endian 1.0\n{comment}element vertex {len(rows)}\n{properties}element face {len(faces)}\n"
    with atomic_writer(path) as file:
        file.write(f"{header}property list uchar int vertex_indices\nend_header\n".encode())
        file.write(rows.tobytes())
        file.write(faces.tobytes())
