"""A model as it is uploaded: exact, in 16 bits, or as SPZ. Once per model.

format   means                                        the rest          bytes at degree 0, 1, 2, 3
float32  float32                                      float32           56, 92, 152, 236
float16  3 × 21 bits of the bounding box, one uint64  float16           30, 48, 78, 120
spz      3 × 24 bits around the middle                8 bits and fewer  compressed

Half precision for centres was measured and costs 35 dB (docs/experiments/uploads.md): 11 bits of a
100 m scene are 5 cm. Read by what the file says of itself; every format is refused when its bytes
are not what its schema says.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from radiant_core.choices import UploadFormat
from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.io.array_file import header_of, load_arrays, name_file_in_errors, save_arrays, schema_of
from radiant_core.io.open3d_formats import SPZ_MAX_LOG_SCALE, SPZ_MAX_MEAN, SPZ_MEAN_STEP, splats_from_spz, spz_bytes
from radiant_core.io.records import load_splats, save_splats
from radiant_core.numerics import FloatArray, check_array, unit_quats
from radiant_core.splats import SH_BASES, Splats

BYTES_FACTORS: dict[UploadFormat, float] = {"float32": 1.0, "float16": 0.52, "spz": 0.22}
"""Bytes over those of float32, measured at degree 1: `radiant bench upload`."""

FLOAT16_SCHEMA, SPZ_SCHEMA = "radiant.splats.float16", "radiant.splats.spz"
FLOAT16_DTYPES = {"means": "U64", "box": "F64", "quats": "F16", "log_scales": "F16", "logit_opacities": "F16", "sh0": "F16", "shN": "F16"}
MAX_FLOAT16 = 65504.0
_MEAN_BITS = 21
_MEAN_MAX = 2**_MEAN_BITS - 1
_SHIFTS = np.array([0, _MEAN_BITS, 2 * _MEAN_BITS], np.uint64)
_MAX_EXPONENT = 40
"""SPZ's centres are multiplied by at most 2 ** 40 or divided by it."""
_STEPS_PER_GAUSSIAN = 8
"""SPZ is unfit where the median Gaussian's longest axis is below this many steps of a centre."""


def save_upload(path: Path, splats: Splats, upload_format: UploadFormat) -> None:
    """Write `splats` for an upload, atomically; BadInput where there is an `upload_problem`."""
    problem = upload_problem(splats, upload_format)
    if problem is not None:
        raise BadInput(f"cannot write {path}: {problem}")
    if upload_format == "float32":
        save_splats(path, splats)
    elif upload_format == "float16":
        save_arrays(path, FLOAT16_SCHEMA, _float16_arrays(splats), {"antialiased": splats.antialiased})
    else:
        _save_spz(path, splats)


def load_upload(path: Path) -> Splats:
    """The model in any of the formats; StoreDamaged when broken, BadInput when it is no model."""
    schema = schema_of(path)
    if schema == FLOAT16_SCHEMA:
        return _load_float16(path)
    if schema == SPZ_SCHEMA:
        return _load_spz(path)
    return load_splats(path)


def count_uploaded(path: Path) -> int:
    """How many Gaussians an upload says it holds, without reading them; raises as `load_upload`."""
    record, shapes = header_of(path)
    with name_file_in_errors(path):
        if record.get("schema") == SPZ_SCHEMA:
            return int(record["about"]["num_splats"])
        return int(shapes["logit_opacities"][0])


def upload_problem(splats: Splats, upload_format: UploadFormat) -> str | None:
    """Why the format cannot hold this model, or None; BadInput for an unknown format."""
    if upload_format not in get_args(UploadFormat):
        raise BadInput(f"upload format {upload_format!r} is unknown: use one of {', '.join(get_args(UploadFormat))}.")
    if upload_format == "float16":
        largest = max(float(np.abs(array).max(initial=0)) for array in (splats.sh0, splats.shN))
        if largest > MAX_FLOAT16:
            return f"a colour coefficient is {largest:.3g}, float16 ends at {MAX_FLOAT16:.0f}: use --upload float32."
    if upload_format == "spz" and len(splats):
        middle, exponent = _spz_frame(splats)
        reach = float(np.abs(splats.means - middle).max()) * 2.0**exponent
        typical = float(np.median(splats.log_scales.max(axis=1)))
        if reach > SPZ_MAX_MEAN or np.log(SPZ_MEAN_STEP * _STEPS_PER_GAUSSIAN) - exponent * np.log(2) > typical:
            return "its extent or its largest Gaussian leaves SPZ's 24 bits no room for the small ones: use --upload float16."
    return None


def _float16_arrays(splats: Splats) -> dict[str, NDArray]:
    means = splats.means.astype(np.float64)
    box = np.stack([means.min(axis=0), means.max(axis=0)]) if len(means) else np.zeros((2, 3))
    extent = box[1] - box[0]
    places = np.rint((means - box[0]) / np.where(extent > 0, extent, 1) * _MEAN_MAX).astype(np.uint64)
    # Beyond float16's end an exponential is 0 or infinite and a sigmoid 0 or 1 either way.
    saturated = {name: np.clip(getattr(splats, name), -MAX_FLOAT16, MAX_FLOAT16) for name in ("log_scales", "logit_opacities")}
    others = {"quats": unit_quats(splats.quats), "sh0": splats.sh0, "shN": splats.shN, **saturated}
    packed = np.bitwise_or.reduce(places << _SHIFTS, axis=1)
    return {"means": packed, "box": box, **{name: array.astype(np.float16) for name, array in others.items()}}


def _load_float16(path: Path) -> Splats:
    arrays, about = load_arrays(path, FLOAT16_SCHEMA, FLOAT16_DTYPES)
    with name_file_in_errors(path):
        packed, box = arrays.pop("means"), check_array("box", arrays.pop("box"), (2, 3))
        if packed.ndim != 1 or (packed >> np.uint64(3 * _MEAN_BITS)).any() or (box[1] < box[0]).any():
            raise BadInput("its centres are not packed as they should be: write it anew with this version.")
        places = (packed[:, None] >> _SHIFTS) & np.uint64(_MEAN_MAX)
        antialiased = about.get("antialiased") is True
        return Splats(means=box[0] + places * ((box[1] - box[0]) / _MEAN_MAX), **arrays, antialiased=antialiased)


def _save_spz(path: Path, splats: Splats) -> None:
    middle, exponent = _spz_frame(splats)
    data = spz_bytes(_in_frame(splats, middle, exponent)) if len(splats) else b""
    about = {
        "num_splats": len(splats),
        "sh_degree": splats.sh_degree,
        "middle": middle.tolist(),
        "exponent": exponent,
        "antialiased": splats.antialiased,
        "sha256": hashlib.sha256(data).hexdigest(),
    }
    save_arrays(path, SPZ_SCHEMA, {"spz": np.frombuffer(data, np.uint8)}, about)


def _load_spz(path: Path) -> Splats:
    arrays, about = load_arrays(path, SPZ_SCHEMA, {"spz": "U8"})
    with name_file_in_errors(path):
        data, count, degree = arrays["spz"].tobytes(), int(about["num_splats"]), int(about["sh_degree"])
        middle, exponent = check_array("middle", about["middle"], (3,)), int(about["exponent"])
        if not (0 <= degree < len(SH_BASES) and count >= 0 and abs(exponent) <= _MAX_EXPONENT):
            raise BadInput(f"it says {count} Gaussians of degree {degree} and exponent {exponent}: write it anew with this version.")
        # Open3D gets only bytes that are known to be whole.
        if hashlib.sha256(data).hexdigest() != about["sha256"]:
            raise StoreDamaged(f"{path} has other bytes than were sent: send the model again.")
        if not count:
            return replace(_no_splats(degree), antialiased=about.get("antialiased") is True)
        stored = splats_from_spz(data, count, degree)
        means = stored.means.astype(np.float64) / 2.0**exponent + middle
        log_scales = stored.log_scales - exponent * np.log(2)
        return replace(stored, means=means, log_scales=log_scales, antialiased=about.get("antialiased") is True)


def _spz_frame(splats: Splats) -> tuple[FloatArray, int]:
    """Middle (3,) and exponent e of stored = (mean − middle) · 2^e: the finest steps at which all
    centres and sizes fit."""
    if not len(splats):
        return np.zeros(3), 0
    means = splats.means.astype(np.float64)
    middle = (means.min(axis=0) + means.max(axis=0)) / 2
    reach = np.abs(means - middle).max()
    for_means = np.log2(SPZ_MAX_MEAN / reach) if reach > 0 else np.inf
    for_scales = (SPZ_MAX_LOG_SCALE - float(splats.log_scales.max())) / np.log(2)
    return middle, int(np.clip(np.floor(min(for_means, for_scales)), -_MAX_EXPONENT, _MAX_EXPONENT))


def _in_frame(splats: Splats, middle: FloatArray, exponent: int) -> Splats:
    means = (splats.means.astype(np.float64) - middle) * 2.0**exponent
    return replace(splats, means=means, log_scales=splats.log_scales + exponent * np.log(2))


def _no_splats(degree: int) -> Splats:
    shapes = {"means": (3,), "quats": (4,), "log_scales": (3,), "logit_opacities": (), "sh0": (1, 3), "shN": (SH_BASES[degree] - 1, 3)}
    return Splats(**{name: np.zeros((0, *shape), np.float32) for name, shape in shapes.items()}, antialiased=False)
