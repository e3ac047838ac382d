"""`GroupPlan`: machines that train one model together, and how many views each gives to a step.

    views_d    of V a step, dealt so that max_d views_d / speed_d is least, each at least 1
    V          the least number with max_d views_d / speed_d ≤ 1.1 · V / Σ speed, at most 2 D
    steps      views that one machine would take / V

D devices. Photographs are dealt by speeds, as where models are joined, and views follow nearly:
speeds 1 and 0.6 get 38 and 22 of 60 photographs, with 2 and 1 views a step. A model is the worse
the more views a step has: with as many views in all, the town had 28.39 dB with 1, 28.28 with 2,
27.85 with 4 and 27.60 with 8. So V is small: 1 a device where they are equally fast. Once per
plan, O(D log D) but for a few dozen tries.
"""

from __future__ import annotations

import heapq
import itertools
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from radiant_core.errors import BadInput

GroupLevel = Literal["edge", "cloud"]
"""edge: the devices of one edge; cloud: those of all edges, whose edges sum what they send."""
BALANCED = 1.1
"""A step may last so many times what it would with views that could be divided."""
MOST_VIEWS_EACH = 2
"""Views of a step over devices, at most, where speeds are not equal."""
_ROUNDING = 1e-9
"""Relative difference that is rounding."""


@dataclass(frozen=True, kw_only=True)
class GroupPlan:
    """One training of several devices. Raises BadInput for fewer than two devices, for views below
    1, and for a number or time of steps that is not positive."""

    level: GroupLevel
    edges: tuple[str, ...]
    """Ids of the edges that sum what their devices send."""
    views: Mapping[str, int]
    """Device → its views in every step; the sum is divided by all of them. Devices of these edges
    that are not named take no part."""
    num_photographs: int
    """Photographs of all its devices, which the times below are for."""
    num_steps: int
    """Steps of the optimiser, the same for all."""
    step_s: float
    """Predicted seconds of a step, the exchange among them."""
    start_s: float = 0.0
    """Predicted seconds before the first step."""
    end_s: float = 0.0
    """Predicted seconds from the last step to the model at the cloud."""
    overlaps: bool = False
    """Whether views are rendered while the sum of the step before is on its way."""

    def __post_init__(self) -> None:
        if self.level not in get_args(GroupLevel) or not self.edges or (self.level == "edge" and len(self.edges) != 1):
            raise BadInput(f"a group at level {self.level!r} has the edges {self.edges}: expected one edge, or the cloud and its edges.")
        if len(self.views) < 2 or min(self.views.values()) < 1:
            raise BadInput(f"a group trains with the views {dict(self.views)}: expected two devices or more with at least one view each.")
        if min(self.num_steps, self.num_photographs) < 1 or not 0 < self.step_s < np.inf:
            training = f"{self.num_steps} steps of {self.step_s} s on {self.num_photographs} photographs"
            raise BadInput(f"a group trains {training}: expected at least one of each, and a positive time.")
        if not (0 <= self.start_s < np.inf and 0 <= self.end_s < np.inf):
            raise BadInput(f"a group takes {self.start_s} s before its steps and {self.end_s} s after: expected times of at least 0.")

    @property
    def views_a_step(self) -> int:
        """V: views of a step, of all devices."""
        return sum(self.views.values())

    @property
    def seconds(self) -> float:
        """From the start to the model at the cloud, as predicted."""
        return self.start_s + self.num_steps * self.step_s + self.end_s

    def share(self, device: str) -> float:
        """Part of a step's views, and of the photographs, that a device has."""
        return self.views.get(device, 0) / self.views_a_step


def views_of_step(speeds: Sequence[float], num_views: int) -> tuple[int, ...]:
    """Views (D,) of each device in a step of `num_views`, at least 1 each, whose slowest device is
    done first: max views / speed is least. Equal times go to the device named first.

    (1.0, 0.6) and 8 give (5, 3). Raises BadInput for a speed that is not positive and for fewer
    views than devices.
    """
    _require_speeds(speeds)
    if num_views < len(speeds):
        raise BadInput(f"{num_views} views a step are too few for {len(speeds)} devices: give at least one for each.")
    views = [1] * len(speeds)
    # Each step that is drawn has one view more.
    next(itertools.islice(_growing_steps(speeds, views), num_views - len(speeds), None))
    return tuple(views)


def choose_views(speeds: Sequence[float], *, may_idle: bool = False) -> tuple[int, ...]:
    """Views (D,) of a step that keep devices of these speeds busy with as few views as may be.

    `may_idle`: slow devices get none where the others are done with more views a second without
    them; two always work. Raises BadInput as `views_of_step`.
    """
    _require_speeds(speeds)
    order = sorted(range(len(speeds)), key=lambda device: -speeds[device])
    best, most = tuple[int, ...](), 0.0
    for num_working in _numbers_working([speeds[device] for device in order]) if may_idle else [len(speeds)]:
        working = sorted(order[:num_working])
        working_speeds = [speeds[device] for device in working]
        dealt = _few_views(working_speeds)
        rate = sum(dealt) / slowest_s(dealt, working_speeds)
        if rate > most * (1 + _ROUNDING):
            views = dict(zip(working, dealt, strict=True))
            best, most = tuple(views.get(device, 0) for device in range(len(speeds))), rate
    return best


def slowest_s(views: Sequence[int], speeds: Sequence[float]) -> float:
    """Seconds until the last device has rendered its views, at speeds in views a second."""
    return max(count / speed for count, speed in zip(views, speeds, strict=True))


def group_steps(num_views: float, views_a_step: int) -> int:
    """Steps of a group that takes as many views as one machine in `num_views` steps of one view."""
    if not (np.isfinite(num_views) and num_views > 0) or views_a_step < 1:
        raise BadInput(f"{num_views} views in steps of {views_a_step} make no training: give at least one of each.")
    return max(1, round(num_views / views_a_step))


def group_of(groups: Sequence[GroupPlan], device: str) -> GroupPlan | None:
    """The group in which a device trains; None where it trains alone or not at all."""
    return next((group for group in groups if device in group.views), None)


def _few_views(speeds: Sequence[float]) -> tuple[int, ...]:
    """The least number of views, dealt, that is near to balance, else the best balanced one."""
    num_views, least, total = len(speeds), np.inf, sum(speeds)
    counts = range(len(speeds), MOST_VIEWS_EACH * len(speeds) + 1)
    for count, slowest in zip(counts, _growing_steps(speeds, [1] * len(speeds)), strict=False):
        unbalance = slowest * total / count
        if unbalance < least * (1 - _ROUNDING):
            num_views, least = count, unbalance
        if unbalance <= BALANCED:
            break
    return views_of_step(speeds, num_views)


def _growing_steps(speeds: Sequence[float], views: list[int]) -> Iterator[float]:
    """Seconds of steps of D, D + 1, … views, dealt into `views` (D,), which has one for each device
    at first: one more for whoever is done with it first."""
    slowest = slowest_s(views, speeds)
    queue = [(2 / speed, device) for device, speed in enumerate(speeds)]
    heapq.heapify(queue)
    while True:
        yield slowest
        done_s, device = queue[0]
        slowest = max(slowest, done_s)
        views[device] += 1
        heapq.heapreplace(queue, ((views[device] + 1) / speeds[device], device))


def _numbers_working(falling: Sequence[float]) -> list[int]:
    """How many of the fastest may work, by their speeds from the fastest on: all, or those above a
    limit; two at least. A few dozen numbers, however many devices there are."""
    rising, limit, numbers = falling[::-1], falling[0], {len(falling)}
    while limit > falling[-1]:
        limit /= BALANCED
        numbers.add(max(2, len(falling) - bisect_left(rising, limit)))
    return sorted(numbers, reverse=True)


def _require_speeds(speeds: Sequence[float]) -> None:
    if not speeds or not all(np.isfinite(speed) and speed > 0 for speed in speeds):
        raise BadInput(f"devices have the speeds {list(map(float, speeds))}: give each a positive number of views a second.")
