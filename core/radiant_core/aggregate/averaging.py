"""Averages what several devices made of one scene. Once per edge and once at the cloud.

Every sender had the same scene and fitted the Gaussians that its photographs show. A parameter of
Gaussian n becomes

    θ_n = Σ_d w_dn θ_dn / Σ_d w_dn

with w_dn the photographs of sender d that show n, 0 if it left n as it was, which is federated
averaging (McMahan 2017) Gaussian by Gaussian. Means of means with summed weights are the mean of
all, so that edges average first and the cloud averages the edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radiant_core.aggregate.arrival import check_splats
from radiant_core.cameras import concatenate_cameras
from radiant_core.errors import BadInput
from radiant_core.numerics import check_array
from radiant_core.splats import Splats

MAX_GROWTH = 5.0
"""Natural logarithm of the most that a Gaussian may grow; trained ones grow by less than 1."""
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
        if len(rows) and (rows[0] < 0 or (np.diff(rows) <= 0).any() or weights.min() <= 0):
            raise BadInput("a refinement has rows that do not rise from 0 on, or weights that are not positive: send it again.")


def average_refinements(refinements: Sequence[Refinement], scene: Splats) -> Refinement:
    """What an edge sends on: the weighted mean of refinements of `scene` (N), of the Gaussians that
    any of them has. Raises BadInput for one with a `refinement_problem`."""
    total = np.zeros(len(scene))
    sums = {name: np.zeros(array.shape) for name, array in scene.arrays().items()}
    for each in refinements:
        if (problem := refinement_problem(each, scene)) is not None:
            raise BadInput(problem)
        total[each.rows] += each.weights
        for name, array in each.splats.arrays().items():
            sums[name][each.rows] += array * _per_row(each.weights, array.ndim)
    rows = np.flatnonzero(total)
    arrays = {name: (values[rows] / _per_row(total[rows], values.ndim)).astype(np.float32) for name, values in sums.items()}
    return Refinement(rows=rows, splats=replace(scene.select(rows), **arrays), weights=total[rows].astype(np.float32))


def refinement_problem(refinement: Refinement, scene: Splats, num_dealt: float = float("inf")) -> str | None:
    """Why a refinement does not fit to `scene`, one sentence, or None.

    Gaussians that would move farther than the scene is wide, or grow beyond it, are no refinement.
    Nor does one count more photographs than were dealt: it would outweigh all others.
    """
    rows, splats = refinement.rows, refinement.splats
    if not len(rows):
        return None
    if (most := float(refinement.weights.max())) > num_dealt:
        return f"it counts {most:,.0f} photographs of one Gaussian, where {num_dealt:,.0f} were dealt to it."
    if rows[-1] >= len(scene):
        return f"it names Gaussian {rows[-1]:,} of a scene of {len(scene):,}: it is of another scene."
    if splats.sh_degree != scene.sh_degree:
        return f"it has harmonics of degree {splats.sh_degree}, the scene of {scene.sh_degree}."
    width = float(np.ptp(scene.means.astype(np.float64), axis=0).max()) or 1.0
    farthest = float(np.abs(splats.means.astype(np.float64) - scene.means[rows]).max())
    grown = float((splats.log_scales - scene.log_scales[rows]).max())
    if farthest > width or grown > MAX_GROWTH:
        return f"a Gaussian moved by {farthest:.3g} and grew e^{grown:.3g}-fold in a scene {width:.3g} wide: it refines another scene."
    return None if (found := check_splats(splats, NO_CAMERAS)) is None else found


def refine_scene(scene: Splats, refinements: Sequence[Refinement]) -> Splats:
    """`scene` with the mean of its refinements in place; other Gaussians keep their bits."""
    refinement = average_refinements(refinements, scene)
    arrays = {name: array.copy() for name, array in scene.arrays().items()}
    for name, array in refinement.splats.arrays().items():
        arrays[name][refinement.rows] = array
    return replace(scene, **arrays)


def _per_row(values: NDArray[np.floating], ndim: int) -> NDArray[np.float64]:
    return values.astype(np.float64).reshape(-1, *[1] * (ndim - 1))
