"""Averages what several devices made of one scene. Once per edge and once at the cloud.

Every sender had the same scene and fitted the Gaussians that its photographs show. A parameter of
Gaussian n becomes

    θ_n = Σ_d w_dn θ_dn / Σ_d w_dn

with w_dn what n shows in the photographs of sender d, in whole photographs, 0 if it left n as it
was: federated averaging (McMahan 2017) Gaussian by Gaussian. What hardly shows in a photograph is
moved by Adam as far as what fills it, and must not outweigh a device that sees it well. An edge
renders that itself, once, by the cameras it was sent. Means of means with summed weights are the
mean of all, so that edges average first and the cloud averages the edges, whose weights are rounded
down to powers of four.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radiant_core.aggregate.arrival import LARGEST, MAX_LOG_SCALE, check_splats
from radiant_core.cameras import NO_CAMERAS
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array
from radiant_core.splats import SH_BASES, Splats

MAX_MOVE, MAX_TURN_DEG = 0.75, 20.0
MAX_CHANGES = {"log_scales": 0.3, "logit_opacities": 0.75, "sh0": 0.2, "shN": 0.05}
"""The most that refining may change, up or down: place in sizes of the Gaussian, its rotation, and
values of its other parameters. Devices keep to it, so that whatever exceeds it is not theirs."""
MARGIN = 0.97
"""Share of it that devices keep to: an upload in 16 bits rounds."""
ROUNDING = 4.0
"""Weights of edges are rounded down to powers of it."""
ROUNDED_SUM = 1.001
"""The Gaussians of a photograph fill it once at most; their shares are sums of float32."""
SERVER_RATE = 1.5
"""Where the next round starts, in mean changes of this one: a server's rate, as in federated
optimisation (Reddi 2021). A mean falls short of what devices that see a place agree on, since
those that hardly see it hold it back; measured in docs/experiments/aggregation.md."""
BLOCK_ROWS = 65536
"""Gaussians averaged at a time, whose values are float64 meanwhile."""
AVERAGE_PROCESS_BYTES, AVERAGE_COPIES, AVERAGE_BYTES_PER_SPLAT = 140_000_000, 9, 60
"""Of a worker with its libraries; of the scene; beside these."""
RENDER_PROCESS_BYTES, RENDER_BYTES_PER_SPLAT = 300_000_000, 450
"""More where an edge renders what its devices' photographs show: torch, and what a view needs."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Refinement:
    """K refined Gaussians: their rows (K,) of the scene, rising, and their weights (K,) > 0."""

    rows: NDArray[np.int64]
    splats: Splats
    weights: NDArray[np.float32]

    def __post_init__(self) -> None:
        weights = check_array("weights", self.weights, (len(self.splats),))
        rows = np.asarray(self.rows)
        if rows.shape != (len(self.splats),) or rows.dtype != np.int64:
            raise BadInput(f"a refinement has {len(self.splats)} Gaussians and rows {rows.shape} {rows.dtype}: give one row each.")
        if len(rows) and (rows[0] < 0 or (rows[1:] <= rows[:-1]).any() or weights.min() <= 0):
            raise BadInput("a refinement has rows that do not rise from 0 on, or weights that are not positive: send it again.")


def average_bytes(num_splats: int, sh_degree: int, *, renders: bool) -> float:
    """Most bytes of a process that averages refinements of a scene, of however many senders;
    `renders`: as an edge, which renders their weights.

    They are read one after another, so that beside the scene there are only their mean, one of them
    and what it is decoded from: `tests/stress/test_average_memory.py`.
    """
    bytes_per_splat = AVERAGE_COPIES * 4 * (11 + 3 * SH_BASES[sh_degree]) + AVERAGE_BYTES_PER_SPLAT
    if renders:
        return AVERAGE_PROCESS_BYTES + RENDER_PROCESS_BYTES + num_splats * (bytes_per_splat + RENDER_BYTES_PER_SPLAT)
    return AVERAGE_PROCESS_BYTES + num_splats * bytes_per_splat


def average_refinements(refinements: Iterable[Refinement], scene: Splats) -> Refinement:
    """The weighted mean of refinements of `scene` (N), of the Gaussians that
    any of them has. Raises BadInput for one with a `refinement_problem`."""
    mean, weights = _mean(refinements, scene)
    rows = np.flatnonzero(weights)
    return Refinement(rows=rows, splats=mean.select(rows), weights=weights[rows].astype(np.float32))


def _mean(refinements: Iterable[Refinement], scene: Splats) -> tuple[Splats, FloatArray]:
    """`scene` with the running mean of its refinements in place, and their summed weights (N,); of
    an iterator one refinement at a time is held."""
    weights = np.zeros(len(scene))
    mean = {name: array.copy() for name, array in scene.arrays().items()}
    for refinement in refinements:
        if (problem := refinement_problem(refinement, scene)) is not None:
            raise BadInput(problem)
        for start in range(0, len(refinement.rows), BLOCK_ROWS):
            part = slice(start, start + BLOCK_ROWS)
            rows = refinement.rows[part]
            weights[rows] += refinement.weights[part]
            share = refinement.weights[part] / weights[rows]
            # q and −q are one rotation, and their mean none.
            turned = (refinement.splats.quats[part] * scene.quats[rows]).sum(axis=1) < 0
            for name, array in mean.items():
                value = refinement.splats.arrays()[name][part].astype(np.float64)
                if name == "quats":
                    value[turned] *= -1
                before = array[rows].astype(np.float64)
                array[rows] = before + (value - before) * _per_row(share, array.ndim)
    return replace(scene, **mean), weights


def refinement_problem(refinement: Refinement, scene: Splats, num_dealt: float = float("inf")) -> str | None:
    """Why a refinement does not fit to `scene`, one sentence, or None; one whose Gaussians fill
    more photographs than were dealt would outweigh all others."""
    rows, splats = refinement.rows, refinement.splats
    if not len(rows):
        return None
    if (filled := float(refinement.weights.sum(dtype=np.float64))) > num_dealt * ROUNDED_SUM:
        return f"its Gaussians fill {filled:,.1f} photographs, where {num_dealt:,.0f} were dealt to it."
    if rows[-1] >= len(scene):
        return f"it names Gaussian {rows[-1]:,} of a scene of {len(scene):,}: it is of another scene."
    if splats.sh_degree != scene.sh_degree:
        return f"it has harmonics of degree {splats.sh_degree}, the scene of {scene.sh_degree}."
    return check_splats(splats, NO_CAMERAS)


def limit_changes(before: Splats, after: Splats) -> Splats:
    """`after` as near to `before` (N each) as refining may change it; what is nearer keeps its
    bits."""
    shift = after.means.astype(np.float64) - before.means
    far_m = np.linalg.norm(shift, axis=1)
    most_m = MARGIN * MAX_MOVE * np.exp(before.log_scales.astype(np.float64).max(axis=1, initial=-np.inf))
    arrays = {name: array.copy() for name, array in after.arrays().items()}
    chosen = far_m > most_m
    arrays["means"][chosen] = before.means[chosen] + shift[chosen] * (most_m[chosen] / far_m[chosen])[:, None]
    chosen = _turned_deg(before.quats, after.quats) > MARGIN * MAX_TURN_DEG
    arrays["quats"][chosen] = _turned_by(before.quats[chosen], after.quats[chosen], MARGIN * MAX_TURN_DEG)
    for name, most in MAX_CHANGES.items():
        start = before.arrays()[name].astype(np.float64)
        chosen = np.abs(arrays[name] - start) > MARGIN * most
        arrays[name][chosen] = np.clip(arrays[name], start - MARGIN * most, start + MARGIN * most)[chosen]
    return replace(after, **arrays)


def admit_refinement(refinement: Refinement, scene: Splats, shown_shares: NDArray[np.floating] | None = None) -> Refinement:
    """What of a refinement counts: Gaussians that changed no more than refining does and, where it
    is known what the sender's photographs show of the scene's N, `shown_shares` (N,) of each, that
    these show, weighted by it.

    A sender cannot change what its photographs do not show, nor outweigh those that show it better.
    """
    rows, after = refinement.rows, refinement.splats
    is_admitted = np.concatenate(
        [_within_limits(scene, after, rows, start) for start in range(0, len(rows), BLOCK_ROWS)] or [np.zeros(0, bool)]
    )
    weights = refinement.weights if shown_shares is None else shown_shares[rows].astype(np.float32)
    is_admitted &= weights > 0
    chosen = np.flatnonzero(is_admitted)
    admitted = after.select(chosen)
    # A quaternion's length is no part of its rotation, but it is a weight in a mean.
    scene_norms, norms = (
        np.linalg.norm(quats.astype(np.float64), axis=1, keepdims=True) for quats in (scene.quats[rows[chosen]], admitted.quats)
    )
    quats = (admitted.quats * (scene_norms / norms)).astype(np.float32)
    return Refinement(rows=rows[chosen], splats=replace(admitted, quats=quats), weights=weights[chosen])


def _within_limits(scene: Splats, after: Splats, rows: NDArray[np.int64], start: int) -> NDArray[np.bool_]:
    """Which of a block of refined Gaussians, which are `rows` of the scene, changed no more than
    refining does."""
    part = slice(start, start + BLOCK_ROWS)
    before = {name: array[rows[part]].astype(np.float64) for name, array in scene.arrays().items()}
    now = {name: array[part].astype(np.float64) for name, array in after.arrays().items()}
    moved = np.linalg.norm(now["means"] - before["means"], axis=1)
    is_within = moved <= MAX_MOVE * np.exp(before["log_scales"].max(axis=1, initial=-np.inf))
    is_within &= _turned_deg(before["quats"], now["quats"]) <= MAX_TURN_DEG
    for name, most in MAX_CHANGES.items():
        is_within &= (np.abs(now[name] - before[name]) <= most).reshape(len(is_within), -1).all(axis=1)
    return is_within


def _turned_deg(before: NDArray[np.floating], after: NDArray[np.floating]) -> FloatArray:
    """Angles (N,) between rotations by quaternions (N,4) of any length; 180 where one has none."""
    first, second = before.astype(np.float64), after.astype(np.float64)
    lengths = np.linalg.norm(first, axis=1) * np.linalg.norm(second, axis=1)
    cosines = np.abs((first * second).sum(axis=1)) / np.where(lengths > 0, lengths, np.inf)
    return np.rad2deg(2 * np.arccos(np.minimum(cosines, 1.0)))


def _turned_by(before: NDArray[np.float32], after: NDArray[np.float32], angle_deg: float) -> FloatArray:
    """Unit quaternions (N,4) on the way from rotations to others that differ, by that angle."""
    first, second = (
        quats / np.linalg.norm(quats, axis=1, keepdims=True) for quats in (before.astype(np.float64), after.astype(np.float64))
    )
    cosines = (first * second).sum(axis=1, keepdims=True)
    aside = np.where(cosines < 0, -second, second) - first * np.abs(cosines)
    half = np.deg2rad(angle_deg / 2)
    return np.cos(half) * first + np.sin(half) * aside / np.linalg.norm(aside, axis=1, keepdims=True)


def join_refinements(refinements: Iterable[Refinement], scene: Splats) -> Refinement:
    """What an edge sends on: the mean of its devices' refinements, with weights rounded down to
    powers of four, which say less of where photographs were taken."""
    mean = average_refinements(refinements, scene)
    powers = np.floor(np.log2(mean.weights.astype(np.float64)) / np.log2(ROUNDING))
    return replace(mean, weights=(ROUNDING**powers).astype(np.float32))


def refine_scene(scene: Splats, refinements: Iterable[Refinement], previous: Splats | None = None) -> Splats:
    """`scene` with the mean of its refinements in place; other Gaussians are those of `previous`,
    what the round before made, from where `scene` starts further on, or keep their bits."""
    refined, weights = _mean(refinements, scene)
    if previous is None:
        return refined
    others = weights == 0
    arrays = {name: array.copy() for name, array in refined.arrays().items()}
    for name, array in arrays.items():
        array[others] = previous.arrays()[name][others]
    return replace(refined, **arrays)


def start_of_next_round(scene: Splats, refined: Splats) -> Splats:
    """What the devices fit in the round after that which made `refined` of `scene` (N each). It is
    such that what is made of it can be sent: values stay within the limits of `check_splats`."""
    most, arrays = float(np.finfo(np.float32).max), {}
    for name, after in refined.arrays().items():
        start, size = scene.arrays()[name].astype(np.float64), LARGEST.get(name, most)
        largest = MAX_LOG_SCALE if name == "log_scales" else size
        further = np.clip(start + SERVER_RATE * (after - start), -size, largest)
        # Whatever the scene is beyond the limits already is not for a round to change.
        arrays[name] = np.where(np.abs(after) > size, after, further).astype(np.float32)
    return replace(refined, **arrays)


def _per_row(values: NDArray[np.floating], ndim: int) -> NDArray[np.float64]:
    return values.astype(np.float64).reshape(-1, *[1] * (ndim - 1))
