"""Exposures that differ between models: a gain and offset per model and channel. Once per join.

    c' = g c + b     g, b = argmin Σ over pairs of pixels  ρ(g_i c_i + b_i − g_j c_j − b_j)
                     Σ over models of g = M, of b = 0

over pixels of some cameras of every model where both models are opaque and their depths agree; ρ is
Cauchy's, by least squares with weights 1 / (1 + (r / s)²), s the median |r|, since models differ by
more than exposure. The gauge keeps the mean of all models.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radiant_core.aggregate.agreement import LONG_SIDE_PX
from radiant_core.aggregate.synthetic_views import Teacher
from radiant_core.numerics import FloatArray
from radiant_core.render.contract import Backend
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import SH_C0, Splats

MIN_LEVELS = 8.0
"""Least difference from the mean, of 255 at mid grey. Three sets as taken had 1 to 6, without gain;
one device three quarters as bright had 22 and gained 0.4 dB (docs/experiments/aggregation.md)."""
MIN_PAIRS = 2_000
"""Pairs of pixels of a model with the others, below which nothing is said of it."""
DEPTH_TOLERANCE, OPAQUE = 0.03, 0.95
NUM_ASKED = 4
NUM_ROUNDS = 10
MAX_PAIRS = 6_000
"""Of all pairs so many are solved for, evenly chosen."""
_RIDGE = 1e-6
"""Per pair, towards g = 1, b = 0: what a single colour leaves open stays."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Balance:
    """gains, offsets (M,3) of M models for colours in 0..1; num_pairs of pixels behind them."""

    gains: FloatArray
    offsets: FloatArray
    num_pairs: int

    @property
    def levels(self) -> float:
        """By how much of 255 the model that differs most is off at mid grey."""
        return float(np.abs(0.5 * self.gains + self.offsets - 0.5).max(initial=0.0) * 255)

    @property
    def is_needed(self) -> bool:
        """Whether that is more than models differ by anyway."""
        return self.levels >= MIN_LEVELS


@dataclass(frozen=True, kw_only=True, eq=False)
class _Pairs:
    """P pairs of pixels: which model (P,) and its colour (P,3), of either."""

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    first_colors: FloatArray
    second_colors: FloatArray

    def select(self, rows: NDArray[np.int64]) -> _Pairs:
        return _Pairs(
            first=self.first[rows], second=self.second[rows], first_colors=self.first_colors[rows], second_colors=self.second_colors[rows]
        )


def exposure_balance(teachers: Sequence[Teacher], backend: Backend = "auto") -> Balance:
    """The exposures of M models; 1 and 0 for all where any shares too few places with others."""
    pairs = _pairs(teachers, backend)
    count = len(teachers)
    balance = Balance(gains=np.ones((count, 3)), offsets=np.zeros((count, 3)), num_pairs=len(pairs.first))
    shared = np.bincount(pairs.first, minlength=count) + np.bincount(pairs.second, minlength=count)
    if count < 2 or shared.min() < MIN_PAIRS:
        return balance
    some = pairs.select(np.unique(np.linspace(0, len(pairs.first) - 1, MAX_PAIRS).astype(np.int64)))
    solved = np.array([_solve_channel(some, channel, count) for channel in range(3)])
    return replace(balance, gains=solved[:, 0::2].T, offsets=solved[:, 1::2].T)


def balance_teachers(teachers: Sequence[Teacher], balance: Balance) -> list[Teacher]:
    """The teachers as if all had been exposed alike."""
    if not balance.is_needed:
        return list(teachers)
    exposed = zip(teachers, balance.gains, balance.offsets, strict=True)
    return [replace(teacher, splats=expose_splats(teacher.splats, gains, offsets)) for teacher, gains, offsets in exposed]


def expose_splats(splats: Splats, gains: FloatArray, offsets: FloatArray) -> Splats:
    """The model whose every colour c is g c + b, gains and offsets (3,)."""
    sh0 = (gains * (0.5 + SH_C0 * splats.sh0.astype(np.float64)) + offsets - 0.5) / SH_C0
    return replace(splats, sh0=sh0.astype(np.float32), shN=(splats.shN * gains).astype(np.float32))


def _pairs(teachers: Sequence[Teacher], backend: Backend) -> _Pairs:
    """What every two of the teachers show at some cameras of the first."""
    models: list[tuple[NDArray[np.int64], NDArray[np.int64]]] = [(np.zeros(0, np.int64), np.zeros(0, np.int64))]
    colors: list[tuple[FloatArray, FloatArray]] = [(np.zeros((0, 3)), np.zeros((0, 3)))]
    for first, teacher in enumerate(teachers):
        if len(teachers) < 2 or not len(teacher.cameras):
            continue
        rows = np.unique(np.linspace(0, len(teacher.cameras) - 1, min(NUM_ASKED, len(teacher.cameras))).astype(np.int64))
        cameras = teacher.cameras.select(rows).scaled(LONG_SIDE_PX)
        renderings = list(render_views(teacher.splats, cameras, backend))
        for second, guest in enumerate(teachers):
            if second == first:
                continue
            for here, there in zip(renderings, render_views(guest.splats, cameras, backend), strict=True):
                near = np.abs(here.depth - there.depth) < DEPTH_TOLERANCE * here.depth
                both = (here.alpha > OPAQUE) & (there.alpha > OPAQUE) & near
                number = int(both.sum())
                models.append((np.full(number, first), np.full(number, second)))
                colors.append((here.image[both].astype(np.float64), there.image[both].astype(np.float64)))
    first_of, second_of = (np.concatenate(side) for side in zip(*models, strict=True))
    first_colors, second_colors = (np.concatenate(side) for side in zip(*colors, strict=True))
    return _Pairs(first=first_of, second=second_of, first_colors=first_colors, second_colors=second_colors)


def _solve_channel(pairs: _Pairs, channel: int, count: int) -> FloatArray:
    """g and b in turn (2M,) of one channel."""
    rows = np.arange(len(pairs.first))
    design = np.zeros((len(rows), 2 * count))
    design[rows, 2 * pairs.first], design[rows, 2 * pairs.first + 1] = pairs.first_colors[:, channel], 1.0
    design[rows, 2 * pairs.second], design[rows, 2 * pairs.second + 1] = -pairs.second_colors[:, channel], -1.0
    gauge = np.zeros((2, 2 * count))
    gauge[0, 0::2], gauge[1, 1::2] = 1.0, 1.0
    plain, ridge = np.tile([1.0, 0.0], count), _RIDGE * len(rows)
    solution: FloatArray = plain
    for _ in range(NUM_ROUNDS):
        residuals = design @ solution
        weights = 1 / (1 + (residuals / max(float(np.median(np.abs(residuals))), 1e-3)) ** 2)
        normal = (design * weights[:, None]).T @ design + ridge * np.eye(2 * count)
        system = np.block([[normal, gauge.T], [gauge, np.zeros((2, 2))]])
        solved = np.linalg.solve(system, np.concatenate([ridge * plain, [count, 0.0]]))
        solution = np.asarray(solved[: 2 * count], np.float64)
    return solution
