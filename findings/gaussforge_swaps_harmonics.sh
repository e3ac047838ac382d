#!/usr/bin/env bash
# gaussforge: its compressed PLY has the spherical harmonics in another order than the format's.
#
# A compressed PLY (PlayCanvas, SuperSplat) keeps f_rest_0.. in the order of a plain 3DGS PLY: all
# coefficients of red, then of green, then of blue; gaussforge's own reader takes them so. Its
# writer puts red, green and blue of the first coefficient, then of the second. So PLY -> compressed
# PLY -> PLY by this one library changes the colours that depend on the direction: red gets what was
# green's and blue's. Constant colour, places and sizes are right, and nothing is said; the model
# only shimmers wrongly when one walks round it. Its ksplat and SOG keep the order.
# Seen on 2026-11-29 with gaussforge 0.6.0: "PLY -> ply -> PLY: 0.10 0.20 0.30 0.40 0.50 0.60 0.70
# 0.80 0.90", "PLY -> compressed.ply -> PLY: 0.11 0.39 0.70 0.20 0.52 0.80 0.30 0.61 0.89".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "gaussforge==0.6.0" "numpy>=1.26,<3"
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import gaussforge
import numpy as np

NAMES = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{i}" for i in range(9))]
NAMES += ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]


def harmonics(ply: bytes) -> np.ndarray:
    """f_rest_0.. (9,) of the first Gaussian of a plain PLY of floats."""
    head, data = ply.split(b"end_header\n", 1)
    names = [line.split()[-1] for line in head.decode().splitlines() if line.startswith("property float")]
    row = np.frombuffer(data, dtype="<f4", count=len(names))
    return np.array([row[names.index(f"f_rest_{i}")] for i in range(9)])


row = dict.fromkeys(NAMES, 0.0) | {"opacity": 2.0, "scale_0": -3.0, "scale_1": -3.0, "scale_2": -3.0, "rot_0": 1.0}
row |= {f"f_rest_{i}": 0.1 * (i + 1) for i in range(9)}
rows = np.array([list(row.values()), list(row.values())], dtype="<f4")
rows[1, 0] = 1.0
lines = ["ply", "format binary_little_endian 1.0", "element vertex 2", *(f"property float {name}" for name in NAMES)]
plain = "\n".join([*lines, "end_header\n"]).encode() + rows.tobytes()
forge, given, seen = gaussforge.GaussForge(), harmonics(plain), {}
print("gaussforge", gaussforge.__version__)
for form in ("ply", "ksplat", "sog", "compressed.ply"):
    there = forge.convert(plain, "ply", form)["data"]
    seen[form] = harmonics(forge.convert(there, form, "ply")["data"])
    print(f"PLY -> {form} -> PLY:", " ".join(f"{value:.2f}" for value in seen[form]))
kept = all(np.allclose(seen[form], given, atol=0.05) for form in ("ply", "ksplat", "sog"))
swapped = np.allclose(seen["compressed.ply"], given.reshape(3, 3).T.ravel(), atol=0.05)
sys.exit(0 if kept and swapped else 1)
PYTHON
