#!/usr/bin/env bash
# opf2colmap (pyopf): a camera that looks straight down has no rotation in the COLMAP model that it
# writes.
#
# With omega = phi = 0 and any kappa the rotation from the scene to a COLMAP camera is a half turn:
# its trace is -1 and the real part of its quaternion is 0. pyopf's converter takes the real part
# from the trace and divides the other three by it, so they are NaN, and with some kappas, where
# rounding makes the root's argument negative, the real part is NaN too. NumPy warns of the
# division; the converter goes on with them.
# It matters as a nadir flight on a stabilized mount has such angles once they are rounded: leave
# out opf2colmap, or take the quaternion from the largest of its four parts. Off the vertical it is
# right but for kappa = 180, phi = 0.
# Seen on 2026-11-29 with pyopf 1.4.1: "omega 1.0, phi 0.0, kappa 30.0: quaternion [0.0084, 0.9659,
# 0.2588, 0.0023], length 1", "omega 0.0, phi 0.0, kappa 30.0: quaternion [0.0, nan, nan, nan],
# length nan", the same for the other kappas.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "pyopf==1.4.1" "tqdm==4.70.1" "numpy>=1.26,<3"
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys
from importlib.metadata import version

import numpy as np
from opf_tools.opf2colmap.converter import orient_pos_computation

print("pyopf", version("pyopf"))


def is_rotation(omega: float, phi: float, kappa: float) -> bool:
    """Whether the quaternion for these angles, degrees, has the length 1."""
    quaternion, _ = orient_pos_computation(np.array([omega, phi, kappa]), np.zeros(3))
    length = float(np.linalg.norm(quaternion))
    print(f"omega {omega}, phi {phi}, kappa {kappa}: quaternion {quaternion.round(4).tolist()}, length {length:.4g}")
    return abs(length - 1) < 1e-6


tilted = [is_rotation(1.0, 0.0, kappa) for kappa in (0.0, 30.0, 90.0)]
nadir = [is_rotation(0.0, 0.0, kappa) for kappa in (0.0, 30.0, 45.0, 60.0, 90.0, 137.0, 180.0)]
turned = is_rotation(1.0, 0.0, 180.0)
sys.exit(0 if all(tilted) and not any(nadir) and not turned else 1)
PYTHON
