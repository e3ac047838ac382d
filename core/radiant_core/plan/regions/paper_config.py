"""Knobs of the paper's Alg. 1 (`paper_arp`, `other_splits`). Pure: options are made from them."""

from __future__ import annotations

import math
from dataclasses import dataclass

from radiant_core.errors import BadInput


@dataclass(frozen=True, kw_only=True)
class PaperConfig:
    """Knobs of Alg. 1."""

    threshold: float = 0.05
    """T_thres as a share of the mean edge time."""
    boundary_step: float = 0.01
    """d as a share of the longer side of the cameras' bounding box."""
    max_iterations: int = 500
    """Iterations after which the loop gives up."""

    def __post_init__(self) -> None:
        for name in ("threshold", "boundary_step", "max_iterations"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise BadInput(f"paper planner: {name} is {value}, expected a positive number.")
        if self.boundary_step > 1:
            raise BadInput(f"paper planner: boundary_step is {self.boundary_step}, expected a share of the scene's longer side, at most 1.")
