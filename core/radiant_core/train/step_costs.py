"""How long the steps of a training take beside each other, so that its progress is one of time.

    a step at progress p takes  n(p) · (3/4 + 1/4 s(p)²)

n: Gaussians that the plan of growth and thinning allows, s: share of the image size. A step of the
town takes 20 ms at its start and 84 where Gaussians are most (docs/experiments/training.md): steps
alone would promise at a third of them half of the time that is left.
"""

from __future__ import annotations

import numpy as np

from radiant_core.train.config import TrainConfig
from radiant_core.train.densify.policies import Adc
from radiant_core.train.densify.thinning import ROUNDS

PIXELS_SHARE = 0.25
"""Of the time of a step at full size, what pixels take that half the size saves."""
NUM_POINTS = 400
"""Points of progress between which the time is taken as a line."""


class StepCosts:
    """The share of a training's time that is spent at each share of its steps."""

    def __init__(self, config: TrainConfig, num_first: int) -> None:
        """`num_first`: Gaussians of the start."""
        # Of a budget of time, progress is a share already.
        progress = np.linspace(0, 1, NUM_POINTS)
        costs = np.ones(NUM_POINTS) if config.budget_s is not None else _costs(config, num_first, progress)
        spent = np.concatenate([[0.0], np.cumsum((costs[1:] + costs[:-1]) / 2)])
        self._progress, self._spent = progress, spent / spent[-1]

    def spent_at(self, progress: float) -> float:
        """The share of the time, 0 to 1, after that share of the steps."""
        return float(np.interp(progress, self._progress, self._spent))


def _costs(config: TrainConfig, num_first: int, progress: np.ndarray) -> np.ndarray:
    size = np.where(progress < config.full_size_from, config.start_scale, 1.0)
    return _splats_at(config, num_first, progress) * (1 - PIXELS_SHARE + PIXELS_SHARE * np.square(size))


def _splats_at(config: TrainConfig, num_first: int, progress: np.ndarray) -> np.ndarray:
    """Gaussians by plan; ones where growth follows none."""
    policy = config.density
    if not (isinstance(policy, Adc) and policy.kind == "planned"):
        return np.ones_like(progress)
    first, last = (step / config.schedule_steps for step in (policy.from_step, policy.until_step))
    counts = np.interp(progress, [first, max(last, first + 1e-9)], [num_first, max(num_first, config.max_num_splats)])
    share = 1.0 if policy.thin_to == "auto" else policy.thin_to
    for begins in ROUNDS:
        counts *= np.where(progress > last + begins * (1 - last), share ** (1 / len(ROUNDS)), 1.0)
    return counts
