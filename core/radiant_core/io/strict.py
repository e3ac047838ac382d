"""What stands in files that others write: checked to the last key, refused in one sentence."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from radiant_core.errors import BadInput


class Strict(BaseModel):
    """Base of what stands in a file: no unknown keys, no numbers as text, nothing infinite."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


def problem_sentence(error: ValidationError, kind: str, path: str = "", given: Any = None) -> str:
    """The first problem at a key's `path` in a `kind` of file: its path, what came and is expected.

    With what was `given`, the path has only keys that stand there, without pydantic's union tags.
    """
    problem = error.errors(include_url=False)[0]
    parts = problem["loc"] if given is None else [*_keys_in(given, problem["loc"], problem["type"] == "missing")]
    key = "".join([path, *(f"[{part}]" if isinstance(part, int) else f".{part}" for part in parts)]).lstrip(".")
    if problem["type"] == "missing":
        return f"{key} is missing: add it."
    if problem["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        return f"{key} is not a key of a {kind}: remove it or correct its spelling."
    cause = problem.get("ctx", {}).get("error")
    if isinstance(cause, BadInput):
        return f"{key}: {cause}"
    text = repr(problem["input"])
    expected = problem["msg"].replace("Input should be", "expected")
    return f"{key} is {text if len(text) <= 60 else text[:57] + '…'}; {expected[0].lower()}{expected[1:]}: correct it."


def _keys_in(given: Any, parts: Sequence[int | str], is_missing: bool) -> Iterator[int | str]:
    """The parts of a place that are keys or indices of what was given; the last may be missing."""
    for number, part in enumerate(parts, 1):
        if isinstance(part, int) or (isinstance(given, dict) and part in given):
            yield part
            given = given[part]
        elif is_missing and number == len(parts):
            yield part
