#!/usr/bin/env bash
# ahrs: roll, pitch and yaw give one rotation as `Quaternion`, another as `DCM`.
#
# One would expect `Quaternion(rpy=angles)` and `DCM(rpy=angles)` to be the same attitude. The
# quaternion turns by the first angle about x, the second about y, the third about z, as in
# aviation. The matrix turns by the first about z and the third about x: the yaw of a level flight
# becomes a roll. Its `to_rpy` gives neither back, and `dcm2quat` of the same package the inverse of
# what its `to_quaternion` gives. Each result is a proper rotation, so no check of one notices.
# It matters to who makes poses of cameras from the angles of a flight log: stay with `Quaternion`,
# and try one attitude that is known.
# Seen on 2026-12-01 with ahrs 0.4.0: "yaw of 90 degrees: Quaternion: nose to [0, 1, 0], DCM: nose
# to [1, 0, 0]", "roll 10, pitch 20, yaw 30 to DCM and back: [-28.5, -22.2, 1.1]", "to_quaternion
# [0.952, 0.239, 0.189, 0.038], dcm2quat [0.952, -0.239, -0.189, -0.038]".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "ahrs==0.4.0" "numpy>=1.26,<3"
"$folder/venv/bin/python" - <<'PYTHON'
import sys
from importlib.metadata import version

import numpy as np
from ahrs import DCM, Quaternion
from ahrs.common.orientation import dcm2quat

print("ahrs", version("ahrs"))
level = np.radians([0.0, 0.0, 90.0])
nose = np.array([1.0, 0.0, 0.0])
by_quaternion = (Quaternion(rpy=level).to_DCM() @ nose).round(6) + 0.0
by_matrix = (np.asarray(DCM(rpy=level)) @ nose).round(6) + 0.0
print(f"yaw of 90 degrees: Quaternion: nose to {by_quaternion.astype(int).tolist()}, DCM: nose to {by_matrix.astype(int).tolist()}")
angles = np.radians([10.0, 20.0, 30.0])
matrix = DCM(rpy=angles)
reversed_one = Quaternion(rpy=angles[::-1]).to_DCM()
is_reversed = np.allclose(matrix, reversed_one)
print(f"DCM(roll, pitch, yaw) is Quaternion(yaw, pitch, roll): {is_reversed}")
given = np.degrees(matrix.to_rpy())
print(f"roll 10, pitch 20, yaw 30 to DCM and back: {given.round(1).tolist()}")
q, inverse = matrix.to_quaternion(), dcm2quat(np.asarray(matrix))
print(f"to_quaternion {q.round(3).tolist()}, dcm2quat {inverse.round(3).tolist()}")
differ = by_quaternion.tolist() == [0, 1, 0] and by_matrix.tolist() == [1, 0, 0] and is_reversed
lost = np.abs(given - [10, 20, 30]).max() > 5 and np.allclose(inverse, q * [1, -1, -1, -1])
sys.exit(0 if differ and lost else 1)
PYTHON
