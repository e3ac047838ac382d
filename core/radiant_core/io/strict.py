"""What stands in files that others write: checked to the last key, refused in one sentence."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from typing import Any, get_args

from pydantic import BaseModel, ConfigDict, ValidationError

from radiant_core.errors import BadInput


class Strict(BaseModel):
    """Base of what stands in a file: no unknown keys, no numbers as text, nothing infinite."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


def problem_sentence(error: ValidationError, kind: str, path: str = "", data: Any = None, model: type[BaseModel] | None = None) -> str:
    """The first problem at a key's `path` in a `kind` of file: its path, what came and what is
    expected; by its `model`, the key that was probably meant.

    With what was `data`, the path has only keys that stand there, without pydantic's union tags.
    """
    problem = error.errors(include_url=False)[0]
    parts = problem["loc"] if data is None else [*_keys_in(data, problem["loc"], problem["type"] == "missing")]
    key = "".join([path, *(f"[{part}]" if isinstance(part, int) else f".{part}" for part in parts)]).lstrip(".")
    if problem["type"] == "missing":
        return f"{key} is missing: add it."
    if problem["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        near = [] if model is None else get_close_matches(str(problem["loc"][-1]), _keys_at(model, problem["loc"][:-1]), 1)
        meant = f"did you mean {near[0]}?" if near else "remove it or correct its spelling."
        return f"{key} is not a key of a {kind}: {meant}"
    cause = problem.get("ctx", {}).get("error")
    if isinstance(cause, BadInput):
        return f"{key}: {cause}"
    text = repr(problem["input"])
    expected = problem["msg"].replace("Input should be", "expected")
    return f"{key} is {text if len(text) <= 60 else text[:57] + '…'}; {expected[0].lower()}{expected[1:]}: correct it."


def _keys_at(model: type[BaseModel], place: Sequence[int | str]) -> list[str]:
    """The keys that a model has at a place in it; none where it is no model."""
    for part in place:
        if isinstance(part, str):
            fields = {field.alias or name: field for name, field in model.model_fields.items()}
            inner = (
                []
                if part not in fields
                else [model_type for model_type in _types_in(fields[part].annotation) if issubclass(model_type, BaseModel)]
            )
            if len(inner) != 1:
                return []
            model = inner[0]
    return [field.alias or name for name, field in model.model_fields.items()]


def _types_in(annotation: Any) -> Iterator[type]:
    """The classes in a type, such as `Edge` in `list[Edge] | None`."""
    if isinstance(annotation, type) and not get_args(annotation):
        yield annotation
    for part in get_args(annotation):
        yield from _types_in(part)


def _keys_in(data: Any, parts: Sequence[int | str], is_missing: bool) -> Iterator[int | str]:
    """The parts of a place that are keys or indices of what was given; the last may be missing."""
    for number, part in enumerate(parts, 1):
        # A pair that is too short lacks its second number.
        if (isinstance(data, dict) and part in data) or (isinstance(data, list) and isinstance(part, int) and part < len(data)):
            yield part
            data = data[part]  # pyright: ignore[reportArgumentType, reportCallIssue]
        elif is_missing and number == len(parts):
            yield part
