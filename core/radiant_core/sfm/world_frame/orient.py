"""The world frame that follows from up: metric by positions, or unscaled. Once per scene."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.frames import Sim3
from radiant_core.georef.given_frame import offset_of
from radiant_core.numerics import FloatArray

MEDIAN_DEPTH_UNITS = 10.0
"""Median distance from a camera to the points it sees, in a frame without GPS."""
KEPT_DISTANCES = (0.1, 1000.0)
MAX_KEPT_LEAN_DEG = 5.0
"""Ground slopes, and whoever made the model knew up from more than its photographs."""
NUM_REFITS = 30


def unscaled_from_world(cameras: Cameras, points: FloatArray, observations: NDArray[np.int64], up: FloatArray) -> Sim3:
    """Similarity to z up, the median point at the origin, a median camera–point distance of 10
    units. Points (P,3), observations (T,2): point, camera index. Raises BadInput when nothing is
    observed at a distance."""
    distances = np.linalg.norm(points[observations[:, 0]] - cameras.centers[observations[:, 1]], axis=1)
    typical = float(np.median(distances)) if len(distances) else 0.0
    if not typical > 0:
        raise BadInput("the sparse model has no point at a distance from its cameras: take photographs that overlap from several places.")
    rotation = level_rotation(up)
    scale = MEDIAN_DEPTH_UNITS / typical
    return Sim3(scale=scale, rotation=rotation, translation=-scale * rotation @ np.median(points, axis=0))


def kept_from_world(cameras: Cameras, points: FloatArray, observations: NDArray[np.int64], lean_deg: float) -> Sim3 | None:
    """The frame of a given model as it is, but for a whole offset where it lies far out: where its
    z is up to `lean_deg` and the median camera–point distance is a length that training is used to
    (`KEPT_DISTANCES`). None elsewhere."""
    distances = np.linalg.norm(points[observations[:, 0]] - cameras.centers[observations[:, 1]], axis=1)
    if lean_deg > MAX_KEPT_LEAN_DEG or not len(distances) or not KEPT_DISTANCES[0] <= np.median(distances) <= KEPT_DISTANCES[1]:
        return None
    return Sim3(scale=1.0, rotation=np.eye(3), translation=-offset_of(np.median(points, axis=0)))


def level_fit(source: FloatArray, target: FloatArray, up: FloatArray) -> Sim3 | None:
    """Similarity source (N,3) → target (N,3) [m] that turns `up` to z, with heading, scale and
    shift from the pairs only: least sum of horizontal distances; the height by the middle of the
    densest half of the heights, which drifting altitudes cannot move. None when the positions do
    not differ horizontally."""
    rotation = level_rotation(up)
    level = source @ rotation.T
    flat_source, flat_target = level[:, 0] + 1j * level[:, 1], target[:, 0] + 1j * target[:, 1]
    weights = np.ones(len(source))
    factor, shift = 0j, 0j
    for _ in range(NUM_REFITS):
        # In the plane a similarity is target = factor · source + shift with one complex factor.
        from_mean = flat_source - np.average(flat_source, weights=weights)
        power = float(weights @ np.square(np.abs(from_mean)))
        factor = complex(np.vdot(from_mean, weights * flat_target)) / power if power > 0 else 0j
        shift = complex(np.average(flat_target - factor * flat_source, weights=weights))
        distances = np.abs(factor * flat_source + shift - flat_target)
        weights = 1 / np.maximum(distances, max(0.01 * float(np.median(distances)), 1e-9 * float(np.abs(flat_target).max()) + 1e-12))
    if abs(factor) < 1e-12:
        return None
    cosine, sine = factor.real / abs(factor), factor.imag / abs(factor)
    heading = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1.0]])
    height = _middle_of_densest_half(target[:, 2] - abs(factor) * level[:, 2])
    return Sim3(scale=abs(factor), rotation=heading @ rotation, translation=np.array([shift.real, shift.imag, height]))


def _middle_of_densest_half(values: FloatArray) -> float:
    """Middle of the shortest interval with half of the values (N,): least median of squares."""
    ordered = np.sort(values)
    half = len(ordered) // 2 + 1
    widths = ordered[half - 1 :] - ordered[: len(ordered) - half + 1]
    first = int(np.argmin(widths))
    return float(ordered[first] + ordered[first + half - 1]) / 2


def level_rotation(up: FloatArray) -> FloatArray:
    """The smallest rotation (3,3) that turns the unit vector `up` to +z."""
    x, y, z = up / np.linalg.norm(up)
    if z < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    return np.array([[1 - x * x / (1 + z), -x * y / (1 + z), -x], [-x * y / (1 + z), 1 - y * y / (1 + z), -y], [x, y, z]])
