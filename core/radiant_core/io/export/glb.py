"""Gaussians as binary glTF 2.0 with KHR_gaussian_splatting (release candidate of 2026). Once per
tile.

One primitive of POINTS: POSITION, and under the extension's name ROTATION (xyzw, of length 1),
SCALE (standard deviations, linear: drafts before February 2026 had their logarithms), OPACITY (0 to
1) and SH_DEGREE_l_COEF_n. glTF is y up: positions, rotations and harmonics of a z-up model are
turned, (x, y, z) → (x, z, −y).
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiant_core import __version__
from radiant_core.errors import BadInput
from radiant_core.frames import Sim3
from radiant_core.geometry.similarity import move_splats
from radiant_core.numerics import FloatArray, unit_quats
from radiant_core.splats import Splats

EXTENSION = "KHR_gaussian_splatting"
GLTF_FROM_WORLD = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
_FLOAT, _POINTS, _ARRAY_BUFFER = 5126, 0, 34962
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}


def glb_bytes(splats: Splats, origin: FloatArray | None = None) -> bytes:
    """At least one Gaussian of a z-up model as GLB, about `origin` (3,) m, which becomes 0."""
    if not len(splats):
        raise BadInput("a model without Gaussians cannot be a GLB: leave the tile out.")
    middle = np.zeros(3) if origin is None else origin
    # About the origin in float64 first: float32 keeps 6 cm at 1,000 km.
    turned = move_splats(splats, Sim3(scale=1.0, rotation=GLTF_FROM_WORLD, translation=-GLTF_FROM_WORLD @ middle))
    arrays = _attributes(turned)
    accessors, views, parts, offset = [], [], [], 0
    for name, array in arrays.items():
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": array.nbytes, "target": _ARRAY_BUFFER})
        width = array.shape[1] if array.ndim == 2 else 1
        accessors.append({"bufferView": len(views) - 1, "componentType": _FLOAT, "count": len(splats), "type": _TYPES[width]})
        if name == "POSITION":
            accessors[-1] |= {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
        parts.append(array.tobytes())
        offset += array.nbytes
    extension = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display", "projection": "perspective", "sortingMethod": "cameraDistance"}
    primitive = {
        "attributes": {name: number for number, name in enumerate(arrays)},
        "mode": _POINTS,
        "extensions": {EXTENSION: extension},
    }
    content = {
        "asset": {"version": "2.0", "generator": f"radiant {__version__}"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": offset}],
    }
    return _packed(content, b"".join(parts))


def _attributes(splats: Splats) -> dict[str, NDArray[np.float32]]:
    with np.errstate(over="ignore"):
        scales = np.exp(splats.log_scales.astype(np.float64)).astype(np.float32)
    if not np.isfinite(scales).all():
        raise BadInput("a Gaussian is larger than float32 can say, 3e38 m: clean the model first.")
    harmonics = {f"{EXTENSION}:SH_DEGREE_0_COEF_0": splats.sh0[:, 0]}
    for degree in range(1, splats.sh_degree + 1):
        for number in range(2 * degree + 1):
            harmonics[f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{number}"] = splats.shN[:, degree**2 - 1 + number]
    return {
        "POSITION": splats.means,
        f"{EXTENSION}:ROTATION": unit_quats(splats.quats)[:, [1, 2, 3, 0]].astype(np.float32),
        f"{EXTENSION}:SCALE": scales,
        f"{EXTENSION}:OPACITY": splats.opacities.astype(np.float32),
        **harmonics,
    }


def _packed(content: dict[str, Any], binary: bytes) -> bytes:
    text = json.dumps(content, allow_nan=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
