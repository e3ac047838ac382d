"""`--set NAME=VALUE`: any setting of training by its path in `TrainConfig`, so that every decision can be forced."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from radiant_core.errors import BadInput
from radiant_core.train.config import parse_setting, setting_types

OWN_OPTIONS = {"seed": "--seed", "num_steps": "--steps", "long_side_px": "--long-side-px", "max_num_splats": "--max-splats"}
"""Settings that have an option of their own, which the report names."""


def settings_of(given: Sequence[str]) -> dict[str, Any]:
    """Name → value of each "NAME=VALUE"; "none" is None. BadInput for an unknown name, a value of another kind, or a name twice."""
    names = [name for name in setting_types() if name not in OWN_OPTIONS]
    settings: dict[str, Any] = {}
    for text in given:
        name, equals, value = text.partition("=")
        name = name.strip().replace("-", "_")
        if not equals or name not in names:
            instead = f"use {OWN_OPTIONS[name]}" if name in OWN_OPTIONS else f"expected NAME=VALUE with one of {', '.join(names)}"
            raise BadInput(f"--set {text!r} is no setting of training: {instead}.")
        if name in settings:
            raise BadInput(f"--set {name} is given twice: keep one of them.")
        settings[name] = parse_setting(name, value.strip())
    return settings
