"""Thinning after growth: the Gaussians of which photographs show least are left out, in two rounds.

    s_i = Σ over views v of (w_iv / (w_iv + 16 px))²,  w_iv = Σ over pixels of T α
    kept: those of the highest s_i, and all that no view sees, of which photographs say nothing

A sum over views, so that machines that train together add theirs; squared, so that a Gaussian which
makes much of one picture stays before one that makes little of many; bounded, so that it travels
like gradients. w_iv are the pixels that it makes. Gathered until every photograph was shown, or for
a tenth of the run. What is left is fitted on: the town, caliterra and lewis keep their quality with
three quarters of the Gaussians (docs/experiments/training.md). Once per step while a round gathers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

ROUNDS = (0.0, 0.2)
"""Where rounds begin, as shares of the run that is left after growth."""
LONGEST = 0.1
"""A round gathers for at most this share of the run."""
LATEST = 0.8
"""Later in the run nothing is left out, since too few steps would mend it."""
HALF_WAY_PX = 16.0


@dataclass(kw_only=True)
class Thinning:
    """When rounds begin and end, in steps of the schedule, and how far they are."""

    share: float
    """Of the Gaussians that stay after all rounds; 1: there are no rounds."""
    until_step: float
    """The end of growth."""
    schedule_steps: int
    num_views: int
    """Of an epoch."""
    num_begun: int = 0
    num_ended: int = 0
    num_gathered: int = 0
    """Views since the round began."""

    @property
    def share_of_round(self) -> float:
        """Of the Gaussians that stay after each round."""
        return self.share ** (1 / len(ROUNDS))

    @property
    def is_gathering(self) -> bool:
        """Whether a round has begun and not ended."""
        return self.num_begun > self.num_ended

    def begins(self, schedule_step: float) -> bool:
        """Whether a round begins after this step; it does."""
        if self.share >= 1 or self.is_gathering or self.num_begun == len(ROUNDS) or schedule_step < self._start(self.num_begun):
            return False
        self.num_begun, self.num_gathered = self.num_begun + 1, 0
        return True

    def has_enough(self, schedule_step: float) -> bool:
        """Whether all views were gathered, or as much as a round may take."""
        # From the middle of an epoch on, so many views show each photograph at least once.
        last_step = self._start(self.num_begun - 1) + LONGEST * self.schedule_steps
        return self.num_gathered >= 2 * self.num_views - 1 or schedule_step >= last_step

    def ends(self, schedule_step: float) -> bool:
        """End the round; whether Gaussians are left out."""
        self.num_ended = self.num_begun
        return schedule_step <= LATEST * self.schedule_steps

    def _start(self, number: int) -> float:
        return self.until_step + ROUNDS[number] * (self.schedule_steps - self.until_step)


def squashed(weights_px: NDArray[np.floating]) -> NDArray[np.floating]:
    """What a view adds to s, from the pixels that Gaussians (N,) make of it."""
    return (weights_px / (weights_px + HALF_WAY_PX)) ** 2


def rows_that_stay(scores: NDArray[np.floating], view_counts: NDArray[np.integer], share: float) -> NDArray[np.int64]:
    """The rows, ascending, of the share of the Gaussians that views count with the highest scores
    (N,), and of all that no view counts (N,)."""
    is_seen = view_counts > 0
    seen = np.flatnonzero(is_seen)
    highest = seen[np.argsort(-scores[seen], kind="stable")[: round(share * len(seen))]]
    return np.sort(np.concatenate([highest, np.flatnonzero(~is_seen)]))
