"""Gaussians as binary glTF 2.0 with KHR_gaussian_splatting (release candidate of 2026). Once per
tile.

One primitive of POINTS, of one of two forms, which no reader shares. CesiumJS 1.139 to 1.145 draws
the second alone.
    plain  POSITION, and under the extension's name ROTATION (xyzw, of length 1), SCALE (standard
           deviations, linear: drafts before February 2026 had their logarithms), OPACITY (0 to 1)
           and SH_DEGREE_l_COEF_n
    spz    an SPZ of version 2 (`io.spz`) in a buffer view that the child extension
           KHR_gaussian_splatting_compression_spz_2 names; the attributes have no buffers. As
           CesiumJS 1.139 to 1.145 wants it, opacity and base colour are COLOR_0, of bytes: with
           the extension's own names beside it, it loses the harmonics.
glTF is y up: positions, rotations and harmonics of a z-up model are turned, (x, y, z) → (x, z, −y).
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiant_core import __version__
from radiant_core.choices import TileContent
from radiant_core.errors import BadInput
from radiant_core.frames import Sim3
from radiant_core.geometry.similarity import move_splats
from radiant_core.io.spz import fraction_bits_for, gzip_spz_bytes
from radiant_core.numerics import FloatArray, unit_quats
from radiant_core.splats import Splats

EXTENSION = "KHR_gaussian_splatting"
COMPRESSION = f"{EXTENSION}_compression_spz_2"
EXTENSIONS: dict[TileContent, list[str]] = {"spz": [EXTENSION, COMPRESSION], "plain": [EXTENSION]}
"""What a reader must know of each form."""
GLTF_FROM_WORLD = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
_BYTE, _FLOAT, _POINTS, _ARRAY_BUFFER = 5121, 5126, 0, 34962
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
_LOOK = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display", "projection": "perspective", "sortingMethod": "cameraDistance"}


def glb_bytes(splats: Splats, origin: FloatArray | None = None, form: TileContent = "plain") -> bytes:
    """At least one Gaussian of a z-up model as GLB, about `origin` (3,) m, which becomes 0."""
    if not len(splats):
        raise BadInput("a model without Gaussians cannot be a GLB: leave the tile out.")
    middle = np.zeros(3) if origin is None else origin
    # About the origin in float64 first: float32 keeps 6 cm at 1,000 km.
    turned = move_splats(splats, Sim3(scale=1.0, rotation=GLTF_FROM_WORLD, translation=-GLTF_FROM_WORLD @ middle))
    return _compressed(turned) if form == "spz" else _plain(turned)


def _plain(splats: Splats) -> bytes:
    arrays = _attributes(splats)
    accessors, views, offset = [], [], 0
    for name, array in arrays.items():
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": array.nbytes, "target": _ARRAY_BUFFER})
        accessors.append({"bufferView": len(views) - 1, **_accessor(name, array.shape[1] if array.ndim == 2 else 1, splats)})
        offset += array.nbytes
    return _packed("plain", _LOOK, dict(zip(arrays, accessors, strict=True)), views, b"".join(array.tobytes() for array in arrays.values()))


def _compressed(splats: Splats) -> bytes:
    data = gzip_spz_bytes(splats, 2, fraction_bits_for(splats))
    widths = {"POSITION": 3, "COLOR_0": 4, f"{EXTENSION}:ROTATION": 4, f"{EXTENSION}:SCALE": 3}
    widths |= dict.fromkeys(_harmonics(splats.sh_degree), 3)
    accessors = {name: _accessor(name, width, splats) for name, width in widths.items()}
    accessors["COLOR_0"] |= {"componentType": _BYTE, "normalized": True}
    look = {**_LOOK, "extensions": {COMPRESSION: {"bufferView": 0}}}
    return _packed("spz", look, accessors, [{"buffer": 0, "byteLength": len(data)}], data)


def _accessor(name: str, width: int, splats: Splats) -> dict[str, Any]:
    box = {"min": splats.means.min(axis=0).tolist(), "max": splats.means.max(axis=0).tolist()} if name == "POSITION" else {}
    return {"componentType": _FLOAT, "count": len(splats), "type": _TYPES[width], **box}


def _harmonics(degree: int) -> list[str]:
    """Names of the harmonics above degree 0, in the order of shN."""
    return [f"{EXTENSION}:SH_DEGREE_{band}_COEF_{number}" for band in range(1, degree + 1) for number in range(2 * band + 1)]


def _attributes(splats: Splats) -> dict[str, NDArray[np.float32]]:
    with np.errstate(over="ignore"):
        scales = np.exp(splats.log_scales.astype(np.float64)).astype(np.float32)
    if not np.isfinite(scales).all():
        raise BadInput("a Gaussian is larger than float32 can say, 3e38 m: clean the model first.")
    return {
        "POSITION": splats.means,
        f"{EXTENSION}:ROTATION": unit_quats(splats.quats)[:, [1, 2, 3, 0]].astype(np.float32),
        f"{EXTENSION}:SCALE": scales,
        f"{EXTENSION}:OPACITY": splats.opacities.astype(np.float32),
        f"{EXTENSION}:SH_DEGREE_0_COEF_0": splats.sh0[:, 0],
        **{name: splats.shN[:, number] for number, name in enumerate(_harmonics(splats.sh_degree))},
    }


def _packed(form: TileContent, look: dict[str, Any], accessors: dict[str, Any], views: list[dict[str, Any]], binary: bytes) -> bytes:
    primitive = {"attributes": {name: number for number, name in enumerate(accessors)}, "mode": _POINTS, "extensions": {EXTENSION: look}}
    content = {
        "asset": {"version": "2.0", "generator": f"radiant {__version__}"},
        "extensionsUsed": EXTENSIONS[form],
        # Without the compression there is nothing to draw. Plain ones are points for a reader that
        # does not know the extension.
        **({"extensionsRequired": EXTENSIONS[form]} if form == "spz" else {}),
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": list(accessors.values()),
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    }
    text = json.dumps(content, allow_nan=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
