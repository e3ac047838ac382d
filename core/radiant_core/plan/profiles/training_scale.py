"""What curves of one training say about another: a step's time by its pixels and Gaussians.

    step_s(P, N) = launch + A · P + B · N            P pixels of an image, N Gaussians
    F(n) = num_steps · step_s(P, N(n)),   H(n) = splat_bytes · N(n)

A profile has F and H of one training, of which A and B follow: photographs cost time through the
Gaussians that they call for alone. Curves of other pixels or Gaussians, taken as they are beside
each other, compare trainings and not machines: an `rtx-3090` at 1,237 px and 39,000 Gaussians a
photograph is no faster than a laptop at 576 px and 660. gsplat's published times fit the law with
8.5 % (the library's source), ours on a CPU with 6.7 % (docs/experiments/planner.md). Once per plan
and profile.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from radiant_core.numerics import FloatArray
from radiant_core.plan.profiles.profile import Profile

_SAMPLES = 16


@dataclass(frozen=True, kw_only=True)
class TrainingSize:
    """The images and Gaussians of a training."""

    long_side_px: int
    splats_of: Callable[[FloatArray], FloatArray]
    """Gaussians (S,) with so many photographs (S,)."""

    def pixels_beside(self, other_px: int) -> float:
        """How many times the pixels of images with another long side, of the same shape."""
        return (self.long_side_px / other_px) ** 2


@dataclass(frozen=True, kw_only=True)
class StepTime:
    """Seconds of a step of one machine at `key.long_side_px`: a part that is always there, one by
    pixels, one by Gaussians."""

    launch_s: float
    pixels_s: float
    splat_s: float
    long_side_px: int

    def seconds(self, size: TrainingSize, counts: FloatArray) -> FloatArray:
        """Seconds (S,) of a step of another training with photographs (S,)."""
        return self.launch_s + self.pixels_s * size.pixels_beside(self.long_side_px) + self.splat_s * size.splats_of(counts)


def step_time(profile: Profile, splat_bytes: float) -> StepTime:
    """The law that a profile's curves of training and bytes follow, with the least relative error
    over the counts that they hold for."""
    from scipy import optimize  # pyright: ignore[reportMissingTypeStubs]

    low, high = profile.train_s.smallest_count, max(profile.train_s.largest_count, profile.train_s.smallest_count + 1)
    counts = np.unique(np.geomspace(low, high, _SAMPLES).round())
    each_s = profile.train_s.curve(counts) / profile.key.num_steps
    launch_s = min(profile.launch_s or 0.0, 0.9 * float(each_s.min()))
    splats = profile.model_bytes.curve(counts) / splat_bytes
    left_s = each_s - launch_s
    terms = np.stack([np.ones_like(splats), splats / splats.max()], axis=1) / left_s[:, None]
    solver: Any = optimize
    parts_s: FloatArray = solver.nnls(terms, np.ones(len(left_s)))[0]
    splat_s = float(parts_s[1] / splats.max())
    return StepTime(launch_s=launch_s, pixels_s=float(parts_s[0]), splat_s=splat_s, long_side_px=profile.key.long_side_px)


def splats_at(profile: Profile, splat_bytes: float, long_side_px: int, max_num_splats: int | None) -> Callable[[FloatArray], FloatArray]:
    """Gaussians of a profile's training with images of another size: as many for each pixel, up to
    a limit."""
    share = (long_side_px / profile.key.long_side_px) ** 2 / splat_bytes
    most = np.inf if max_num_splats is None else float(max_num_splats)
    return lambda counts: np.minimum(profile.model_bytes.curve(counts) * share, most)
