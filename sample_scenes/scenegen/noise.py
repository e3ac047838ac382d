"""Texture from hashed integer lattice points: the same numbers on every machine, for any
coordinate, without a table.

    value(x, y) = Σ_corners w_corner · hash(⌊x/cell⌋ + cx, ⌊y/cell⌋ + cy, salt),  w smoothstep

Runs a dozen times per ray, so everything is one pass over uint32 or float32 arrays. Callers hand
over strips of some 10⁴ samples: in-cache numpy needs about 20 ns per value.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating]  # float32 wherever rays are many: half the time of float64
Hashes = NDArray[np.uint32]

_ACROSS, _ALONG, _SALT = 0x8DA6B343, 0xD8163841, 0xCB1AB31F
_UNIT = np.float32(2.0**-24)


def mix_bits(bits: Hashes) -> Hashes:
    """Scramble uint32 values in place so that every input bit reaches every output bit; returns its
    argument."""
    bits ^= bits >> np.uint32(16)
    bits *= np.uint32(0x7FEB352D)
    bits ^= bits >> np.uint32(15)
    bits *= np.uint32(0x846CA68B)
    bits ^= bits >> np.uint32(16)
    return bits


def hash_unit(i: NDArray[np.integer], j: NDArray[np.integer], salt: int) -> Floats:
    """A number in [0, 1) for every pair of whole numbers i, j (N,) and salt."""
    return _unit(_lattice(i, _ACROSS) ^ _salted(_lattice(j, _ALONG), salt))


def value_noise(x: Floats, y: Floats, cell_m: float, salt: int) -> Floats:
    """Smooth noise in [0, 1) with features of cell_m metres at x, y (N,), on a lattice turned by an
    angle of its own."""
    turn = 0.7 + 2.3 * salt
    c, s = np.float32(np.cos(turn) / cell_m), np.float32(np.sin(turn) / cell_m)
    across, along = c * x - s * y, s * x + c * y
    left, low = np.floor(across), np.floor(along)
    tx, ty = _smoothstep(across - left), _smoothstep(along - low)
    columns = _lattice(left, _ACROSS)
    rows = _salted(_lattice(low, _ALONG), salt)
    columns_right, rows_up = columns + np.uint32(_ACROSS), rows + np.uint32(_ALONG)
    bottom = _blend(_unit(columns ^ rows), _unit(columns_right ^ rows), tx)
    top = _blend(_unit(columns ^ rows_up), _unit(columns_right ^ rows_up), tx)
    return _blend(bottom, top, ty)


def detail_noise(x: Floats, y: Floats, cell_m: float, salt: int, footprint_m: Floats) -> Floats:
    """value_noise - 1/2, faded out where a pixel covers a whole cell, so that far surfaces do not
    sparkle."""
    fade = np.clip(cell_m / (2.0 * footprint_m) - np.float32(0.5), 0.0, 1.0)
    return (value_noise(x, y, cell_m, salt) - np.float32(0.5)) * fade


def gaussian_noise(count: int, salt: int) -> Floats:
    """count independent standard normal numbers, by Box and Muller from two hashes of the
    position."""
    index = np.arange(count, dtype=np.int64)
    first = hash_unit(index, np.zeros_like(index), salt)
    second = hash_unit(index, np.ones_like(index), salt)
    return np.sqrt(-2.0 * np.log(first + _UNIT)) * np.cos(np.float32(2.0 * np.pi) * second)


def _lattice(values: NDArray, factor: int) -> Hashes:
    return values.astype(np.int32).view(np.uint32) * np.uint32(factor)


def _salted(rows: Hashes, salt: int) -> Hashes:
    return rows + np.uint32((salt * _SALT + 0x9E3779B9) & 0xFFFFFFFF)


def _unit(bits: Hashes) -> Floats:
    return (mix_bits(bits) >> np.uint32(8)).astype(np.float32) * _UNIT


def _smoothstep(t: Floats) -> Floats:
    return t * t * (np.float32(3.0) - np.float32(2.0) * t)


def _blend(a: Floats, b: Floats, t: Floats) -> Floats:
    return a + (b - a) * t
