"""Cost curves: a time or a size against cameras (paper Sec. III-B, the profiled G, F, H).

    value(c) = constant + linear · c + power_coefficient · c ** exponent,   value(0) = 0

Without cameras a device or edge neither starts nor sends. No coefficient is negative, so curves
never fall. Evaluated once per plan on the counts 0..C.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray


@dataclass(frozen=True, kw_only=True)
class CostCurve:
    """Seconds or bytes against cameras. BadInput for a coefficient below 0 or not finite."""

    constant: float = 0.0
    """Cost of having any work at all."""
    linear: float = 0.0
    """Cost per camera."""
    power_coefficient: float = 0.0
    """Factor of the power term."""
    exponent: float = 1.0
    """Exponent of the power term, 0 to 4."""

    def __post_init__(self) -> None:
        for name in ("constant", "linear", "power_coefficient", "exponent"):
            value = getattr(self, name)
            if not np.isfinite(value) or value < 0:
                raise BadInput(f"cost curve: {name} is {value}, expected a finite number of at least 0.")
        if self.exponent > 4:
            raise BadInput(f"cost curve: exponent is {self.exponent}, expected at most 4.")

    def scaled(self, factor: float) -> CostCurve:
        """The curve times `factor`."""
        return CostCurve(
            constant=self.constant * factor,
            linear=self.linear * factor,
            power_coefficient=self.power_coefficient * factor,
            exponent=self.exponent,
        )

    def __call__(self, num_cameras: ArrayLike) -> FloatArray:
        """Cost for camera counts of any shape."""
        counts = np.asarray(num_cameras, dtype=np.float64)
        cost = self.constant + self.linear * counts + self.power_coefficient * counts**self.exponent
        return np.where(counts > 0, cost, 0.0)
