"""The head of a safetensors file, checked before anything is allocated. Once per file.

    8 bytes: length of the header, little-endian
    the header: JSON, name → {dtype, shape, data_offsets}; then the numbers

The library checks much of this too; here the header is bounded, no name comes twice, and the arrays
fill the file exactly. Layout: https://github.com/huggingface/safetensors#format
"""

from __future__ import annotations

import math
import os
import stat
from pathlib import Path
from typing import Any

from radiant_core.errors import StoreDamaged
from radiant_core.io.run_store import open_without_waiting, parse_json

MAX_HEADER_BYTES = 16 * 2**20
"""The names of 500,000 cameras fit."""
MAX_DIMENSIONS = 8
_DTYPES_OF_BYTES = {1: "BOOL U8 I8", 2: "F16 BF16 U16 I16", 4: "F32 U32 I32", 8: "F64 U64 I64"}
_DTYPE_BYTES = {dtype: num_bytes for num_bytes, dtypes in _DTYPES_OF_BYTES.items() for dtype in dtypes.split()}


def require_layout(path: Path) -> None:
    """Raise StoreDamaged unless `path` has a bounded, well-formed header that its arrays fit."""
    try:
        with open(path, "rb", opener=open_without_waiting) as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise StoreDamaged(f"{path} is not a file: name the file itself.")
            num_header = int.from_bytes(file.read(8), "little")
            num_data_bytes = status.st_size - 8 - num_header
            if not (2 <= num_header <= MAX_HEADER_BYTES and num_data_bytes >= 0):
                raise StoreDamaged(_broken_sentence(path, f"it says a header of {num_header} bytes and has {status.st_size} in all"))
            header = file.read(num_header)
    except OSError as error:
        raise StoreDamaged(f"cannot read {path}: {error.strerror or error}: run the stage that writes it again.") from error
    try:
        problem = _problem(parse_json(header), num_data_bytes)
    except (ValueError, RecursionError) as error:
        problem = f"its header is not valid JSON ({str(error)[:80]})"
    if problem:
        raise StoreDamaged(_broken_sentence(path, problem))


def _problem(header: Any, num_bytes: int) -> str | None:
    """What is wrong with a header whose arrays take `num_bytes`; None where nothing is."""
    if not isinstance(header, dict):
        return "its header is no object"
    texts = header.pop("__metadata__", {})
    if not (isinstance(texts, dict) and all(isinstance(text, str) for text in texts.values())):
        return "its metadata are no texts"
    spans = []
    for name, entry in header.items():
        span = _span(entry)
        if span is None:
            return f"its array {name[:40]!r} has no known type, shape and place that fit each other"
        spans.append(span)
    end = 0
    for first, last in sorted(spans):
        if first != end:
            return f"its arrays leave a gap or overlap at byte {end}"
        end = last
    return None if end == num_bytes else f"its arrays take {end} bytes, the file has {num_bytes}"


def _span(entry: Any) -> tuple[int, int] | None:
    """Where an array lies, if its type and shape need exactly that many bytes."""
    if not (isinstance(entry, dict) and entry.keys() == {"dtype", "shape", "data_offsets"}):
        return None
    shape, offsets = entry["shape"], entry["data_offsets"]
    if not (_is_counts(shape) and len(shape) <= MAX_DIMENSIONS and _is_counts(offsets) and len(offsets) == 2):
        return None
    item_bytes = _DTYPE_BYTES.get(entry["dtype"]) if isinstance(entry["dtype"], str) else None
    if item_bytes is None or offsets[1] - offsets[0] != math.prod(shape) * item_bytes:
        return None
    return offsets[0], offsets[1]


def _is_counts(value: Any) -> bool:
    return isinstance(value, list) and all(type(number) is int and 0 <= number < 2**63 for number in value)


def _broken_sentence(path: Path, reason: str) -> str:
    return f"{path} is not a whole safetensors file: {reason}: run the stage that writes it again."
