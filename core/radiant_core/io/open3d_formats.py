"""Models as Open3D draws them and packs them into SPZ. Once per model.

SPZ (version 4) keeps a Gaussian in 20 bytes and one per harmonic and channel, then compresses them:
centres in fixed point of 1/4096 within ±2048, log scales in steps of 1/16 within −10 … 5.9375,
opacities in 1/255, sh0 in steps of 0.026 within ±3.33, shN in steps of 1/16 (degree 1) and 1/8
within ±1, quaternions in 32 bits. Sizes as seen in files of open3d 0.20.
"""

from __future__ import annotations

import ctypes
import os
import struct
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from radiant_core.errors import BadInput, StageFailed, StoreDamaged
from radiant_core.io.claimed_counts import require_believable
from radiant_core.numerics import unit_quats
from radiant_core.splats import SH_BASES, Splats

if TYPE_CHECKING:
    import open3d as o3d

SPZ_MAX_MEAN = 2047.0
"""Beyond 2048 Open3D's centres come back somewhere else, without a word."""
SPZ_MEAN_STEP = 1 / 4096
SPZ_MAX_LOG_SCALE = 5.9375
"""Larger Gaussians come back smaller."""
_SPZ_HEADER = struct.Struct("<4sIIBBBBI12x")
_SPZ_STREAM = struct.Struct("<QQ")
_SPZ_BITS_AT, _SPZ_FLAGS_AT, _SPZ_ANTIALIASED = 13, 14, 1
MAX_ZSTD_RATIO = 2**15
"""A block of Zstandard is 128 KiB at most and 4 bytes or more: a stream that promises more is none,
and nothing is allocated for it."""
_END_ALPHA = 0.25 / 255
"""What the ends of the 8-bit opacities, 0 and 1, are read as: the middle of what was rounded to
them, where the logit is finite."""


def open3d_point_cloud(splats: Splats, max_sh_degree: int = 2) -> o3d.t.geometry.PointCloud:
    """N Gaussians as Open3D's tensor point cloud for its shader "gaussianSplat".

    positions (N,3); scale (N,3) linear; rot (N,4) wxyz of length 1; opacity (N,1) logit; f_dc
    (N,3); f_rest (N,K-1,3), cut to degree 2, all that is drawn. Raises BadInput on a degree outside
    0 to 3 or a scale that float32 cannot hold. Source: what open3d 0.20 gives when it reads a 3DGS
    PLY.
    """
    import open3d as o3d

    if not 0 <= max_sh_degree < len(SH_BASES):
        raise BadInput(f"max_sh_degree is {max_sh_degree}, expected 0 to {len(SH_BASES) - 1}.")
    with np.errstate(over="ignore", under="ignore"):
        scales = np.exp(splats.log_scales)
    if not np.isfinite(scales).all():
        raise BadInput(f"a Gaussian has the log scale {splats.log_scales.max():.3g}, beyond float32: clean the model first.")
    num_rest = min(splats.shN.shape[1], SH_BASES[max_sh_degree] - 1)
    attributes = {
        "positions": splats.means,
        "scale": scales,
        "rot": unit_quats(splats.quats),
        "opacity": splats.logit_opacities[:, None],
        "f_dc": splats.sh0[:, 0],
        "f_rest": splats.shN[:, :num_rest],
    }
    cloud = o3d.t.geometry.PointCloud()
    for name, array in attributes.items():
        cloud.point[name] = o3d.core.Tensor.from_numpy(np.array(array, np.float32, order="C"))
    return cloud


def spz_bytes(splats: Splats, fraction_bits: int = 12) -> bytes:
    """At least one Gaussian as SPZ, within its limits; StageFailed when Open3D writes nothing.

    Open3D writes 12 bits of a fraction: with fewer its centres are made smaller by as many powers
    of two, and the header says so.
    """
    import open3d as o3d

    cloud = open3d_point_cloud(replace(splats, means=splats.means * np.float32(2.0 ** (fraction_bits - 12))), max_sh_degree=3)
    with TemporaryDirectory(prefix="radiant-spz-") as folder, _log_instead_of_output():
        path = Path(folder) / "model.spz"
        if not o3d.t.io.write_point_cloud(path, cloud):
            raise StageFailed(f"Open3D wrote no SPZ of {len(splats)} Gaussians: use --upload float16.")
        data = bytearray(path.read_bytes())
    data[_SPZ_BITS_AT] = fraction_bits
    # Open3D has no such flag; without it other programs draw the model too sharp and too bright.
    data[_SPZ_FLAGS_AT] |= _SPZ_ANTIALIASED if splats.antialiased else 0
    return bytes(data)


def splats_from_spz(data: bytes, num_splats: int, sh_degree: int) -> Splats:
    """The model in `data`, SPZ of exactly so many Gaussians, or StoreDamaged; opacities of 0 and 1
    come from Open3D as infinite logits and become ±6.9."""
    import open3d as o3d

    _require_spz(data, num_splats, sh_degree)
    with TemporaryDirectory(prefix="radiant-spz-") as folder, _log_instead_of_output():
        path = Path(folder) / "model.spz"
        path.write_bytes(data)
        point = {name: tensor.numpy() for name, tensor in o3d.t.io.read_point_cloud(path).point.items()}
    shapes = {"positions": (3,), "scale": (3,), "rot": (4,), "opacity": (1,), "f_dc": (3,), "f_rest": (SH_BASES[sh_degree] - 1, 3)}
    point.setdefault("f_rest", np.zeros((num_splats, 0, 3), np.float32))
    wrong = [name for name, shape in shapes.items() if name not in point or point[name].shape != (num_splats, *shape)]
    if wrong:
        raise StoreDamaged(f"SPZ data gave no {wrong[0]} of {num_splats} Gaussians: send the model again.")
    end_logit = np.log((1 - _END_ALPHA) / _END_ALPHA)
    return Splats(
        means=point["positions"],
        quats=unit_quats(point["rot"]).astype(np.float32),
        log_scales=np.log(point["scale"].astype(np.float64)),
        logit_opacities=np.clip(point["opacity"][:, 0], -end_logit, end_logit),
        sh0=point["f_dc"][:, None],
        shN=point["f_rest"],
        antialiased=bool(data[_SPZ_FLAGS_AT] & _SPZ_ANTIALIASED),
    )


def splats_from_any_spz(data: bytes) -> Splats:
    """The model in SPZ of version 4 of any count that its bytes can hold; BadInput for other bytes
    and for what Open3D's reader is not trusted with: extensions and degree 4."""
    if len(data) < _SPZ_HEADER.size:
        raise BadInput(f"it has {len(data)} bytes and SPZ of version 4 a header of {_SPZ_HEADER.size}")
    _, version, count, degree, fraction_bits, flags, _, _ = _SPZ_HEADER.unpack_from(data)
    if version != 4:
        raise BadInput(f"it is SPZ of version {version}, expected 2 to 4")
    if degree >= len(SH_BASES) or flags & ~_SPZ_ANTIALIASED or fraction_bits > 23 or not count:
        raise BadInput(
            f"its SPZ of version 4 has {count} Gaussians of degree {degree}, {fraction_bits} fraction bits and flags {flags}, expected 1 or"
            f" more of degree 0 to 3 without extensions: write it as SPZ of version 3"
        )
    require_believable(count, len(data))
    try:
        return splats_from_spz(data, count, degree)
    except StoreDamaged as error:
        raise BadInput(f"its SPZ of version 4 is not as long as {count} Gaussians of degree {degree} are") from error


def _require_spz(data: bytes, num_splats: int, sh_degree: int) -> None:
    """Raise StoreDamaged unless header and table of streams fit the bytes, before Open3D reads."""
    per_splat = (9, 1, 3, 3, 4, *([3 * (SH_BASES[sh_degree] - 1)] if sh_degree else []))
    start = _SPZ_HEADER.size + _SPZ_STREAM.size * len(per_splat)
    if len(data) >= start:
        magic, version, count, degree, _, _, num_streams, toc_start = _SPZ_HEADER.unpack_from(data)
        streams = list(_SPZ_STREAM.iter_unpack(data[_SPZ_HEADER.size : start]))
        head = (magic, version, count, degree, num_streams, toc_start)
        sizes = [raw for _, raw in streams], start + sum(packed for packed, _ in streams)
        expected = (b"NGSP", 4, num_splats, sh_degree, len(per_splat), _SPZ_HEADER.size)
        fits = all(raw <= packed * MAX_ZSTD_RATIO for packed, raw in streams)
        if head == expected and fits and sizes == ([num_splats * size for size in per_splat], len(data)):
            return
    raise StoreDamaged(f"these {len(data)} bytes are no SPZ of version 4 with {num_splats} Gaussians of degree {sh_degree}: send it again.")


@contextmanager
def _log_instead_of_output() -> Iterator[None]:
    """Open3D reports each SPZ file on standard output, where a command may be printing JSON: those
    reports go to standard error."""
    sys.stdout.flush()
    saved_fd = os.dup(1)
    os.dup2(2, 1)
    try:
        yield
    finally:
        ctypes.CDLL(None).fflush(None)
        os.dup2(saved_fd, 1)
        os.close(saved_fd)
