"""`StepLaw`: how many steps a device trains, by its number of photographs.

    steps(n) = max(least, num_steps · n · D / C)        C photographs on D devices, num_steps each

All devices together take D · num_steps, as with a fixed number each; but a device's time follows
its photographs, which is what a plan divides. The law knows no plan: re-planning keeps it. Once per
plan and per task.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from radiant_core.numerics import FloatArray
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.profiles.curve_fit import fit_curve

LEAST_STEPS = 100
"""Fewer are first rounds of density control; of short runs a quarter of the mean."""
_SAMPLES = 32


@dataclass(frozen=True, kw_only=True)
class StepLaw:
    """Steps against photographs."""

    num_steps: int
    """Of a device with the mean number of photographs."""
    mean_photographs: float
    """Photographs per device of the system."""

    @property
    def per_photograph(self) -> float:
        """Steps for each photograph."""
        return self.num_steps / self.mean_photographs

    @property
    def least(self) -> int:
        """Steps of a device with next to no photographs."""
        return max(1, min(LEAST_STEPS, self.num_steps // 4))

    def steps(self, num_photographs: int) -> int:
        """Steps of a device with so many photographs."""
        return max(self.least, round(self.per_photograph * num_photographs))

    def cost(self, of_fixed: CostCurve, num_steps: int, num_photographs: int) -> CostCurve:
        """The cost of training by this law for up to `num_photographs`, of a curve that holds for
        `num_steps` whatever the number of photographs. The bend at the least steps is left out: a
        cost curve has none."""

        def seconds(counts: FloatArray) -> FloatArray:
            return of_fixed(counts) * self.per_photograph * counts / num_steps

        return curve_through(seconds, num_photographs)


def curve_through(values_of: Callable[[FloatArray], FloatArray], num_photographs: int) -> CostCurve:
    """The cost curve nearest to a function of 1 … `num_photographs` cameras, in relative error; 0
    everywhere where the function is."""
    counts = np.unique(np.geomspace(1, max(num_photographs, 2), _SAMPLES).round())
    values = values_of(counts)
    return fit_curve(counts, values, may_fall=True).curve if values.min() > 0 else CostCurve()
