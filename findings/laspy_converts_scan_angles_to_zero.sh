#!/usr/bin/env bash
# laspy: `convert` from a format of LAS 1.2 to one of LAS 1.4 makes every scan angle 0.
#
# Formats 0 to 5 keep the angle as `scan_angle_rank`, whole degrees; 6 to 10 as `scan_angle`,
# steps of 0.006 degrees. One would expect -15 degrees to become -2,500 steps, as other programs
# do. `laspy.convert` copies dimensions of the same name and leaves the rest at 0, which is a
# valid angle: straight down. Back from 7 to 3 it is the same. Likewise points of class 12,
# overlap until LAS 1.3, stay class 12, reserved since, and the flag `overlap` stays 0. Nothing is
# said; `laspy.point.format.lost_dimensions(3, 7)` knows.
# It matters to who makes COPC of older flights, which needs 6 to 8, and then filters or corrects
# intensities by the angle: every point passes. Set both by hand after the conversion.
# Seen on 2026-12-01 with laspy 2.7.0: "degrees [-15, 20] -> steps [0, 0]", "class [12, 2] ->
# class [12, 2], overlap [0, 0]", "steps [-2500, 3333] -> degrees [0, 0]".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "laspy==2.7.0" "numpy>=2,<3"
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import laspy
import numpy as np


def two_points(point_format: int, version: str) -> laspy.LasData:
    las = laspy.LasData(laspy.LasHeader(point_format=point_format, version=version))
    las.x, las.y, las.z = np.array([1.0, 2.0]), np.zeros(2), np.zeros(2)
    return las


old = two_points(3, "1.2")
old.scan_angle_rank, old.classification = np.array([-15, 20], np.int8), np.array([12, 2], np.uint8)
new = laspy.convert(old, point_format_id=7)
steps, classes, overlap = (np.array(new[name]).tolist() for name in ("scan_angle", "classification", "overlap"))
later = two_points(7, "1.4")
later.scan_angle = np.array([-2500, 3333], np.int16)
degrees = np.array(laspy.convert(later, point_format_id=3).scan_angle_rank).tolist()
print("laspy", laspy.__version__)
print(f"degrees [-15, 20] -> steps {steps}")
print(f"class [12, 2] -> class {classes}, overlap {overlap}")
print(f"steps [-2500, 3333] -> degrees {degrees}")
sys.exit(0 if (steps, classes, overlap, degrees) == ([0, 0], [12, 2], [0, 0], [0, 0]) else 1)
PYTHON
