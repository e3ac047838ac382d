"""`Metric`: one measured figure with its unit, direction and tolerance.

A few hundred per run or benchmark; compared once against a blessed list: worse_by = (new − blessed)
for "lower", (blessed − new) for "higher"; a regression is worse_by > tolerance of the new metric.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

from radiant_core.errors import BadInput

Direction = Literal["lower", "higher", "info"]
"""lower: smaller is better; higher: larger is better; info: it is never compared."""

JSON_KEYS = ("key", "value", "unit", "direction")


@dataclass(frozen=True, kw_only=True)
class Metric:
    """One figure. Raises BadInput when the key is empty, the value or tolerance not finite, or the
    direction unknown."""

    key: str
    """Dotted name, for example "raster.S.random.native.fwd_cpu_ms"."""
    value: float
    """The figure, finite; what was not measured is left out."""
    unit: str
    """Unit of the value, for example "dB", "s", "bytes"; "1" for a ratio or count."""
    direction: Direction
    """What counts as better."""
    tolerance: float = 0.0
    """How much worse than blessed is still no regression, in `unit`."""

    def __post_init__(self) -> None:
        if not self.key or not isinstance(self.key, str):
            raise BadInput(f"a metric has the key {self.key!r}: give it a dotted name.")
        if self.direction not in get_args(Direction):
            raise BadInput(f"metric {self.key} has the direction {self.direction!r}: use 'lower', 'higher' or 'info'.")
        if not isinstance(self.unit, str):
            raise BadInput(f"metric {self.key} has the unit {self.unit!r}: give it as text.")
        object.__setattr__(self, "value", _finite_number(self.key, "value", self.value))
        object.__setattr__(self, "tolerance", _finite_number(self.key, "tolerance", self.tolerance))
        if self.tolerance < 0:
            raise BadInput(f"metric {self.key} has the tolerance {self.tolerance}: give zero or more.")


def metrics_to_json(metrics: Sequence[Metric]) -> list[dict[str, str | float]]:
    """List of {key, value, unit, direction} for `write_json`; BadInput when a key comes twice."""
    _by_key(metrics)
    return [{name: getattr(metric, name) for name in JSON_KEYS} for metric in metrics]


def metrics_from_json(rows: Any) -> tuple[Metric, ...]:
    """The metrics of a parsed JSON list, tolerance 0; a BadInput names the row and the reason."""
    if not isinstance(rows, list):
        raise BadInput(f"metrics come as {type(rows).__name__}, expected a list of {{key, value, unit, direction}}.")
    for index, row in enumerate(rows):
        if not isinstance(row, dict) or set(row) != set(JSON_KEYS):
            raise BadInput(f"metric number {index} in the list is not {{key, value, unit, direction}}: write it anew.")
    metrics = tuple(Metric(**row) for row in rows)
    _by_key(metrics)
    return metrics


def regressions(new: Sequence[Metric], blessed: Sequence[Metric]) -> tuple[str, ...]:
    """One sentence per blessed metric that is worse by more than its tolerance or not measured now.

    A key that is only in `new` is no regression. Raises BadInput when the unit or direction of a
    key changed: bless the list anew.
    """
    new_by_key = _by_key(new)
    sentences = []
    for key, old in _by_key(blessed).items():
        now = new_by_key.get(key)
        if now is None:
            if old.direction != "info":
                sentences.append(f"{key} was {old.value:.6g} {old.unit} and is not measured any more.")
            continue
        if (now.unit, now.direction) != (old.unit, old.direction):
            raise BadInput(
                f"metric {key} was {old.unit}/{old.direction} when blessed and is {now.unit}/{now.direction} now: bless it anew."
            )
        if _worse_by(now, old) > now.tolerance:
            sentences.append(
                f"{key} was {old.value:.6g} {old.unit} and is {now.value:.6g} {now.unit}"
                f" ({now.direction} is better, tolerance {now.tolerance:.3g})."
            )
    return tuple(sentences)


def _worse_by(now: Metric, old: Metric) -> float:
    return {"lower": now.value - old.value, "higher": old.value - now.value, "info": -math.inf}[now.direction]


def _by_key(metrics: Sequence[Metric]) -> dict[str, Metric]:
    by_key: dict[str, Metric] = {}
    for metric in metrics:
        if metric.key in by_key:
            raise BadInput(f"metric {metric.key} comes twice: give every figure its own key.")
        by_key[metric.key] = metric
    return by_key


def _finite_number(key: str, name: str, value: Any) -> float:
    try:
        number = float(value) if not isinstance(value, str | bytes | bool) else math.nan
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise BadInput(f"metric {key} has the {name} {value!r}, expected a finite number: leave it out if it was not measured.")
    return number
