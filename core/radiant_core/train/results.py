"""What a training gives: progress, its state between two steps, and the fitted model."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from numpy.typing import NDArray

from radiant_core.splats import Splats
from radiant_core.train.densify.policies import DensityCounts
from radiant_core.train.shapes import ShapeCounts


@dataclass(frozen=True, kw_only=True)
class TrainProgress:
    """What a training reports about every second."""

    step: int
    num_steps: int
    """Estimated from the steps so far where time is the budget."""
    loss: float
    """Mean loss since the last report."""
    spent: float | None = None
    """Share of the training's time that is spent, by `step_costs.py`; None: that of its steps."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TrainState:
    """All that changes in a run from step to step: arrays by name, and numbers that JSON holds."""

    arrays: dict[str, NDArray[Any]]
    numbers: dict[str, Any]


@dataclass(frozen=True, kw_only=True, eq=False)
class TrainResult:
    """A fitted model and what it took."""

    splats: Splats
    num_steps: int
    first_loss: float
    """Mean loss of the first tenth of the steps."""
    last_loss: float
    """Mean loss of the last tenth."""
    seconds: float
    density: DensityCounts = field(default_factory=DensityCounts)
    """What density control did; zeros without it."""
    shapes: ShapeCounts = field(default_factory=ShapeCounts)
    """How many Gaussians the limits of shape held in the end, and how many dead were removed."""
    num_rolled_back: int = 0
    """Steps that ended in something not finite and were not taken."""
    validation: tuple[tuple[int, float], ...] = ()
    """Step and mean PSNR in dB of the validation views, for each time that they were rendered."""
    best_step: int | None = None
    """Step of the model that is returned, the best by validation; None: the last one."""

    def __repr__(self) -> str:
        return f"TrainResult({self.splats!r}, {self.num_steps:,} steps in {self.seconds:.1f} s, loss {self.last_loss:.4f})"
