"""A flight through keyframes along smooth curves of position and focal point. Once per frame.

Positions and focal points: PCHIP (Fritsch & Carlson 1980) over time, which never overshoots a
keyframe; the upward vector and the angle are interpolated linearly. Frame f of n: T · f / (n − 1).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from radiant_core.errors import BadInput
from radiant_viewer.pictures.view_pose import ViewPose

MAX_FRAMES = 20_000


def flight_poses(keyframes: Sequence[ViewPose], seconds_per_leg: float, frames_per_s: float) -> list[ViewPose]:
    """Return the poses of a flight, from the first to the last keyframe; BadInput for fewer than
    two keyframes or bad times."""
    if len(keyframes) < 2:
        raise BadInput(f"a flight goes through two keyframes or more, {len(keyframes)} came: move the view and add another.")
    if not (np.isfinite(seconds_per_leg) and seconds_per_leg > 0 and np.isfinite(frames_per_s) and 0 < frames_per_s <= 120):
        raise BadInput(
            f"{seconds_per_leg} s between keyframes at {frames_per_s} frames/s cannot be flown: give positive numbers, up to 120."
        )
    count = round(seconds_per_leg * (len(keyframes) - 1) * frames_per_s) + 1
    if not 2 <= count <= MAX_FRAMES:
        raise BadInput(
            f"the flight would have {count:,} frames, expected 2 to {MAX_FRAMES:,}: change the time per leg or the frames per second."
        )
    from scipy.interpolate import PchipInterpolator

    knots = np.arange(len(keyframes), dtype=np.float64)
    times = np.linspace(0, len(keyframes) - 1, count)
    rows = np.array([[*key.position, *key.focal_point] for key in keyframes])
    places = PchipInterpolator(knots, rows)(times)
    ups = np.array([key.up / np.linalg.norm(key.up) for key in keyframes])
    angles = np.interp(times, knots, [key.angle_deg for key in keyframes])
    frames = []
    for place, time, angle in zip(places, times, angles, strict=True):
        up = np.array([np.interp(time, knots, ups[:, axis]) for axis in range(3)])
        frames.append(_pose(place[:3], place[3:], up, float(angle)))
    return frames


def _pose(position: np.ndarray, focal_point: np.ndarray, up: np.ndarray, angle_deg: float) -> ViewPose:
    forward = focal_point - position
    if np.linalg.norm(np.cross(forward, up)) <= 1e-9 * max(float(np.linalg.norm(forward)), 1e-300):
        # Straight up or down: take the axis farthest from the direction as upward vector.
        up = np.eye(3)[int(np.argmin(np.abs(forward)))]
    if np.linalg.norm(forward) == 0:
        focal_point = position + np.eye(3)[int(np.argmin(np.abs(up)))]
    return ViewPose(position=position, focal_point=focal_point, up=up, angle_deg=angle_deg)
