"""How a view in perspective moves: about a place, sideways, towards a place, by itself. Per frame.

Every motion keeps the horizon level: afterwards the upward vector is that of the world, z, and the
view is at most `STEEPEST_DEG` off the horizontal. A view that a camera left rolled is levelled by
its first turn. Direction for azimuth a from north and elevation e upwards:

    forward = (sin a cos e, cos a cos e, sin e)
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from radiant_core.numerics import FloatArray
from radiant_viewer.pictures.view_pose import ViewPose

STEEPEST_DEG = 89.5
NEAREST = 1e-3
"""Least distance that zooming leaves to the focal point."""
LEVEL = np.array([0.0, 0.0, 1.0])
Side = Literal["top", "south", "east", "north", "west", "below"]
SIDE_KEYS: tuple[tuple[int, Side, str], ...] = (
    (1, "top", "above, north up"), (2, "south", "the south"), (3, "east", "the east"), (4, "north", "the north"),
    (5, "west", "the west"), (6, "below", "below"),
)  # fmt: skip
SIDES_DEG: dict[Side, tuple[float, float]] = {
    "top": (180.0, STEEPEST_DEG), "south": (180.0, 20.0), "east": (90.0, 20.0), "north": (0.0, 20.0), "west": (270.0, 20.0),
    "below": (180.0, -STEEPEST_DEG),
}  # fmt: skip
"""Azimuth from north and elevation of the eye: level, one would see the scene's edge alone."""


def forward_angles_deg(pose: ViewPose) -> tuple[float, float]:
    """Azimuth from north and elevation of the viewing direction; straight down the azimuth is that
    of the upward vector."""
    forward = pose.rotation[2]
    flat = forward if np.hypot(*forward[:2]) > 1e-6 else -np.sign(forward[2]) * -pose.rotation[1]
    return float(np.degrees(np.arctan2(flat[0], flat[1]))), float(np.degrees(np.arcsin(np.clip(forward[2], -1, 1))))


def forward_of(azimuth_deg: float, elevation_deg: float) -> FloatArray:
    """The direction (3,) of two angles; elevations beyond `STEEPEST_DEG` are cut."""
    azimuth, elevation = np.radians([azimuth_deg, np.clip(elevation_deg, -STEEPEST_DEG, STEEPEST_DEG)])
    return np.array([np.sin(azimuth) * np.cos(elevation), np.cos(azimuth) * np.cos(elevation), np.sin(elevation)])


def orbit(pose: ViewPose, right_deg: float, up_deg: float, pivot: FloatArray | None = None) -> ViewPose:
    """Turn the view about a place (3,), else its focal point, so that the scene follows the hand:
    to the right and upwards by angles. The pivot keeps its place in the picture."""
    about = pose.focal_point if pivot is None else pivot
    azimuth, elevation = forward_angles_deg(pose)
    before, level = pose.rotation, _levelled(pose, azimuth, elevation)
    after = _levelled(pose, azimuth + right_deg, elevation - up_deg).rotation
    if not np.allclose(level.rotation, before, atol=1e-6):
        before = level.rotation
        pose = replace(level, position=pose.position, focal_point=pose.position + pose.distance * before[2])
    position = about + after.T @ before @ (pose.position - about)
    return replace(pose, position=position, focal_point=position + pose.distance * after[2], up=LEVEL)


def look(pose: ViewPose, right_deg: float, up_deg: float) -> ViewPose:
    """Turn the head: the position stays."""
    azimuth, elevation = forward_angles_deg(pose)
    forward = forward_of(azimuth + right_deg, elevation + up_deg)
    return replace(pose, focal_point=pose.position + pose.distance * forward, up=LEVEL)


def shift(pose: ViewPose, by: FloatArray) -> ViewPose:
    """Move position and focal point by (3,) of the world."""
    return replace(pose, position=pose.position + by, focal_point=pose.focal_point + by)


def pan(pose: ViewPose, right_px: float, up_px: float, height_px: int, depth: float | None = None) -> ViewPose:
    """Drag what lies at a depth, else the focal point's, by pixels of a picture so high."""
    per_px = 2 * np.tan(np.radians(pose.angle_deg) / 2) * (pose.distance if depth is None else depth) / height_px
    right, down, _ = pose.rotation
    return shift(pose, per_px * (-right_px * right + up_px * down))


def zoom_to(pose: ViewPose, place: FloatArray, factor: float) -> ViewPose:
    """Come nearer to a place (3,), which keeps its pixel: distances times `factor`."""
    factor = max(factor, NEAREST / pose.distance)
    position = place + factor * (pose.position - place)
    return replace(pose, position=position, focal_point=position + factor * pose.distance * pose.rotation[2])


def fly(pose: ViewPose, right: float, forward: float, up: float) -> ViewPose:
    """Move along the view's own right and forward, and upwards in the world."""
    return shift(pose, right * pose.rotation[0] + forward * pose.rotation[2] + up * LEVEL)


def focus(pose: ViewPose, place: FloatArray, share: float = 0.5) -> ViewPose:
    """Look at a place (3,) from the same direction, the distance to it times `share`."""
    distance = max(float(np.linalg.norm(place - pose.position)) * share, NEAREST)
    azimuth, elevation = forward_angles_deg(pose)
    return replace(pose, position=place - distance * forward_of(azimuth, elevation), focal_point=np.array(place, np.float64), up=LEVEL)


def place_at(pose: ViewPose, pixel: tuple[float, float], size_wh: tuple[int, int], depth: float) -> FloatArray:
    """The place (3,) under a pixel (x, y from the upper left) at a depth along the view."""
    width, height = size_wh
    per_px = 2 * np.tan(np.radians(pose.angle_deg) / 2) / height
    right, down, forward = pose.rotation
    return pose.position + depth * (forward + per_px * ((pixel[0] - width / 2) * right + (pixel[1] - height / 2) * down))


def _levelled(pose: ViewPose, azimuth_deg: float, elevation_deg: float) -> ViewPose:
    return replace(pose, position=np.zeros(3), focal_point=pose.distance * forward_of(azimuth_deg, elevation_deg), up=LEVEL)
