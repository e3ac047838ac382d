"""Messages of a step as bytes: what a holder sends up, and what the root sends down.

    up       head, shown Gaussians (a bit each), seen (a byte each, of 256 views or more two),
             [radii], values
    down     head of limits with the step and the Gaussians of the model, limited Gaussians (a bit
             each), log scales; then as up

The values of R Gaussians in K columns are float32; bfloat16 (8 bits of fraction, the range of
float32); or blocks, an exponent for each tensor of a Gaussian and 8 bits for each value. No sender
keeps what it rounded off: one that comes back would have lost it, and nothing is gained by it
(docs/experiments/together.md).

Every length follows from the head and is checked before anything is read, since a sender may be
anybody.
"""

from __future__ import annotations

import struct
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from radiant_core import _native
from radiant_core.choices import StepFormat
from radiant_core.errors import BadInput
from radiant_core.train.together.gradients import Layout, StepGradients
from radiant_core.train.together.replica import Limits

_FORMATS: tuple[StepFormat, ...] = get_args(StepFormat)
_HEAD = struct.Struct("<4sBxHIQQd")
"""Mark, format, views, Gaussians shown, Gaussians of the model, step, loss."""
_LIMITS = struct.Struct("<4sIQQ")
"""Mark, Gaussians limited, step, Gaussians of the model."""
_MARK, _LIMITS_MARK = b"RSG1", b"RSL2"


def encode_gradients(gradients: StepGradients, step: int, num_splats: int, layout: Layout, form: StepFormat) -> bytes:
    """The message of a step (from 0) of a model of `num_splats` Gaussians."""
    row_mask = np.zeros(num_splats, bool)
    row_mask[gradients.rows] = True
    head = _HEAD.pack(_MARK, _FORMATS.index(form), gradients.num_views, len(gradients.rows), num_splats, step, gradients.loss)
    parts = [head, np.packbits(row_mask).tobytes(), gradients.view_counts.astype(_seen_type(gradients.num_views)).tobytes()]
    if layout.with_radii and gradients.radii_px is not None:
        parts.append(gradients.radii_px.astype(np.float32).tobytes())
    parts.append(_encode_values(gradients.values, layout, form))
    return b"".join(parts)


def peek_gradients(message: bytes | memoryview) -> tuple[int, int] | None:
    """Of which step and of how many Gaussians gradients say they are; None where they are none."""
    if len(message) < _HEAD.size:
        return None
    mark, _, _, _, count, step, _ = _HEAD.unpack_from(message)
    return (step, count) if mark == _MARK else None


def decode_gradients(
    message: bytes | memoryview, step: int, num_splats: int, layout: Layout, most_views: int, *, checks: bool = True
) -> StepGradients:
    """What `encode_gradients` wrote. BadInput where it is not of this step and model, or says what
    `most_views` views cannot; unless `checks`, values that are not finite are left to Adam, which
    refuses them."""
    if len(message) < _HEAD.size:
        raise BadInput(f"the gradients of a step are {len(message)} bytes, expected {_HEAD.size} or more.")
    mark, form_index, num_views, num_rows, count, of_step, loss = _HEAD.unpack_from(message)
    if mark != _MARK or form_index >= len(_FORMATS):
        raise BadInput("what came for a step is no gradients: its sender has another version.")
    if (num_views, num_rows, count, of_step) == (0, 0, 0, step) and len(message) == len(encode_nothing(step)):
        return StepGradients.nothing(layout)
    if (count, of_step) != (num_splats, step):
        raise BadInput(f"gradients are of step {of_step} and {count} Gaussians, expected step {step} and {num_splats}.")
    if num_views > most_views or num_rows > num_splats or (num_rows and not num_views):
        raise BadInput(f"gradients of {num_views} views and {num_rows} Gaussians came, expected at most {most_views} and {num_splats}.")
    form = _FORMATS[form_index]
    bits = -(-num_splats // 8)
    radii_bytes = 4 * num_rows if layout.with_radii else 0
    seen_bytes = num_rows * _seen_type(num_views).itemsize
    expected = _HEAD.size + bits + seen_bytes + radii_bytes + num_rows * _bytes_per_row(layout, form)
    if len(message) != expected:
        raise BadInput(f"the gradients of a step are {len(message)} bytes, expected {expected}.")
    at = _HEAD.size
    rows = _rows_of(message, at, num_splats, num_rows)
    at += bits
    view_counts = np.frombuffer(message, _seen_type(num_views), num_rows, at).astype(np.uint16)
    at += seen_bytes
    if num_rows and view_counts.max() > num_views:
        raise BadInput(f"a Gaussian is seen in {view_counts.max()} of {num_views} views: the gradients of a step are damaged.")
    radii = np.frombuffer(message, np.float32, num_rows, at).copy() if layout.with_radii else None
    values = _decode_values(message, at + radii_bytes, num_rows, layout, form)
    gradients = StepGradients(num_views=num_views, loss=loss, rows=rows, values=values, view_counts=view_counts, radii_px=radii)
    if checks and not gradients.is_finite:
        raise BadInput(f"gradients of step {step + 1} are not finite.")
    return gradients


def _seen_type(num_views: int) -> np.dtype:
    """Of how often a Gaussian is seen in so many views."""
    return np.dtype(np.uint8 if num_views < 256 else "<u2")


def encode_nothing(step: int) -> bytes:
    """The message of who does not know how many Gaussians the model has, and sums no view."""
    return _HEAD.pack(_MARK, 0, 0, 0, 0, step, 0.0)


def peek_total(total: bytes | memoryview) -> tuple[int, int] | None:
    """Of which step and of how many Gaussians the root's message of a step is; None: it is none."""
    if len(total) < _LIMITS.size:
        return None
    mark, _, step, num_splats = _LIMITS.unpack_from(total)
    return (step, num_splats) if mark == _LIMITS_MARK else None


def encode_limits(limits: Limits | None, step: int, num_splats: int) -> bytes:
    """What stands before the sum of a step, with the axes that are shortened, if any are."""
    if limits is None or not len(limits.rows):
        return _LIMITS.pack(_LIMITS_MARK, 0, step, num_splats)
    limited = np.zeros(num_splats, bool)
    limited[limits.rows] = True
    return (
        _LIMITS.pack(_LIMITS_MARK, len(limits.rows), step, num_splats)
        + np.packbits(limited).tobytes()
        + limits.log_scales.astype(np.float32).tobytes()
    )


def decode_limits(message: bytes | memoryview, step: int, num_splats: int) -> tuple[Limits | None, int]:
    """The limits at the start of a message, and how many bytes they take; BadInput if damaged."""
    if len(message) < _LIMITS.size:
        raise BadInput(f"the sum of a step is {len(message)} bytes, expected {_LIMITS.size} or more.")
    mark, count, of_step, of_count = _LIMITS.unpack_from(message)
    if mark != _LIMITS_MARK:
        raise BadInput("what came for a step is no sum of gradients: its sender has another version.")
    if (of_step, of_count) != (step, num_splats) or count > num_splats:
        raise BadInput(f"the sum is of step {of_step} and {of_count} Gaussians, expected step {step} and {num_splats}.")
    if not count:
        return None, _LIMITS.size
    bits = -(-num_splats // 8)
    end = _LIMITS.size + bits + 12 * count
    if len(message) < end:
        raise BadInput(f"the sum of a step is {len(message)} bytes, expected {end} or more.")
    rows = _rows_of(message, _LIMITS.size, num_splats, count)
    scales = np.frombuffer(message, np.float32, 3 * count, _LIMITS.size + bits).reshape(count, 3).copy()
    if not np.isfinite(scales).all():
        raise BadInput("the sum of a step has axes that are not finite.")
    return Limits(rows=rows, log_scales=scales), end


def _rows_of(message: bytes | memoryview, at: int, num_splats: int, count: int) -> NDArray[np.int64]:
    bits = np.frombuffer(message, np.uint8, -(-num_splats // 8), at)
    rows = np.flatnonzero(np.unpackbits(bits, count=num_splats))
    if len(rows) != count:
        raise BadInput(f"a message of a step marks {len(rows)} Gaussians, expected {count}.")
    return rows


def _bounds(layout: Layout) -> NDArray[np.int64]:
    """Where the columns of each tensor, and of growth, begin, and the end."""
    return np.array([*(columns.start for columns in layout.columns.values()), layout.growth, layout.num_columns], np.int64)


def _bytes_per_row(layout: Layout, form: StepFormat) -> int:
    if form == "blocks":
        return layout.num_columns + len(_bounds(layout)) - 1
    return layout.num_columns * (4 if form == "float32" else 2)


def _encode_values(values: NDArray[np.float32], layout: Layout, form: StepFormat) -> bytes:
    if form == "float32":
        return values.astype(np.float32).tobytes()
    if form == "bfloat16":
        short = np.empty(values.shape, np.uint16)
        _native.to_bfloat16(np.ascontiguousarray(values, np.float32), short)
        return short.tobytes()
    bounds = _bounds(layout)
    exponents, fractions = np.empty((len(values), len(bounds) - 1), np.uint8), np.empty(values.shape, np.int8)
    _native.to_blocks(np.ascontiguousarray(values, np.float32), bounds, exponents, fractions)
    return exponents.tobytes() + fractions.tobytes()


def _decode_values(message: bytes | memoryview, at: int, num_rows: int, layout: Layout, form: StepFormat) -> NDArray[np.float32]:
    shape = (num_rows, layout.num_columns)
    if form == "float32":
        return np.frombuffer(message, np.float32, num_rows * layout.num_columns, at).reshape(shape).copy()
    if form == "bfloat16":
        values = np.empty(shape, np.float32)
        _native.from_bfloat16(np.frombuffer(message, np.uint16, num_rows * layout.num_columns, at).reshape(shape), values)
        return values
    bounds = _bounds(layout)
    num_groups = len(bounds) - 1
    exponents = np.frombuffer(message, np.uint8, num_rows * num_groups, at).reshape(num_rows, num_groups)
    fractions = np.frombuffer(message, np.int8, num_rows * layout.num_columns, at + num_rows * num_groups).reshape(shape)
    values = np.empty(shape, np.float32)
    _native.from_blocks(exponents, fractions, bounds, values)
    return values
