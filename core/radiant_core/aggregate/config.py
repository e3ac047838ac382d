"""`AggregateConfig`: how models are joined at an edge."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from radiant_core.errors import BadInput

AggregatePreset = Literal["default", "paper"]
"""default: opacity and colour at full rate, scale and rotation at a tenth, centres fixed; paper: everything at full rate."""


@dataclass(frozen=True, kw_only=True)
class AggregateConfig:
    """How an edge joins its devices' models."""

    preset: AggregatePreset = "default"
    """Which tensors move, see `AggregatePreset`."""
    num_epochs: int = 10
    """How often each synthetic view is shown (paper Sec. IV-B: 10)."""
    max_num_steps: int | None = None
    """Upper limit of steps whatever the number of views; None for none."""

    def __post_init__(self) -> None:
        if self.preset not in ("default", "paper"):
            raise BadInput(f"aggregate preset {self.preset!r} is unknown: use 'default' or 'paper'.")
        if self.num_epochs < 1 or (self.max_num_steps is not None and self.max_num_steps < 1):
            raise BadInput("num_epochs and max_num_steps of the aggregation must be at least 1.")
