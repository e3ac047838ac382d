"""Which model owns a place: its region's, unless another one saw it better, and only one that has
something there. Once per join.

Cameras cover the sky and the horizon that others modelled, at a depth of which nobody knows more,
and what is hidden from them. Were those handed over, a model's Gaussians would fade for an owner
that shows nothing in their place: the sample town lost 2.6 dB in a photograph with a hole in its
sky. What a model has is counted in cells of the contracted space

    c(x) = x for |x| ≤ 1, (2 − 1/|x|) x/|x| beyond,      x from the middle of all cameras, in half
                                                         of the diagonal of their box

(Barron et al., mip-NeRF 360), as the sum of the opacities in 3 × 3 × 3 of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import uniform_filter

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.geometry.coverage import coverage
from radiant_core.numerics import check_array
from radiant_core.plan.regions.claims import Claims
from radiant_core.splats import Splats

KEPT_COVERAGE = 0.8
"""An owner keeps a place that its cameras cover at least this well, compared with the best."""
CONTESTED_COVERAGE = 0.1
"""A place is contested where a second model covers it this well, compared with the best."""
NUM_CELLS = 32
"""Cells of the contracted space along each axis; 16 and 64 joined the town to within 0.1 dB."""
KNOWN_SHARE = 0.3
"""An owner has something in a place where its opacities sum up to this share of the model's whose
the place is asked about; 0.1 and 0.7 joined the town to within 0.1 dB."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Ownership:
    """Of P places: owner (P,) a model's index; contested (P,) where a second one covers it too."""

    owner: NDArray[np.int64]
    contested: NDArray[np.bool_]

    def at(self, chosen: NDArray[np.bool_]) -> Ownership:
        """Of the places where `chosen` (P,) is true."""
        return Ownership(owner=self.owner[chosen], contested=self.contested[chosen])


def ownership(places: ArrayLike, cameras: Sequence[Cameras], claims: Claims | None = None) -> Ownership:
    """Owners of places (P,3) m by `claims` of regions, without them the model that covers it best.

    A place that no camera sees belongs to the region's owner, to the first model without claims.
    Raises BadInput without models.
    """
    if not cameras:
        raise BadInput("no cameras of any model were given to say whose a place is: pass one set per model.")
    checked = check_array("places", places, (None, 3))
    covered = np.stack([coverage(checked, model_cameras) for model_cameras in cameras], axis=1)
    best = covered.max(axis=1)
    owner = covered.argmax(axis=1)
    if claims is not None:
        claimed = claims(checked[:, :2])
        keeps = covered[np.arange(len(checked)), claimed] >= KEPT_COVERAGE * best
        owner = np.where(keeps, claimed, owner)
    second = np.partition(covered, -2, axis=1)[:, -2] if len(cameras) > 1 else np.zeros(len(checked))
    return Ownership(owner=owner, contested=(second > 0) & (second >= CONTESTED_COVERAGE * best))


def find_owners(models: Sequence[Splats], cameras: Sequence[Cameras], claims: Claims | None = None) -> list[Ownership]:
    """Owners of the places of every model's Gaussians, as `ownership`; a Gaussian stays its own
    model's where the owner has nothing."""
    owned = [ownership(model.means, cameras, claims) for model in models]
    centers = np.concatenate([model_cameras.centers for model_cameras in cameras])
    radius = max(float(np.linalg.norm(np.ptp(centers, axis=0))) / 2, float(np.finfo(np.float32).tiny))
    cells = [_cells_of((model.means.astype(np.float64) - centers.mean(axis=0)) / radius) for model in models]
    present = [_sum_nearby(cell, model.opacities) for cell, model in zip(cells, models, strict=True)]
    owners = []
    for index, (places, cell) in enumerate(zip(owned, cells, strict=True)):
        of_owner = np.stack([nearby[cell] for nearby in present])[places.owner, np.arange(len(cell))]
        nothing = of_owner < KNOWN_SHARE * present[index][cell]
        owners.append(Ownership(owner=np.where(nothing, index, places.owner), contested=places.contested))
    return owners


def _cells_of(places: NDArray[np.floating]) -> NDArray[np.int64]:
    """The cells (N,) of places (N,3) in units of the radius."""
    far = np.maximum(np.linalg.norm(places, axis=1, keepdims=True), 1.0)
    contracted = places / far * (2 - 1 / far)
    rows = np.clip(((contracted + 2) / 4 * NUM_CELLS).astype(np.int64), 0, NUM_CELLS - 1)
    return np.asarray(np.ravel_multi_index(tuple(rows.T), (NUM_CELLS,) * 3), np.int64)


def _sum_nearby(cells: NDArray[np.int64], opacities: NDArray[np.floating]) -> NDArray[np.float64]:
    """By cell, the sum of the opacities in it and in those around it."""
    sums = np.bincount(cells, opacities, NUM_CELLS**3).reshape((NUM_CELLS,) * 3)
    return uniform_filter(sums, 3, mode="constant").ravel() * 27
