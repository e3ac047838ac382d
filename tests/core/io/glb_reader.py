"""GLB files of strangers with KHR_gaussian_splatting as models, z up. Once per file.

Strict: the two layouts that `export.glb` writes, a primitive of POINTS with float attributes,
each accessor inside the file, or with one SPZ, whose count and degree the attributes repeat.
"""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logit  # pyright: ignore[reportMissingTypeStubs]

from radiant_core.errors import BadInput
from radiant_core.export.glb import COMPRESSION, EXTENSION, GLTF_FROM_WORLD
from radiant_core.frames import Sim3
from radiant_core.geometry.similarity import move_splats
from radiant_core.io.run_store import parse_json, read_bounded
from radiant_core.io.spz import splats_from_gzip_spz
from radiant_core.splats import SH_BASES, Splats

MAX_BYTES, MAX_JSON_BYTES = 1 << 32, 1 << 24
_WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
_END_OPACITY = 1e-7


def load_glb(path: Path) -> Splats:
    """The Gaussians of a GLB, turned back to z up; BadInput, which names the file, for any other
    content."""
    try:
        return _splats(read_bounded(path, MAX_BYTES))
    except (ValueError, RecursionError) as error:
        reason = "it is nested too deeply" if isinstance(error, RecursionError) else str(error).rstrip(".")
        raise BadInput(f"cannot use {path}: {reason}: export it as GLB with {EXTENSION}.") from error


def _splats(data: bytes) -> Splats:
    content, binary = _chunks(data)
    try:
        primitive = content["meshes"][0]["primitives"][0]
        attributes, extension, mode = primitive["attributes"], primitive["extensions"][EXTENSION], primitive["mode"]
        accessors, views = content["accessors"], content["bufferViews"]
    except (KeyError, IndexError, TypeError) as error:
        raise BadInput(f"it has no mesh of {EXTENSION}") from error
    if mode != 0 or not isinstance(extension, dict) or extension.get("kernel") != "ellipse" or not isinstance(attributes, dict):
        raise BadInput("its mesh is no set of points with ellipses")
    children = extension.get("extensions", {})
    if isinstance(children, dict) and COMPRESSION in children:
        return _upright(_compressed(children[COMPRESSION], attributes, accessors, views, binary))
    read = {name: _accessor(name, index, accessors, views, binary) for name, index in attributes.items()}
    names = [f"{EXTENSION}:{name}" for name in ("ROTATION", "SCALE", "OPACITY", "SH_DEGREE_0_COEF_0")]
    missing = [name for name in ("POSITION", *names) if name not in read]
    if missing:
        raise BadInput(f"it has no {missing[0]}")
    count = len(read["POSITION"])
    if any(len(array) != count for array in read.values()):
        raise BadInput("its attributes are of different lengths")
    quats, scales, opacities, base = (read[name] for name in names)
    if not (scales > 0).all() or not ((opacities >= 0) & (opacities <= 1)).all():
        raise BadInput("a scale is not above 0, or an opacity is not in 0 to 1")
    plain = Splats(
        means=_shaped("POSITION", read["POSITION"], 3),
        quats=_shaped("ROTATION", quats, 4)[:, [3, 0, 1, 2]],
        log_scales=np.log(_shaped("SCALE", scales, 3).astype(np.float64)),
        logit_opacities=logit(np.clip(_shaped("OPACITY", opacities, 1)[:, 0].astype(np.float64), _END_OPACITY, 1 - _END_OPACITY)),
        sh0=_shaped("SH_DEGREE_0", base, 3)[:, None],
        shN=_harmonics(read, count),
    )
    return _upright(plain)


def _upright(splats: Splats) -> Splats:
    return move_splats(splats, Sim3(scale=1.0, rotation=GLTF_FROM_WORLD.T, translation=np.zeros(3)))


def _compressed(child: Any, attributes: dict[str, Any], accessors: Any, views: Any, binary: bytes) -> Splats:
    try:
        view = views[_index(child["bufferView"])]
        start, size = _index(view.get("byteOffset", 0)), _index(view["byteLength"])
        inside = _index(view["buffer"]) == 0 and start + size <= len(binary)
        counts = {_index(accessors[_index(index)]["count"]) for index in attributes.values()}
    except (KeyError, IndexError, TypeError, AttributeError) as error:
        raise BadInput(f"its {COMPRESSION} names no SPZ, or an attribute has no accessor") from error
    if not inside:
        raise BadInput(f"its {COMPRESSION} lies outside the file")
    splats = splats_from_gzip_spz(binary[start : start + size])
    num_rest = sum(":SH_DEGREE_" in name for name in attributes)
    if counts != {len(splats)} or num_rest != splats.shN.shape[1]:
        raise BadInput(f"its attributes are not those of an SPZ of {len(splats)} Gaussians of degree {splats.sh_degree}")
    return splats


def _chunks(data: bytes) -> tuple[dict[str, Any], bytes]:
    if len(data) < 20 or struct.unpack_from("<4sII", data) != (b"glTF", 2, len(data)):
        raise BadInput("it is no GLB of version 2 as long as it says")
    size, kind = struct.unpack_from("<I4s", data, 12)
    if kind != b"JSON" or size > min(MAX_JSON_BYTES, len(data) - 20):
        raise BadInput("its first chunk is no JSON within the file")
    content = parse_json(data[20 : 20 + size])
    if not isinstance(content, dict):
        raise BadInput("its JSON is no object")
    start = 20 + size
    if len(data) < start + 8:
        raise BadInput("it has no binary chunk")
    num_bytes, kind = struct.unpack_from("<I4s", data, start)
    if kind != b"BIN\0" or num_bytes != len(data) - start - 8:
        raise BadInput("its second chunk is not the rest of the file")
    return content, data[start + 8 :]


def _accessor(name: str, index: Any, accessors: Any, views: Any, binary: bytes) -> NDArray[np.float32]:
    try:
        accessor = accessors[_index(index)]
        view = views[_index(accessor["bufferView"])]
        width, count = _WIDTHS[accessor["type"]], _index(accessor["count"])
        start = _index(view.get("byteOffset", 0)) + _index(accessor.get("byteOffset", 0))
        plain = accessor["componentType"] == 5126 and _index(view["buffer"]) == 0 and "byteStride" not in view and "sparse" not in accessor
    except (KeyError, IndexError, TypeError, AttributeError) as error:
        raise BadInput(f"its attribute {name[:60]!r} has no accessor of floats") from error
    if not plain or start + 4 * width * count > len(binary):
        raise BadInput(f"its attribute {name[:60]!r} is no plain row of floats inside the file")
    return np.frombuffer(binary, "<f4", width * count, start).reshape(count, width)


def _index(value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**40:
        raise TypeError("no index")
    return value


def _shaped(name: str, array: NDArray[np.float32], width: int) -> NDArray[np.float32]:
    if array.shape[1] != width:
        raise BadInput(f"its {name} has {array.shape[1]} numbers each, expected {width}")
    return array


def _harmonics(read: dict[str, NDArray[np.float32]], count: int) -> NDArray[np.float32]:
    found = {}
    for name, values in read.items():
        if match := re.fullmatch(rf"{EXTENSION}:SH_DEGREE_([1-3])_COEF_([0-6])", name):
            degree, number = int(match[1]), int(match[2])
            if number > 2 * degree:
                raise BadInput(f"it has {name}")
            found[degree**2 - 1 + number] = _shaped(name, values, 3)
    if len(found) + 1 not in SH_BASES or sorted(found) != list(range(len(found))):
        raise BadInput(f"it has {len(found)} harmonics above degree 0, expected 0, 3, 8 or 15")
    return np.stack([found[number] for number in range(len(found))], axis=1) if found else np.zeros((count, 0, 3), np.float32)
