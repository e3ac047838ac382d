"""Gaussians as SPZ of versions 2 and 3, the gzip forms that readers of 2024 and 2025 know; version
1 is read. Once per file or tile.

gzip of a header of 16 bytes, then, each for all N Gaussians:
    means      3 × 24 bits of round(m · 2^b), b the header's fraction bits; version 1: 3 halves
    opacities  1 byte of 255 steps
    sh0        3 bytes, round(255 (0.15 c + ½)): ±3.33 in steps of 0.026
    scales     3 bytes, round(16 (ln s + 10)): ln s from −10 to 5.9375
    rotations  versions 1, 2: 3 bytes, x y z in steps of 1/127.5 with w = √(1 − x² − y² − z²) ≥ 0
               version 3: the largest component's number in 2 bits, the others in 10 each
    shN        3 (K − 1) bytes, 128 + 4 round(32 c): ±1 in steps of 1/32
Version 4 is Open3D's (`io.open3d_formats`). Source: Niantic's `load-spz.cc`.

Coordinates are written and read as they stand, as Open3D and Spark have them; the format means
x right, y up, z back, and programs that hold to it turn a PLY by 180° about x on the way in and
out.

In version 2 an error of x, y, z grows by 1/w in w. An ellipsoid has 24 rotations, one per labelling
of its axes: the one nearest to the identity is stored, whose w is at least 0.85.
"""

from __future__ import annotations

import struct
import zlib
from functools import cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from radiant_core.choices import GzipSpzVersion
from radiant_core.errors import BadInput
from radiant_core.io.claimed_counts import require_believable
from radiant_core.io.stored_gaussians import END_OPACITY, StoredGaussians, checked
from radiant_core.numerics import FloatArray, rotmats_from_quats, unit_quats
from radiant_core.splats import Splats

SPZ_FRACTION_BITS = 12
"""Steps of 0.24 mm within ±2048, which every writer takes."""
MAX_FRACTION_BITS = 23
HARMONIC_STEP = 4
"""Of 128ths. Niantic's own writer takes 8 for degree 1 and 16 above."""
_HEADER = struct.Struct("<4sIIBBBB")
_MAGIC, _ANTIALIASED, _EXTENDED = b"NGSP", 1, 2
MAX_EXTENSION_BYTES = 1 << 16
_COLOR = 0.15 * 255
_REACH = 1 << 23
_ROOT_HALF = np.sqrt(0.5)
MAX_SPZ_GAUSSIANS, MAX_SPZ_DEGREE = 1 << 26, 4


def gzip_spz_bytes(splats: Splats, version: GzipSpzVersion, fraction_bits: int = SPZ_FRACTION_BITS) -> bytes:
    """At least one Gaussian as SPZ, the same bytes for the same model.

    Raises BadInput without any, or where one lies farther out than the fraction bits leave room
    for, 2^(23 − bits).
    """
    if not len(splats):
        raise BadInput("a model without Gaussians cannot be an SPZ: leave it out.")
    steps = np.rint(splats.means.astype(np.float64) * 2.0**fraction_bits)
    if np.abs(steps).max() >= _REACH:
        raise BadInput(f"a Gaussian lies beyond {_REACH / 2**fraction_bits:.4g} units of the origin, where SPZ ends: write PLY.")
    quats, log_scales = _near_identity(splats) if version == 2 else (unit_quats(splats.quats), splats.log_scales)
    parts = [
        steps.astype("<i4").view(np.uint8).reshape(len(splats), 3, 4)[..., :3],
        _bytes_of(255 * splats.opacities),
        _bytes_of(_COLOR * splats.sh0 + 127.5),
        _bytes_of(16 * (log_scales + 10)),
        _first_three(quats) if version == 2 else _smallest_three(quats),
        _harmonic_bytes(splats.shN),
    ]
    flags = _ANTIALIASED if splats.antialiased else 0
    header = _HEADER.pack(_MAGIC, version, len(splats), splats.sh_degree, fraction_bits, flags, 0)
    # 31: gzip, without a name or a time.
    packer = zlib.compressobj(6, zlib.DEFLATED, 31)
    return packer.compress(header + b"".join(part.tobytes() for part in parts)) + packer.flush()


def fraction_bits_for(splats: Splats) -> int:
    """The bits that keep the centres' steps below a sixteenth of the median Gaussian, 12 at least
    where the farthest one leaves room."""
    wanted = int(np.ceil(np.log2(16) - np.median(splats.log_scales) / np.log(2)))
    farthest = float(np.abs(splats.means).max())
    room = MAX_FRACTION_BITS - int(np.ceil(np.log2(max(farthest, 1e-30) + 2.0**-MAX_FRACTION_BITS)))
    return int(np.clip(max(wanted, SPZ_FRACTION_BITS), 0, min(max(room, 0), MAX_FRACTION_BITS)))


def splats_from_gzip_spz(data: bytes) -> Splats:
    """The model in an SPZ of version 1, 2 or 3, or BadInput that says what is wrong with it."""
    return checked(gaussians_of_gzip_spz(data))


def gaussians_of_gzip_spz(data: bytes) -> StoredGaussians:
    """As `splats_from_gzip_spz`, also of degree 4. Coordinates as they stand in the file."""
    unpacker = zlib.decompressobj(31)
    try:
        header = unpacker.decompress(data, _HEADER.size)
        magic, version, count, degree, fraction_bits, flags, _ = _HEADER.unpack(header)
        size = _size(magic, version, count, degree, fraction_bits)
        require_believable(count, len(data))
        # Records of extensions, such as limits of an orbit, stand behind the Gaussians.
        most = size + (MAX_EXTENSION_BYTES if flags & _EXTENDED else 0)
        body = unpacker.decompress(unpacker.unconsumed_tail, most + 1)
    except (zlib.error, struct.error) as error:
        raise BadInput("it is no SPZ of version 1, 2 or 3: its gzip stream is broken or ends early") from error
    if not size <= len(body) <= most or not unpacker.eof or unpacker.unused_data:
        raise BadInput(f"its SPZ is not as long as {count} Gaussians of degree {degree} are")
    rows = np.frombuffer(body, np.uint8, size)
    widths = np.cumsum([6 if version == 1 else 9, 1, 3, 3, 4 if version == 3 else 3])
    means, opacities, colors, scales, rotations, harmonics = np.split(rows, widths * count)
    quats = (_from_smallest_three if version == 3 else _from_first_three)(rotations.reshape(count, -1))
    opacity = np.clip(opacities / 255.0, END_OPACITY, 1 - END_OPACITY)
    return StoredGaussians(
        means=_from_halves(means) if version == 1 else _from_fixed(means, fraction_bits),
        quats=quats.astype(np.float32),
        log_scales=np.asarray(scales.reshape(count, 3) / 16.0 - 10, np.float32),
        logit_opacities=np.log(opacity) - np.log1p(-opacity),
        sh0=(colors.reshape(count, 1, 3) - 127.5) / _COLOR,
        shN=np.asarray((harmonics.reshape(count, (degree + 1) ** 2 - 1, 3) - 128.0) / 128, np.float32),
        antialiased=bool(flags & _ANTIALIASED),
    )


def _from_halves(stored: NDArray[np.uint8]) -> NDArray[np.float32]:
    return np.asarray(stored.view("<f2").reshape(-1, 3), np.float32)


def _from_fixed(stored: NDArray[np.uint8], fraction_bits: int) -> NDArray[np.float32]:
    fixed = np.zeros((len(stored) // 3, 4), np.uint8)
    fixed[:, 1:] = stored.reshape(-1, 3)
    return np.asarray((fixed.view("<i4") >> 8).reshape(-1, 3) / 2.0**fraction_bits, np.float32)


def _size(magic: bytes, version: int, count: int, degree: int, fraction_bits: int) -> int:
    """Bytes after the header, which is checked."""
    if magic != _MAGIC or version not in (1, 2, 3):
        raise BadInput("it is no SPZ of version 1, 2 or 3")
    if not 0 < count <= MAX_SPZ_GAUSSIANS or degree > MAX_SPZ_DEGREE or fraction_bits > MAX_FRACTION_BITS:
        raise BadInput(f"its SPZ says {count} Gaussians of degree {degree} with {fraction_bits} fraction bits")
    return count * ((13 if version == 1 else 16) + (4 if version == 3 else 3) + 3 * ((degree + 1) ** 2 - 1))


def _bytes_of(values: NDArray[np.floating]) -> NDArray[np.uint8]:
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def _harmonic_bytes(shN: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Bytes of (N,K-1,3) in steps coarser than a byte has: what is finer is noise that does not
    compress."""
    return np.clip(np.rint(128 / HARMONIC_STEP * shN) * HARMONIC_STEP + 128, 0, 255).astype(np.uint8)


def _near_identity(splats: Splats) -> tuple[FloatArray, FloatArray]:
    """Rotations (N,4) wxyz with the greatest w of the 24, and log scales (N,3) of their axes."""
    turns, axes = _relabellings()
    quats = unit_quats(splats.quats).astype(np.float64)
    w, xyz = quats[:, :1], quats[:, 1:]
    # The real part of q · g: where it is largest, the rotation is smallest.
    real = quats * [1, -1, -1, -1] @ turns.T
    best = np.abs(real).argmax(axis=1)
    turn = turns[best]
    imaginary = w * turn[:, 1:] + xyz * turn[:, :1] + np.cross(xyz, turn[:, 1:])
    turned = np.column_stack([real[np.arange(len(best)), best], imaginary])
    return turned * np.where(turned[:, :1] < 0, -1, 1), np.take_along_axis(splats.log_scales.astype(np.float64), axes[best], axis=1)


@cache
def _relabellings() -> tuple[FloatArray, NDArray[np.int64]]:
    """The 24 rotations of a cube as quaternions (24,4) wxyz, and the old axis that each new one is
    (24,3)."""
    corners = [np.array(signs) for signs in product((-1, 0, 1), repeat=4) if sum(map(abs, signs)) in (1, 2, 4)]
    # q and −q are one rotation: the one whose first number other than zero is positive.
    quats = np.array([corner / np.linalg.norm(corner) for corner in corners if corner[np.flatnonzero(corner)[0]] > 0])
    return quats, np.abs(rotmats_from_quats(quats)).argmax(axis=1)


def _first_three(quats: FloatArray) -> NDArray[np.uint8]:
    return _bytes_of(127.5 * quats[:, 1:] + 127.5)


def _from_first_three(stored: NDArray[np.uint8]) -> FloatArray:
    xyz = stored / 127.5 - 1
    return unit_quats(np.column_stack([np.sqrt(np.maximum(0, 1 - (xyz**2).sum(axis=1))), xyz]))


def _smallest_three(quats: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Words (N,) as bytes: 2 bits of which of x y z w is left out; sign and 9 bits of the rest."""
    rows, xyzw = np.arange(len(quats)), quats[:, [1, 2, 3, 0]].astype(np.float64)
    largest = np.abs(xyzw).argmax(axis=1)
    xyzw = np.where(xyzw[rows, largest, None] < 0, -xyzw, xyzw)
    words = largest.astype(np.uint32)
    for axis in range(4):
        value = xyzw[:, axis]
        code = np.minimum(np.rint(511 / _ROOT_HALF * np.abs(value)), 511).astype(np.uint32) | (value < 0).astype(np.uint32) << 9
        words = np.where(largest == axis, words, words << 10 | code)
    return words.astype("<u4").view(np.uint8)


def _from_smallest_three(stored: NDArray[np.uint8]) -> FloatArray:
    words = np.ascontiguousarray(stored).view("<u4")[:, 0]
    largest = (words >> 30).astype(np.int64)
    xyzw = np.zeros((len(words), 4))
    for axis in range(3, -1, -1):
        value = _ROOT_HALF / 511 * (words & 511) * np.where(words >> 9 & 1, -1, 1)
        here = largest != axis
        xyzw[here, axis] = value[here]
        words = np.where(here, words >> 10, words)
    xyzw[np.arange(len(words)), largest] = np.sqrt(np.maximum(0, 1 - (xyzw**2).sum(axis=1)))
    return unit_quats(xyzw[:, [3, 0, 1, 2]])
