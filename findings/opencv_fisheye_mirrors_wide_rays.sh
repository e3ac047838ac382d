#!/usr/bin/env bash
# OpenCV: `fisheye.projectPoints` draws a ray beyond 90 degrees on the opposite side of the picture.
#
# A fisheye of 190 or 220 degrees sees points that lie behind the plane of its lens (z < 0), and in
# the equidistant model, r = f * theta, they have a place: 100 degrees to the right is 1.745 f to
# the right. `projectPoints` divides by z first and takes the arc tangent of the length, so the ray
# comes out as one of 80 degrees to the left, within the picture, without an error and without a
# NaN.
# It matters to who draws a model, masks or residuals into pictures of such a lens: what is behind
# the camera to the right is drawn over what is before it to the left.
# Seen on 2026-11-29 with opencv-contrib-python-headless 5.0.0.93: "80 degrees: 279.3 px right of
# the middle (f * theta: 279.3)", "100 degrees: -279.3 px right of the middle (f * theta: 349.1)".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "opencv-contrib-python-headless==5.0.0.93" "numpy>=2,<3"
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import cv2
import numpy as np

FOCAL_PX, MIDDLE_PX = 200.0, 400.0
intrinsics = np.array([[FOCAL_PX, 0, MIDDLE_PX], [0, FOCAL_PX, MIDDLE_PX], [0, 0, 1]])
print("OpenCV", cv2.__version__)
drawn = {}
for angle_deg in (45, 80, 100, 135):
    theta = np.radians(angle_deg)
    ray = np.array([[[np.sin(theta), 0.0, np.cos(theta)]]])
    place = cv2.fisheye.projectPoints(ray, np.zeros(3), np.zeros(3), intrinsics, np.zeros(4))[0]
    drawn[angle_deg] = float(place[0, 0, 0]) - MIDDLE_PX
    print(f"{angle_deg} degrees: {drawn[angle_deg]:.1f} px right of the middle (f * theta: {FOCAL_PX * theta:.1f})")
right = abs(drawn[80] - FOCAL_PX * np.radians(80)) < 1e-6
mirrored = abs(drawn[100] + drawn[80]) < 1e-6 and abs(drawn[135] + drawn[45]) < 1e-6
sys.exit(0 if right and mirrored else 1)
PYTHON
