#!/usr/bin/env bash
# pye57: the bounds of a scan that is written with a rotation are not those of its points.
#
# An E57 keeps each scan in the scanner's system, a pose, and `cartesianBounds`, the box around
# the points in that same system. One would expect a writer to take least and largest coordinates.
# `write_scan_raw` with `rotation` and `translation` turns the two corners of that box into the
# world's system and stores them as they come out: after a quarter turn about the vertical the
# least x is above the largest x. Points and pose are right, so pye57 itself reads the scan well.
# It matters to who writes scans of several stands: a program that plans its octree, its tiles or
# a first view by the bounds gets an empty box, or one in another place.
# Seen on 2026-12-01 with pye57 0.4.19: "points: [[1.0, 4.0], [2.0, 8.0], [3.0, 6.0]]", "bounds:
# [[98.0, 92.0], [1.0, 4.0], [3.0, 6.0]]".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "pye57==0.4.19" "numpy>=2,<3"
cd "$folder"
venv/bin/python - <<'PYTHON'
import sys
from importlib.metadata import version

import numpy as np
import pye57

corners = np.array([[1.0, 2.0, 3.0], [4.0, 8.0, 6.0]])
quarter_turn = np.array([0.5**0.5, 0, 0, 0.5**0.5])
file = pye57.E57("scan.e57", mode="w")
points = {f"cartesian{axis}": corners[:, number] for number, axis in enumerate("XYZ")}
file.write_scan_raw(points, rotation=quarter_turn, translation=np.array([100.0, 0, 0]))
file.close()
file = pye57.E57("scan.e57")
header, raw = file.get_header(0), file.read_scan_raw(0)
bounds = [[header.cartesianBounds[f"{axis}{end}"].value() for end in ("Minimum", "Maximum")] for axis in "xyz"]
stored = [[float(raw[f"cartesian{axis}"].min()), float(raw[f"cartesian{axis}"].max())] for axis in "XYZ"]
print("pye57", version("pye57"))
print(f"points: {stored}")
print(f"bounds: {np.round(bounds, 6).tolist()}")
sys.exit(0 if np.allclose(stored, corners.T) and bounds[0][0] > bounds[0][1] else 1)
PYTHON
