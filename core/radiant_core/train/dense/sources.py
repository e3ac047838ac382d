"""Which photographs a photograph is matched against: those that see the same points from another
side. Once per photograph of a scene.

    score(i, j) = shared points · min(1, α / 5°) · min(1, 15° / α)

α is the median angle under which shared points see the two cameras: too small and depth is
uncertain, too large and the two do not look alike. C cameras, T observations.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene

MIN_SHARED = 10
"""Photographs that share fewer points are not matched."""
BEST_ANGLES_DEG = (5.0, 15.0)
MIN_ANGLE_DEG = 0.5
"""From almost one place there is nothing to measure."""
NUM_COMPARED = 16
"""Of a photograph's partners by shared points, so many are looked at."""
NUM_SAMPLED = 64
"""The angle is that of so many shared points."""


def choose_sources(scene: SfmScene, most: int) -> list[NDArray[np.int64]]:
    """Indices of the partners of each of C cameras, at most `most`, the best first; empty where
    nothing fits."""
    num_cameras = len(scene.cameras)
    # One number per pair sorts several times as fast as pairs.
    point, camera = np.divmod(np.unique(scene.observations @ np.array([num_cameras, 1])), num_cameras)
    sees = csr_matrix((np.ones(len(camera), np.int32), (camera, point)), shape=(num_cameras, len(scene.points)))
    shared = (sees @ sees.T).toarray()
    np.fill_diagonal(shared, 0)
    points_by_camera = [sees.indices[sees.indptr[index] : sees.indptr[index + 1]] for index in range(num_cameras)]
    chosen, is_seen = [], np.zeros(len(scene.points), bool)
    for index in range(num_cameras):
        is_seen[:] = False
        is_seen[points_by_camera[index]] = True
        partners = np.argsort(-shared[index], kind="stable")[:NUM_COMPARED]
        partners = partners[shared[index, partners] >= MIN_SHARED]
        common = [points[is_seen[points]] for points in (points_by_camera[partner] for partner in partners)]
        angles = _angles_deg(scene, common, index, partners)
        low, high = BEST_ANGLES_DEG
        with np.errstate(divide="ignore"):
            scores = shared[index, partners] * np.minimum(1, angles / low) * np.minimum(1, high / angles)
        order = np.argsort(-scores, kind="stable")
        chosen.append(partners[order][angles[order] >= MIN_ANGLE_DEG][:most])
    return chosen


def _angles_deg(
    scene: SfmScene, common: Sequence[NDArray[np.integer]], reference: int, partners: NDArray[np.integer]
) -> NDArray[np.float64]:
    """Median angle (B,) at shared points (one list per partner) between lines to two cameras."""
    if not len(partners):
        return np.zeros(0)
    sampled = [points[:: max(1, len(points) // NUM_SAMPLED)] for points in common]
    counts = [len(points) for points in sampled]
    points, centers = scene.points[np.concatenate(sampled)], scene.cameras.centers
    first, second = _directions(centers[reference], points), _directions(centers[np.repeat(partners, counts)], points)
    angles = np.degrees(np.arccos(np.clip((first * second).sum(axis=1), -1, 1)))
    return np.array([np.median(part) for part in np.split(angles, np.cumsum(counts)[:-1])])


def _directions(centers: FloatArray, points: FloatArray) -> FloatArray:
    lines = points - centers
    return lines / np.maximum(np.linalg.norm(lines, axis=1, keepdims=True), 1e-300)
