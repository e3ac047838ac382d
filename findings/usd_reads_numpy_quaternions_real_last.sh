#!/usr/bin/env bash
# USD: a quaternion is written real part first everywhere but in an array made from NumPy.
#
# `Gf.Quatf(w, x, y, z)` takes the real part first, it is printed that way, and USD's text files say
# (w, x, y, z). Gaussian splats' rot_0..rot_3 have the same order, so one would hand the (N, 4)
# array over as it is. `Vt.QuatfArray.FromNumpy` takes the memory's order, which has the real part
# last: (w, x, y, z) becomes the quaternion with imaginary part (w, x, y) and real part z, and so
# back in `numpy.array`. Each length stays 1, so no check of a rotation notices; every Gaussian is
# just turned some other way.
# It matters to who writes `orientations` of ParticleField3DGaussianSplat or of a PointInstancer in
# bulk: roll the columns by one first.
# Seen on 2026-11-29 with usd-core 26.11: "Gf.Quatf(0.1, 0.3, 0.5, 0.8): real 0.1",
# "FromNumpy([[0.1, 0.3, 0.5, 0.8]]): real 0.8, printed as (0.8, 0.1, 0.3, 0.5)".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "usd-core==26.11" "numpy>=1.26,<3"
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import numpy as np
from pxr import Gf, Usd, Vt

print("USD", ".".join(map(str, Usd.GetVersion())))
wxyz = np.array([[0.1, 0.3, 0.5, 0.8]], dtype=np.float32)
one = Gf.Quatf(*map(float, wxyz[0]))
print(f"Gf.Quatf(0.1, 0.3, 0.5, 0.8): real {one.GetReal():.1f}, printed as {one}")
many = Vt.QuatfArray.FromNumpy(wxyz)[0]
print(f"FromNumpy([[0.1, 0.3, 0.5, 0.8]]): real {many.GetReal():.1f}, printed as {many}")
back = np.array(Vt.QuatfArray([one]))[0]
print("numpy.array of the first one:", np.round(back, 1).tolist())
first = abs(one.GetReal() - 0.1) < 1e-6
sys.exit(0 if first and abs(many.GetReal() - 0.8) < 1e-6 and np.allclose(back, wxyz[0][[1, 2, 3, 0]]) else 1)
PYTHON
