"""Averages what several devices made of one scene. Once per edge and once at the cloud.

Every sender had the same scene and fitted the Gaussians that its photographs show. A parameter of
Gaussian n becomes

    θ_n = Σ_d w_dn θ_dn / Σ_d w_dn

with w_dn the photographs of sender d that show n, 0 if it left n as it was, which is federated
averaging (McMahan 2017) Gaussian by Gaussian. An edge counts those photographs itself, by the
cameras it was sent. Means of means with summed weights are the mean of all, so that edges average
first and the cloud averages the edges, whose weights are rounded down to powers of two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radiant_core.aggregate.arrival import check_splats
from radiant_core.cameras import Cameras, concatenate_cameras
from radiant_core.errors import BadInput
from radiant_core.geometry.coverage import reached_by
from radiant_core.numerics import FloatArray, check_array
from radiant_core.splats import Splats

MAX_MOVE, MAX_GROWTH, MAX_BRIGHTER, MAX_DENSER = 10.0, 1.0, 1.0, 3.0
"""The most that refining may change: place in sizes of the Gaussian, logarithm of its size, first
harmonic, logit of its opacity. In the town 3.2, 0.22, 0.12 and 0.5 were the largest of 45,209."""
NO_CAMERAS = concatenate_cameras([])


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


def average_refinements(refinements: Sequence[Refinement], scene: Splats) -> Refinement:
    """The weighted mean of refinements of `scene` (N), of the Gaussians that
    any of them has. Raises BadInput for one with a `refinement_problem`."""
    total = np.zeros(len(scene))
    sums = {name: np.zeros(array.shape) for name, array in scene.arrays().items()}
    for each in refinements:
        if (problem := refinement_problem(each, scene)) is not None:
            raise BadInput(problem)
        total[each.rows] += each.weights
        # q and −q are one rotation, and their mean none.
        turned = np.sign((each.splats.quats * scene.quats[each.rows]).sum(axis=1, keepdims=True))
        near = replace(each.splats, quats=np.where(turned < 0, -each.splats.quats, each.splats.quats))
        for name, array in near.arrays().items():
            sums[name][each.rows] += array * _per_row(each.weights, array.ndim)
    rows = np.flatnonzero(total)
    arrays = {name: (values[rows] / _per_row(total[rows], values.ndim)).astype(np.float32) for name, values in sums.items()}
    return Refinement(rows=rows, splats=replace(scene.select(rows), **arrays), weights=total[rows].astype(np.float32))


def refinement_problem(refinement: Refinement, scene: Splats, num_dealt: float = float("inf")) -> str | None:
    """Why a refinement does not fit to `scene`, one sentence, or None; one that counts more
    photographs than were dealt would outweigh all others."""
    rows, splats = refinement.rows, refinement.splats
    if not len(rows):
        return None
    if (most := float(refinement.weights.max())) > num_dealt:
        return f"it counts {most:,.0f} photographs of one Gaussian, where {num_dealt:,.0f} were dealt to it."
    if rows[-1] >= len(scene):
        return f"it names Gaussian {rows[-1]:,} of a scene of {len(scene):,}: it is of another scene."
    if splats.sh_degree != scene.sh_degree:
        return f"it has harmonics of degree {splats.sh_degree}, the scene of {scene.sh_degree}."
    return check_splats(splats, NO_CAMERAS)


def admit_refinement(refinement: Refinement, scene: Splats, cameras: Cameras | None = None) -> Refinement:
    """What of a refinement counts: Gaussians that changed no more than refining does and, where the
    sender's `cameras` are known, that these show, weighted by how many of them do.

    A sender cannot change what its photographs do not show, nor outweigh those that show it better.
    """
    rows, after = refinement.rows, refinement.splats
    before = scene.select(rows)
    moved = np.linalg.norm(after.means.astype(np.float64) - before.means, axis=1)
    kept = moved <= MAX_MOVE * np.exp(before.log_scales.astype(np.float64).max(axis=1, initial=-np.inf))
    kept &= (after.log_scales - before.log_scales <= MAX_GROWTH).all(axis=1)
    kept &= (np.abs(after.sh0 - before.sh0) <= MAX_BRIGHTER).all(axis=(1, 2))
    kept &= after.logit_opacities - before.logit_opacities <= MAX_DENSER
    weights = refinement.weights.astype(np.float64)
    if cameras is not None:
        kept &= reached_by(before, cameras)
        # Large ones may show with their centre outside of all pictures.
        weights = np.maximum(_times_shown(before, cameras), 0.5)
    chosen = np.flatnonzero(kept)
    return Refinement(rows=rows[chosen], splats=after.select(chosen), weights=weights[chosen].astype(np.float32))


def join_refinements(refinements: Sequence[Refinement], scene: Splats) -> Refinement:
    """What an edge sends on: the mean of its devices' refinements, with weights rounded down to
    powers of two, which say less of where photographs were taken."""
    mean = average_refinements(refinements, scene)
    return replace(mean, weights=np.exp2(np.floor(np.log2(mean.weights))).astype(np.float32))


def _times_shown(splats: Splats, cameras: Cameras) -> FloatArray:
    """In how many pictures the centre of each Gaussian (N,) lies."""
    times = np.zeros(len(splats))
    for index in range(len(cameras)):
        times += cameras.select([index]).any_sees(splats.means)
    return times


def refine_scene(scene: Splats, refinements: Sequence[Refinement]) -> Splats:
    """`scene` with the mean of its refinements in place; other Gaussians keep their bits."""
    refinement = average_refinements(refinements, scene)
    arrays = {name: array.copy() for name, array in scene.arrays().items()}
    for name, array in refinement.splats.arrays().items():
        arrays[name][refinement.rows] = array
    return replace(scene, **arrays)


def _per_row(values: NDArray[np.floating], ndim: int) -> NDArray[np.float64]:
    return values.astype(np.float64).reshape(-1, *[1] * (ndim - 1))
