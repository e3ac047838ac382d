"""How many of the photographs' GPS positions a frame rests on, and which not. Once per scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from radiant_core.geometry.align import Alignment
from radiant_core.numerics import FloatArray

FREE_NUMBERS = 3
"""So many positions any similarity fits nearly: their residuals say nothing."""


RECEIVER_M = 1.0
"""Nearer than this to its camera a position is as good as a receiver can be, and counts."""


@dataclass(frozen=True, kw_only=True)
class PositionCount:
    """What a robust fit of camera centres to GPS made of the positions that it was given."""

    num_photographs: int
    num_positions: int
    """Photographs with GPS."""
    num_counting: int
    """Those that the fit keeps; 0 where GPS fixes no frame."""
    left_out: tuple[tuple[str, float], ...] = ()
    """Names of the others and their distance in metres from GPS, the farthest first."""

    @property
    def warning(self) -> tuple[str, ...]:
        """That nothing checks the frame, where too few positions fix it."""
        if not 0 < self.num_counting <= FREE_NUMBERS:
            return ()
        return (
            f"place, scale and north rest on {self.num_counting} GPS positions of {self.num_photographs} photographs: any so few fit, and "
            "nothing says whether they are right.",
        )

    @property
    def record(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "num_photographs": self.num_photographs,
            "num_positions": self.num_positions,
            "num_counting": self.num_counting,
            "left_out": [{"name": name, "away_m": away_m} for name, away_m in self.left_out],
        }


def count_positions(names: tuple[str, ...], positions_m: FloatArray, fit: Alignment, residuals_m: FloatArray | None) -> PositionCount:
    """The count of C photographs with positions (C,3), NaN where there is none, of which `fit` has
    the K others; `residuals_m` (K,) in the frame, None where GPS fixes none."""
    rows = np.flatnonzero(np.isfinite(positions_m[:, 0]))
    if residuals_m is None:
        return PositionCount(num_photographs=len(names), num_positions=len(rows), num_counting=0)
    counts = fit.inliers | (residuals_m <= RECEIVER_M)
    outliers = np.flatnonzero(~counts)
    ordered = outliers[np.argsort(-residuals_m[outliers], kind="stable")]
    return PositionCount(
        num_photographs=len(names),
        num_positions=len(rows),
        num_counting=int(counts.sum()),
        left_out=tuple((names[int(rows[index])], float(residuals_m[index])) for index in ordered),
    )
