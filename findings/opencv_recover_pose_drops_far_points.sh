#!/usr/bin/env bash
# OpenCV: `recoverPose` drops every point farther than 50 baselines, and its pose may be turned
# round.
#
# One would expect the pose of the two views, or a sign that it is not known. The call that takes
# the camera matrix counts a point as seen by both cameras only if it is nearer than 50 baselines;
# the documentation of `distanceThresh` does not say that the other calls have one. If all points
# are farther, each of the four candidates has a count of 0, one of them is returned as R and t
# all the same, and which depends on signs inside the decomposition: here R is 180 degrees off
# with exact points. Only the return value, 0, tells.
# It matters to who starts a reconstruction from two frames of a film or of a telephoto lens: 1 m
# apart from 60 m height is beyond the limit. Give `distanceThresh`, and look at the count.
# Seen on 2026-12-01 with opencv-contrib-python-headless 5.0.0.93: "80 baselines, sign +1: 0
# points, R 180.0 degrees off, t [1. 0. 0.]", "distanceThresh=1e6: 300 points, R 0.0 degrees off,
# t [1. 0. 0.]".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "opencv-contrib-python-headless==5.0.0.93" "numpy>=2,<3"
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import cv2
import numpy as np

K = np.array([[1000.0, 0, 500], [0, 1000, 500], [0, 0, 1]])
rotation, moved = cv2.Rodrigues(np.array([0.02, 0.03, 0.01]))[0], np.array([1.0, 0, 0])
rays = np.random.default_rng(0).uniform([-0.4, -0.4, 0.9], [0.4, 0.4, 1.1], (300, 3))
x, y, z = moved
essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ rotation


def pixels(points: np.ndarray) -> np.ndarray:
    drawn = points @ K.T
    return drawn[:, :2] / drawn[:, 2:]


def error_deg(given: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip((np.trace(given @ rotation.T) - 1) / 2, -1, 1))))


print("OpenCV", cv2.__version__)
wrong, far_counts = 0, []
for baselines in (30, 80):
    points = rays * baselines
    pairs = pixels(points), pixels(points @ rotation.T + moved)
    for sign in (1, -1):
        count, turned, direction, _ = cv2.recoverPose(sign * essential, *pairs, K)
        far, far_turned, far_direction = cv2.recoverPose(sign * essential, *pairs, K, distanceThresh=1e6)[:3]
        off = error_deg(turned) > 1 or float(direction.ravel() @ moved) < 0.9
        t, far_t = (way.ravel().round(2) + 0.0 for way in (direction, far_direction))
        print(f"{baselines} baselines, sign {sign:+d}: {count} points, R {error_deg(turned):.1f} degrees off, t {t}")
        print(f"  distanceThresh=1e6: {far} points, R {error_deg(far_turned):.1f} degrees off, t {far_t}")
        if baselines == 80:
            wrong += off
            far_counts.append(count)
        elif off:
            sys.exit(1)
        if far != 300 or error_deg(far_turned) > 0.01:
            sys.exit(1)
sys.exit(0 if wrong and far_counts == [0, 0] else 1)
PYTHON
