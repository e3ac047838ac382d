"""Which way is up in a scene, and the world frame that follows: metric from GPS, or unscaled.

Runs once per scene. Up without GPS: photographs are taken level, so their x axes lie in the horizontal plane and
    up = argmin_u Σᵢ (xᵢ · u)²,
which is open when all x axes are parallel (a nadir grid). Then, and wherever it agrees with the cameras, the plane through
most sparse points decides: a photographed site has one dominant ground.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.frames import Sim3
from radiant_core.numerics import FloatArray

MEDIAN_DEPTH_UNITS = 10.0
"""Median distance from a camera to the points it sees, in a frame without GPS."""
MAX_ROLL = np.sin(np.radians(20.0))
NUM_PLANE_TRIALS = 300
NUM_REFITS = 30
MAX_PLANE_POINTS = 5000


@dataclass(frozen=True, kw_only=True, eq=False)
class UpEstimate:
    """Unit vector up (3,) and what it was taken from; roll_deg is the RMS angle of the cameras' x axes to the horizontal."""

    up: FloatArray
    source: Literal["ground plane", "level cameras"]
    roll_deg: float


def estimate_up(cameras: Cameras, points: FloatArray, seed: int = 0) -> UpEstimate:
    """Up in the frame of C cameras and P points (P,3), from the ground plane if the cameras agree, else from the cameras."""
    rotations = cameras.cam_from_world[:, :3, :3]
    _, vectors = np.linalg.eigh(rotations[:, 0].T @ rotations[:, 0] / len(cameras))
    level = vectors[:, 0]
    plane = _dominant_plane(points, seed)
    use_plane = plane is not None and _roll(rotations, plane) < max(MAX_ROLL, 1.5 * _roll(rotations, level))
    up = plane if use_plane and plane is not None else level
    # Photographs are upright (-y towards up) or look down (-z towards up): their sum tells up from down.
    upward = float(-(rotations[:, 1] + rotations[:, 2]).mean(axis=0) @ up)
    return UpEstimate(
        up=up if upward >= 0 else -up,
        source="ground plane" if use_plane else "level cameras",
        roll_deg=roll_deg(cameras, up),
    )


def roll_deg(cameras: Cameras, up: FloatArray) -> float:
    """RMS angle of the x axes of C cameras to the plane across `up`: how far they would be rolled if that were up."""
    return float(np.degrees(np.arcsin(min(1.0, _roll(cameras.cam_from_world[:, :3, :3], up)))))


def unscaled_from_world(cameras: Cameras, points: FloatArray, observations: NDArray[np.int64], up: FloatArray) -> Sim3:
    """Similarity to z up, the median point at the origin and a median camera–point distance of 10 units.

    Points (P,3), observations (T,2): point and camera index. BadInput when nothing is observed at a distance.
    """
    distances = np.linalg.norm(points[observations[:, 0]] - cameras.centers[observations[:, 1]], axis=1)
    typical = float(np.median(distances)) if len(distances) else 0.0
    if not typical > 0:
        raise BadInput("the sparse model has no point at a distance from its cameras: take photographs that overlap from several places.")
    rotation = level_rotation(up)
    scale = MEDIAN_DEPTH_UNITS / typical
    return Sim3(scale=scale, rotation=rotation, translation=-scale * rotation @ np.median(points, axis=0))


def level_fit(source: FloatArray, target: FloatArray, up: FloatArray) -> Sim3 | None:
    """Similarity source (N,3) → target (N,3) [m] that turns `up` to z: heading, scale and shift from the pairs only.

    Least sum of horizontal distances; the height by the middle of the densest half of the heights, which altitudes that
    drift cannot pull away. None when the positions do not differ horizontally.
    """
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
    """Middle of the shortest interval that holds half of the values (N,): the least median of squares in one dimension."""
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


def _roll(rotations: FloatArray, up: FloatArray) -> float:
    return float(np.sqrt(np.mean((rotations[:, 0] @ up) ** 2)))


def _dominant_plane(points: FloatArray, seed: int) -> FloatArray | None:
    """Unit normal (3,) of the plane near most points (RANSAC, then least squares over its points); None under 20 points."""
    if len(points) < 20:
        return None
    rng = np.random.default_rng(seed)
    sample = points[rng.choice(len(points), min(len(points), MAX_PLANE_POINTS), replace=False)]
    middle = np.median(sample, axis=0)
    near = 0.05 * float(np.median(np.linalg.norm(sample - middle, axis=1)))
    best, best_count = None, 2
    for _ in range(NUM_PLANE_TRIALS):
        a, b, c = sample[rng.choice(len(sample), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal)
        if length == 0:
            continue
        within = np.abs((sample - a) @ (normal / length)) < near
        if within.sum() > best_count:
            best, best_count = within, int(within.sum())
    if best is None:
        return None
    return np.linalg.svd(sample[best] - sample[best].mean(axis=0), full_matrices=False)[2][2]
