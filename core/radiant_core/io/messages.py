"""The codec of messages: frozen dataclasses as JSON and back, checked field by field when they are read. Once per file.

Every dataclass of the core can be a message or a part of one. Types and unknown keys are refused by pydantic,
values by the dataclass itself (`__post_init__`).
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ConfigDict, TypeAdapter, ValidationError

from radiant_core.errors import BadInput
from radiant_core.io.run_store import MAX_JSON_BYTES, parse_json, read_bounded, write_json

Message = TypeVar("Message")
_STRICT = ConfigDict(extra="forbid", strict=False, allow_inf_nan=False)


@cache
def _adapter(kind: type[Any]) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def message_record(message: Any) -> Any:
    """The message as what JSON can hold: dictionaries, lists, numbers, strings and None."""
    return _adapter(type(message)).dump_python(message, mode="json")


def message_of(kind: type[Message], record: Any, name: str = "message") -> Message:
    """The message of the dataclass `kind` that `message_record` wrote.

    Raises:
        BadInput: a field is missing, unknown or of another kind; `name` is what the sentence calls it.
    """
    try:
        return _adapter(kind).validate_python(record)
    except ValidationError as error:
        raise BadInput(_sentence(error, name)) from error


def save_message(path: Path, message: Any) -> None:
    """Write a message as JSON, whole or not at all."""
    write_json(path, message_record(message))


def load_message(kind: type[Message], path: Path) -> Message:
    """Read what `save_message` wrote.

    Raises:
        BadInput: the file is missing, too large, no JSON, or no message of this kind.
    """
    return message_of(kind, parse_json(read_bounded(path, MAX_JSON_BYTES)), str(path))


def _sentence(error: ValidationError, name: str) -> str:
    first = error.errors()[0]
    place = ".".join(str(part) for part in first["loc"])
    return f"{name}{f': {place}' if place else ''}: {first['msg']}."
