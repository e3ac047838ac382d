"""`--set NAME=VALUE`: any setting of training by its name in `TrainConfig`, so that every decision can be forced."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, get_type_hints

from pydantic import TypeAdapter, ValidationError

from radiant_core.errors import BadInput
from radiant_core.train.config import TrainConfig

OWN_OPTIONS = {"seed": "--seed", "num_steps": "--steps", "long_side_px": "--long-side-px", "max_num_splats": "--max-splats"}
"""Settings that have an option of their own, which the report names."""


def settings_of(given: Sequence[str]) -> dict[str, Any]:
    """Name → value of each "NAME=VALUE"; "none" is None. BadInput for an unknown name, a value of another kind, or a name twice."""
    hints = get_type_hints(TrainConfig)
    names = [field.name for field in fields(TrainConfig) if field.name not in OWN_OPTIONS]
    settings: dict[str, Any] = {}
    for text in given:
        name, equals, value = text.partition("=")
        name = name.strip().replace("-", "_")
        if not equals or name not in names:
            instead = f"use {OWN_OPTIONS[name]}" if name in OWN_OPTIONS else f"expected NAME=VALUE with one of {', '.join(names)}"
            raise BadInput(f"--set {text!r} is no setting of training: {instead}.")
        if name in settings:
            raise BadInput(f"--set {name} is given twice: keep one of them.")
        try:
            settings[name] = None if value.strip().lower() == "none" and _may_be_none(hints[name]) else _parsed(hints[name], value.strip())
        except ValidationError as error:
            raise BadInput(f"--set {text!r}: {error.errors()[0]['msg'].lower()}.") from error
    return settings


def _may_be_none(hint: Any) -> bool:
    return type(None) in getattr(hint, "__args__", ())


def _parsed(hint: Any, value: str) -> Any:
    return TypeAdapter(hint).validate_strings(value)
