"""Which model owns a place: its region's, unless another one saw it better. Once per join."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.geometry.coverage import coverage
from radiant_core.numerics import check_array
from radiant_core.plan.regions.claims import Claims

KEPT_COVERAGE = 0.8
"""An owner keeps a place that its cameras cover at least this well, compared with the best."""
CONTESTED_COVERAGE = 0.1
"""A place is contested where a second model covers it this well, compared with the best."""


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
    covered = np.stack([coverage(checked, own) for own in cameras], axis=1)
    best = covered.max(axis=1)
    owner = covered.argmax(axis=1)
    if claims is not None:
        claimed = claims(checked[:, :2])
        keeps = covered[np.arange(len(checked)), claimed] >= KEPT_COVERAGE * best
        owner = np.where(keeps, claimed, owner)
    second = np.partition(covered, -2, axis=1)[:, -2] if len(cameras) > 1 else np.zeros(len(checked))
    return Ownership(owner=owner, contested=(second > 0) & (second >= CONTESTED_COVERAGE * best))
