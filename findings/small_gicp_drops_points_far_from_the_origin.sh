#!/usr/bin/env bash
# small_gicp: downsampling leaves one point of a cloud in UTM, and `align` says it converged.
#
# Voxels are numbered in 21 bits along each axis, about the origin of the coordinates, not about the
# cloud: what lies farther than 1,048,576 voxels from the origin is taken out. With voxels of 1 m
# that is every place north of 1,049 km in UTM, with 0.25 m every one north of 262 km, and all those
# points together come back as one. Python gets a cloud and no exception; a line on the standard
# error per point is all there is. `align` downsamples by itself: `converged` is True from one
# inlier, and the clouds stay apart.
# It matters to who registers flights or scans in projected coordinates: take off a local origin,
# and put it back into the transformation.
# Seen on 2026-12-01 with small_gicp 1.0.1: "at the origin: 5000 -> 2369 points, align: converged
# True, 4051 inliers, 0.000 m off", "in UTM: 5000 -> 1 points, align: converged True, 1 inliers,
# 0.901 m off".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "small_gicp==1.0.1" "numpy>=2,<3"
"$folder/venv/bin/python" - 2>"$folder/errors" <<'PYTHON'
import sys
from importlib.metadata import version

import numpy as np
import small_gicp

random = np.random.default_rng(0)
ground = np.zeros((5000, 3))
ground[:, :2] = random.uniform(0, 50, (5000, 2))
ground[:, 2] = 2 * np.sin(ground[:, 0] / 5) + 2 * np.cos(ground[:, 1] / 7)
turn, middle = np.radians(1), ground.mean(axis=0)
rotation = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
moved = (ground - middle) @ rotation.T + middle + [0.3, -0.2, 0.1]
print("small_gicp", version("small_gicp"))
seen = {}
for name, origin in (("at the origin", [0, 0, 0]), ("in UTM", [500000, 5800000, 50])):
    left = small_gicp.voxelgrid_sampling(ground + origin, 1.0).size()
    sizes_m = {"downsampling_resolution": 0.5, "max_correspondence_distance": 2.0}
    result = small_gicp.align(ground + origin, moved + origin, registration_type="GICP", **sizes_m)
    back = (moved + origin) @ result.T_target_source[:3, :3].T + result.T_target_source[:3, 3]
    off_m = float(np.linalg.norm(back - (ground + origin), axis=1).max())
    seen[name] = left, result.converged, result.num_inliers, off_m
    print(f"{name}: 5000 -> {left} points, align: converged {result.converged}, {result.num_inliers} inliers, {off_m:.3f} m off")
(near, near_done, _, near_m), (far, far_done, far_inliers, far_m) = seen.values()
sys.exit(0 if near > 1000 and near_done and near_m < 0.01 and far == 1 and far_done and far_inliers == 1 and far_m > 0.5 else 1)
PYTHON
