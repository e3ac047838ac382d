"""Motions of a view keep the horizon level and the place they are about where it is in the picture."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_viewer.pictures import view_motion
from radiant_viewer.pictures.offscreen import fitting_pose
from radiant_viewer.pictures.view_pose import ViewPose

SIZE_WH = (640, 400)
POSE = ViewPose(position=np.array([30.0, -80, 45]), focal_point=np.array([5.0, 3, 1]), up=np.array([0.0, 0, 1]), angle_deg=40.0)
PLACE = np.array([12.0, -4.0, 3.0])


def pixel_of(pose: ViewPose, place: np.ndarray) -> np.ndarray:
    camera = pose.camera(SIZE_WH)
    seen = camera.Ks[0] @ (camera.cam_from_world[0] @ np.append(place, 1.0))[:3]
    return seen[:2] / seen[2]


def test_orbiting_and_zooming_leave_their_place_where_it_is_in_the_picture() -> None:
    before = pixel_of(POSE, PLACE)
    for moved in (view_motion.orbit(POSE, 33, -12, PLACE), view_motion.zoom_to(POSE, PLACE, 0.6)):
        assert np.linalg.norm(moved.position - POSE.position) > 10
        assert pixel_of(moved, PLACE) == pytest.approx(before, abs=1e-6)


def test_no_motion_rolls_the_horizon_or_turns_over() -> None:
    pose = POSE
    for step in range(200):
        pose = view_motion.orbit(pose, 17, 9 if step % 3 else -4, PLACE)
        pose = view_motion.look(view_motion.fly(pose, 0.3, 0.2, 0.1), 5, -7)
        # Right is level: what is left and right of the middle is at one height.
        assert abs(pose.rotation[0][2]) < 1e-9
        assert pose.rotation[1][2] < 0, "the view hangs upside down"


def test_a_rolled_view_is_levelled_where_it_stands() -> None:
    rolled = ViewPose(position=POSE.position, focal_point=POSE.focal_point, up=np.array([0.6, 0.0, 0.8]), angle_deg=40.0)
    level = view_motion.orbit(rolled, 0, 0, PLACE)
    assert level.position == pytest.approx(rolled.position)
    assert level.focal_point == pytest.approx(rolled.focal_point)
    assert abs(level.rotation[0][2]) < 1e-9


def test_what_is_panned_follows_the_pointer() -> None:
    depth = float(POSE.rotation[2] @ (PLACE - POSE.position))
    moved = view_motion.pan(POSE, 31, -17, SIZE_WH[1], depth)
    assert pixel_of(moved, PLACE) - pixel_of(POSE, PLACE) == pytest.approx([31, 17], abs=1e-6)


def test_a_pixel_and_its_depth_give_the_place_and_focus_puts_it_in_the_middle() -> None:
    depth = float(POSE.rotation[2] @ (PLACE - POSE.position))
    x, y = pixel_of(POSE, PLACE)
    assert view_motion.place_at(POSE, (float(x), float(y)), SIZE_WH, depth) == pytest.approx(PLACE)
    focused = view_motion.focus(POSE, PLACE)
    assert pixel_of(focused, PLACE) == pytest.approx([320, 200])
    assert focused.distance == pytest.approx(0.5 * np.linalg.norm(PLACE - POSE.position))


def test_each_side_frames_all_places_and_from_above_north_is_up() -> None:
    places = PLACE + np.array([[0.0, 0, 0], [40, 0, 0], [40, 25, 0], [0, 25, 6]])
    views = {side: fitting_pose(places, SIZE_WH, 30.0, direction) for side, direction in view_motion.SIDES_DEG.items()}
    for side, pose in views.items():
        pixels = np.array([pixel_of(pose, place) for place in places])
        assert ((pixels > 0) & (pixels < np.array(SIZE_WH))).all(), side
        assert ((pixels.max(axis=0) - pixels.min(axis=0)) / SIZE_WH).max() > 0.8, f"from {side} the scene is small"
    assert views["top"].rotation[2][2] < -0.999 and -views["top"].rotation[1][1] > 0.999
    looks = [views[side].rotation[2][:2] for side in ("south", "east", "north", "west")]
    expected = np.array([(0, 1), (-1, 0), (0, -1), (1, 0)]) * np.cos(np.radians(20))
    assert np.array(looks) == pytest.approx(expected, abs=1e-9)
