"""Checks of arrays and the laws of rotations. Once per object, never inside a training step."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core.errors import BadInput

FloatArray = NDArray[np.float64]


def figure_text(value: float, digits: int = 3) -> str:
    """A finite number in so many significant digits as people read it: 1,670 and 0.0123, and no
    1.67e+03."""
    if abs(value) < 10.0**digits - 0.5:
        return f"{value:.{digits}g}"
    return f"{float(f'{value:.{digits - 1}e}'):,.0f}"


def check_array(name: str, value: ArrayLike, shape: tuple[int | None, ...], dtype: type = np.float64) -> NDArray[Any]:
    """`value` as a contiguous read-only array of `dtype`; None in `shape` is a free axis. Copied
    unless it is all this already and cannot be written to through another array.

    Raises BadInput when the shape differs, with the count and the first index when a value is not
    finite in `dtype`, or when `dtype` is whole numbers and a value is not one of them.
    """
    array = _convert(name, value, dtype)
    fits = array.ndim == len(shape) and all(want is None or want == got for want, got in zip(shape, array.shape, strict=True))
    if not fits:
        wanted = ", ".join("any" if want is None else str(want) for want in shape)
        raise BadInput(f"{name} has shape {array.shape}, expected ({wanted}): reshape it or check which array was passed.")
    if array.dtype.kind == "f":
        require_finite(name, array)
    array.flags.writeable = False
    return array


def _convert(name: str, value: ArrayLike, dtype: type) -> NDArray[Any]:
    try:
        source = np.asarray(value)
    except (TypeError, ValueError) as error:
        raise BadInput(f"{name} is not an array of numbers: {error}: give rows of equal length.") from error
    if source.dtype.kind not in "biuf":
        raise BadInput(f"{name} has elements of type {source.dtype}, expected numbers: convert them first.")
    # A double beyond float32 becomes infinite here and is then refused with a count, instead of a
    # warning about a cast.
    is_ours = not source.flags.writeable and source.base is None and source.flags.c_contiguous
    if is_ours and source.dtype == np.dtype[Any](dtype):
        return source
    with np.errstate(over="ignore", invalid="ignore"):
        array: NDArray[Any] = np.array(source, dtype=np.dtype[Any](dtype), order="C")
    if array.dtype.kind in "iu" and not np.array_equal(array, source):
        raise BadInput(f"{name} has values that are no whole numbers of type {array.dtype}: round or clip them first.")
    return array


def require_finite(name: str, array: NDArray[Any]) -> None:
    """Raise BadInput naming the array, count and first index of values that are not finite."""
    is_finite = np.isfinite(array)
    if not is_finite.all():
        bad = ~is_finite
        first = tuple(int(axis[0]) for axis in np.nonzero(bad))
        raise BadInput(f"{name} has {int(bad.sum())} values that are not finite, the first at index {first}: remove them first.")


def unit_quats(quats: ArrayLike) -> FloatArray:
    """Quaternions wxyz (N,4) of length 1; a zero quaternion becomes the identity."""
    quats = np.asarray(quats, dtype=np.float64)
    largest = np.abs(quats).max(axis=-1, keepdims=True, initial=0.0)
    scaled = np.where(largest > 0, quats / np.where(largest > 0, largest, 1.0), np.array([1.0, 0.0, 0.0, 0.0]))
    return scaled / np.linalg.norm(scaled, axis=-1, keepdims=True)


def rotmats_from_quats(quats: ArrayLike) -> FloatArray:
    """Rotation matrices (N,3,3) of quaternions wxyz (N,4) of any length; identity for zero."""
    w, x, y, z = np.moveaxis(unit_quats(quats), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
