#!/usr/bin/env bash
# pypcd4: a coloured cloud that is saved as text is black when it is read again.
#
# A PCD packs red, green and blue into the bits of one float, `rgb`, a number of some 1e-38. pypcd4
# writes floats of a text file with ten decimals, "%.10f", so each colour is written as
# 0.0000000000: places are right to 0.1 nm, the colours are gone, and nothing is said. The same
# cloud saved in its two binary forms keeps them.
# It matters to who picks text to look into a file, to edit or to compare it: one passage through
# it takes every colour. Save binary, or `rgb` as an unsigned whole number.
# Seen on 2026-12-01 with pypcd4 1.5.1: "BINARY: 200 of 200 colours are kept", "BINARY_COMPRESSED:
# 200 of 200 colours are kept", "ASCII: 0 of 200 colours are kept, black: 200".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "pypcd4==1.5.1" "numpy>=2,<3"
cd "$folder"
venv/bin/python - <<'PYTHON'
import sys
from importlib.metadata import version

import numpy as np
from pypcd4 import Encoding, PointCloud

random = np.random.default_rng(0)
places = random.uniform(0, 10, (200, 3)).astype(np.float32)
colours = random.integers(1, 256, (200, 3)).astype(np.uint8)
cloud = PointCloud.from_xyzrgb_points(np.column_stack([places, PointCloud.encode_rgb(colours)]))
print("pypcd4", version("pypcd4"))
kept = {}
for form in (Encoding.BINARY, Encoding.BINARY_COMPRESSED, Encoding.ASCII):
    cloud.save("cloud.pcd", encoding=form)
    again = PointCloud.from_path("cloud.pcd")
    read = PointCloud.decode_rgb(again.pc_data["rgb"])
    kept[form.name] = int((read == colours).all(axis=1).sum())
    black, moved = int((read == 0).all(axis=1).sum()), np.abs(again.numpy(("x", "y", "z")) - places).max()
    print(f"{form.name}: {kept[form.name]} of 200 colours are kept, black: {black}, places moved by {moved:.1g} m")
    if moved > 1e-6:
        sys.exit(1)
sys.exit(0 if kept == {"BINARY": 200, "BINARY_COMPRESSED": 200, "ASCII": 0} and black == 200 else 1)
PYTHON
