"""Where cameras look, and whether strips hold what their devices see.

A camera looks at the median of the sparse points that it observes, by coordinate. How well a plan
fits to what is seen is Cohen's κ (Educational and Psychological Measurement 1960) over all
observations of a sparse point by a camera:

    κ = (s − c) / (1 − c)
    s: share of the observations whose point lies in the strip of the camera's device
    c = Σ_d a_d b_d: the same by chance, a_d of the observations by cameras of device d, b_d of
        points in its strip

1: every device sees its own strip alone; 0: a strip says nothing about what its device sees. Once
per plan, O(T log T) in the observations T.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from radiant_core.numerics import FloatArray
from radiant_core.plan.plans import CloudPlan, EdgePlan, require_plan_of
from radiant_core.plan.regions.claims import claims_of_polygons
from radiant_core.plan.regions.edge_sites import MAX_COORDINATE_M
from radiant_core.scene import SfmScene


def camera_looks(scene: SfmScene) -> FloatArray:
    """Where each camera looks (C,2), in the scene's unit: the median of the points that it
    observes, by coordinate. A camera without points, or with a median that no plan can reach
    (`MAX_COORDINATE_M`), looks at where it stands."""
    stands = np.ascontiguousarray(scene.cameras.centers[:, :2])
    point, camera = scene.observations.T
    counts = np.bincount(camera, minlength=len(stands))
    is_seen = counts > 0
    first, looks = np.cumsum(counts) - counts, stands.copy()
    for axis in (0, 1):
        values = scene.points[point, axis]
        values = values[np.lexsort((values, camera))]
        low, high = (values[(first + offset)[is_seen]] for offset in ((counts - 1) // 2, counts // 2))
        looks[is_seen, axis] = low / 2 + high / 2
    beyond = np.abs(looks).max(axis=1, initial=0) > MAX_COORDINATE_M
    looks[beyond] = stands[beyond]
    return looks


def strip_agreement(scene: SfmScene, cloud: CloudPlan, edges: Sequence[EdgePlan]) -> float | None:
    """Cohen's κ, in −1 to 1, between whose camera observes a point and in whose strip it lies,
    over all observations; a point outside of all strips lies in the nearest. An edge that has not
    dealt its cameras counts as one device. None without observations, and where one device has all
    cameras and points. Raises BadInput for a plan of other cameras."""
    require_plan_of(len(scene.cameras), cloud, edges)
    owner, polygons = np.zeros(len(scene.cameras), np.int64), list[FloatArray]()
    for plan, border in zip(edges, cloud.borders, strict=True):
        owner[plan.camera_indices] = len(polygons) + (plan.device_of_camera if plan.dealt else 0)
        polygons += plan.strips if plan.dealt else (border,)
    claims = claims_of_polygons(polygons)
    if claims is None or not len(scene.observations):
        return None
    point, camera = scene.observations.T
    return _kappa(owner[camera], claims(scene.points[:, :2])[point], len(polygons))


def _kappa(first: NDArray[np.int64], second: NDArray[np.int64], count: int) -> float | None:
    """Cohen's κ of two labellings (T,) by labels below `count`; None where both have one label."""
    a, b = (np.bincount(labels, minlength=count) / len(labels) for labels in (first, second))
    by_chance = float(a @ b)
    return None if by_chance >= 1 else float(((first == second).mean() - by_chance) / (1 - by_chance))
