#!/usr/bin/env bash
# OpenCV 5: `cv2.undistortPointsIter` is gone; what it did is `criteria` of `undistortPoints` now.
#
# In OpenCV 4, Python's `undistortPoints` always stops after five iterations, and
# `undistortPointsIter` is the only way to ask for more. OpenCV 5 has one function with `criteria`,
# which OpenCV 4 refuses as a keyword: code for either fails on the other. Called without criteria,
# both still stop after five iterations, which for a wide lens (k1 = -0.3, 0.9 in x/z) leaves 0.09 px
# of a focal length of 300 px, and nothing says so.
# It matters to everyone who undistorts points to better than a tenth of a pixel.
# Seen on 2026-11-30 with opencv-python-headless 4.14.0.94 and 5.0.0.93.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
cat > seen.py <<'PY'
import sys

import cv2
import numpy as np

K, dist = np.array([[300.0, 0, 320], [0, 300, 240], [0, 0, 1]]), np.array([-0.30, 0.10, 0.001, -0.001, 0.0])
across, down = np.meshgrid(np.linspace(-0.9, 0.9, 19), np.linspace(-0.7, 0.7, 15))
rays = np.stack([across, down], axis=-1).reshape(-1, 1, 2)
pixels = cv2.projectPoints(np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1), np.zeros(3), np.zeros(3), K, dist)[0]
criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-14)


def off_px(undistorted: np.ndarray) -> float:
    return float(300 * np.abs(undistorted - rays).max())


plain_px = off_px(cv2.undistortPoints(pixels, K, dist))
has_iter = hasattr(cv2, "undistortPointsIter")
if has_iter:
    exact_px = off_px(cv2.undistortPointsIter(pixels, K, dist, np.eye(3), np.eye(3), criteria))
else:
    exact_px = off_px(cv2.undistortPoints(pixels, K, dist, criteria=criteria))
try:
    cv2.undistortPoints(pixels, K, dist, criteria=criteria)
    takes_criteria = True
except cv2.error:
    takes_criteria = False
print(
    f"OpenCV {cv2.__version__}: undistortPointsIter is there: {has_iter}; undistortPoints takes criteria: {takes_criteria}; "
    f"off by {plain_px:.2g} px without criteria, {exact_px:.1g} px with"
)
is_five = cv2.__version__.startswith("5")
sys.exit(0 if (has_iter, takes_criteria) == (not is_five, is_five) and plain_px > 0.05 and exact_px < 1e-6 else 1)
PY
for version in 4.14.0.94 5.0.0.93; do
    python3 -m venv "venv-$version"
    "venv-$version/bin/pip" install --quiet "opencv-python-headless==$version"
    "venv-$version/bin/python" seen.py
done
