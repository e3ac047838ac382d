"""Which of several models speaks for a place: the one whose region it is, unless another one saw it clearly better. Once per join.

    coverage of x by a model's cameras = Σ over the images that show x of  min(1, 4 r) / z · f / width

r is how far inside the image x lies (0 at its rim, 1 in its middle), so that what is only grazed counts little; z is depth. Occlusion does
not count: with depths compared, models whose depths are wrong in places lost those to neighbours that were no better
(docs/experiments/aggregation.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from shapely import Polygon, distance, points

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, checked_array
from radiant_core.plan.power_diagram import assign

KEPT_COVERAGE = 0.8
"""A region's owner speaks for a place that its cameras cover at least this well, compared with those that cover it best."""
CONTESTED_COVERAGE = 0.1
"""A place is contested where a second model's cameras cover it at least this well, compared with the best."""
_RIM = 0.25

Claims = Callable[[FloatArray], NDArray[np.int64]]
"""Positions (P,2) m → whose region each lies in (P,), as the plan says."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Ownership:
    """Of P places: owner (P,) is a model's index; contested (P,) where a second model knows the place too."""

    owner: NDArray[np.int64]
    contested: NDArray[np.bool_]


def ownership(places: ArrayLike, cameras: Sequence[Cameras], claims: Claims | None = None) -> Ownership:
    """Owners of places (P,3) m among models with these cameras; without `claims` of regions, the model that covers it best.

    A place that no camera sees belongs to the region's owner, to the first model without claims. Raises BadInput without models.
    """
    if not cameras:
        raise BadInput("no cameras of any model were given to say whose a place is: pass one set per model.")
    checked = checked_array("places", places, (None, 3))
    covered = np.stack([coverage(checked, own) for own in cameras], axis=1)
    best = covered.max(axis=1)
    owner = covered.argmax(axis=1)
    if claims is not None:
        claimed = claims(checked[:, :2])
        keeps = covered[np.arange(len(checked)), claimed] >= KEPT_COVERAGE * best
        owner = np.where(keeps, claimed, owner)
    second = np.partition(covered, -2, axis=1)[:, -2] if len(cameras) > 1 else np.zeros(len(checked))
    return Ownership(owner=owner, contested=(second > 0) & (second >= CONTESTED_COVERAGE * best))


def coverage(places: ArrayLike, cameras: Cameras) -> FloatArray:
    """How well cameras cover each of the places (P,3) m: the formula above, in image widths per unit of length; 0 where none sees it."""
    places = np.asarray(places, np.float64)
    covered = np.zeros(len(places))
    for K, pose, size_wh in zip(cameras.Ks, cameras.cam_from_world, cameras.sizes_wh, strict=True):
        in_camera = places @ pose[:3, :3].T + pose[:3, 3]
        depth = in_camera[:, 2]
        in_front = depth > 0
        pixels = (in_camera @ K.T)[:, :2] / np.where(in_front, depth, 1.0)[:, None]
        inside = 1 - np.abs(2 * pixels / size_wh - 1).max(axis=1)
        seen = in_front & (inside > 0)
        covered[seen] += np.minimum(1.0, inside[seen] / _RIM) * K[0, 0] / size_wh[0] / depth[seen]
    return covered


def claims_of_cells(sites: FloatArray, weights: FloatArray) -> Claims:
    """Claims of the cells of a power diagram, sites (M,2) m and weights (M,) m²."""
    sites = checked_array("sites", sites, (None, 2))
    weights = checked_array("weights", weights, (len(sites),))
    return lambda positions: assign(positions, sites, weights)


def claims_of_polygons(polygons: Sequence[FloatArray]) -> Claims | None:
    """Claims of polygons (V,2) m; a position in none of them goes to the nearest, the first of equals. None where none has corners."""
    areas = {index: Polygon(polygon) for index, polygon in enumerate(polygons) if len(polygon) > 2}
    if not areas:
        return None
    indices = np.array(list(areas), np.int64)

    def claim(positions: FloatArray) -> NDArray[np.int64]:
        places = points(positions)
        return indices[np.argmin([distance(area, places) for area in areas.values()], axis=0)]

    return claim
