"""Fields of JSON that strangers wrote: each is of the kind asked for, or one sentence names it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray

MAX_FILE_BYTES = 1 << 30
MAX_DEPTH_HINT = "nested too deeply"
_ABSENT: Any = object()


def read_text(path: Path) -> str:
    """The text of a file, in UTF-8 with or without a mark; BadInput where it is none or huge."""
    try:
        num_bytes = path.stat().st_size
        if num_bytes > MAX_FILE_BYTES:
            raise BadInput(f"{path} has {num_bytes} bytes, more than the {MAX_FILE_BYTES} that are read: split the project first.")
        return path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise BadInput(f"{path} cannot be read ({error.strerror or error}): check the path.") from None
    except UnicodeDecodeError as error:
        raise BadInput(f"{path} at byte {error.start} is not UTF-8 text: export it again.") from None


def read_json_file(path: Path) -> Any:
    """The content of a JSON file; BadInput where it is none."""
    try:
        return json.loads(read_text(path))
    except ValueError as error:
        raise BadInput(f"{path} is no JSON: {str(error)[:120]}: export it again.") from None
    except RecursionError:
        raise BadInput(f"{path} is no alignment: its JSON is {MAX_DEPTH_HINT}.") from None


class Fields:
    """An object of a JSON file, and the place that messages name."""

    def __init__(self, value: Any, place: str) -> None:
        if not isinstance(value, dict):
            raise BadInput(f"{place} is {_short(value)}, expected an object of keys: export the file again.")
        self.value: dict[str, Any] = value
        self.place = place

    def __contains__(self, key: str) -> bool:
        return self.value.get(key) is not None

    def get(self, key: str) -> Any:
        """What stands there; BadInput where nothing does."""
        if self.value.get(key) is None:
            raise BadInput(f"{self.place} has no {key!r}: expected it there; export the file again.")
        return self.value[key]

    def number(self, key: str, default: float = _ABSENT) -> float:
        """A finite number; `default` where the key is not there."""
        if default is not _ABSENT and key not in self:
            return default
        value = self.get(key)
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e15:
            raise self._mismatch(key, "a number")
        return float(value)

    def whole(self, key: str, default: int = _ABSENT) -> int:
        """A whole number from 0 on, written 640 or 640.0."""
        value = self.number(key, default)
        if value != int(value) or not 0 <= value < 2**53:
            raise self._mismatch(key, "a whole number from 0 on")
        return int(value)

    def text(self, key: str, default: str = _ABSENT) -> str:
        """A text without control characters."""
        if default is not _ABSENT and key not in self:
            return default
        value = self.get(key)
        if not isinstance(value, str) or not value.isprintable():
            raise self._mismatch(key, "a text")
        return value

    def numbers(self, key: str, shape: tuple[int | None, ...]) -> FloatArray:
        """Finite numbers of this shape."""
        return numbers_of(self.get(key), shape, f"{self.place}: {key!r}")

    def object(self, key: str) -> Fields:
        """An object."""
        return Fields(self.get(key), f"{self.place}: {key!r}")

    def objects(self, key: str) -> list[Fields]:
        """A list of objects."""
        value = self.get(key)
        if not isinstance(value, list):
            raise self._mismatch(key, "a list")
        return [Fields(item, f"{self.place}: {key}[{number}]") for number, item in enumerate(value)]

    def items(self, key: str) -> list[tuple[str, Fields]]:
        """The objects of an object, by their keys."""
        return [(name, Fields(item, f"{self.place}: {key}[{name!r}]")) for name, item in self.object(key).value.items()]

    def _mismatch(self, key: str, expected: str) -> BadInput:
        return BadInput(f"{self.place}: {key!r} is {_short(self.value[key])}, expected {expected}: export the file again.")


def numbers_of(value: Any, shape: tuple[int | None, ...], place: str) -> FloatArray:
    """Finite numbers (nested lists) of a shape, whose None is free; BadInput elsewhere."""
    try:
        array = np.array(value)
    except (ValueError, TypeError, OverflowError, RecursionError):
        array = np.array(None)
    fits = array.ndim == len(shape) and all(want is None or want == side for want, side in zip(shape, array.shape, strict=True))
    if not fits and array.size == 0 and shape[0] is None:
        array, fits = np.zeros([side or 0 for side in shape]), True
    if not fits or array.dtype.kind not in "iuf" or not (np.abs(array.astype(np.float64)) < 1e15).all():
        wanted = " × ".join("any" if side is None else str(side) for side in shape)
        raise BadInput(f"{place} is {_short(value)}, expected {wanted} finite numbers: export the file again.")
    return array.astype(np.float64)


def _short(value: Any) -> str:
    text = "an object" if isinstance(value, dict) else "a list" if isinstance(value, list) else repr(value)
    return text if len(text) <= 60 else text[:57] + "…"
