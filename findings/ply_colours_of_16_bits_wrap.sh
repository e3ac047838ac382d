#!/usr/bin/env bash
# PLY: VTK and trimesh keep the low byte of colours of 16 bits.
#
# LAS has colours of 16 bits, and a PLY may hold them as they are: `property ushort red`. One would
# expect a reader that wants 8 bits to take the high byte, or to refuse. VTK (`pyvista.read`) and
# trimesh both give the remainder by 256: a grey that rises evenly from 0 to 65,535 comes back as
# noise, 256 is black and 255 is white. White and black themselves come out right, so a look at two
# points does not show it.
# It matters to who turns a coloured scan into PLY and draws it or takes first colours of a model
# from it.
# Seen on 2026-11-29 with pyvista 0.49.1, VTK 9.7.2, trimesh 5.2.0: "stored 0 255 256 300 32896
# 65535", "pyvista 0 255 0 44 128 255", "trimesh 0 255 0 44 128 255".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "pyvista==0.49.1" "vtk==9.7.2" "trimesh==5.2.0" "numpy>=1.26,<3"
cd "$folder"
venv/bin/python - <<'PYTHON'
import sys

import numpy as np
import pyvista
import trimesh

stored = np.array([0, 255, 256, 300, 32896, 65535])
vertices = np.zeros(len(stored), dtype=[("place", "<f4", 3), ("colour", "<u2", 3)])
vertices["place"][:, 0], vertices["colour"] = np.arange(len(stored)), stored[:, None]
head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(stored)}", *(f"property float {axis}" for axis in "xyz")]
head += [f"property ushort {colour}" for colour in ("red", "green", "blue")]
with open("a.ply", "wb") as file:
    file.write("\n".join([*head, "end_header\n"]).encode() + vertices.tobytes())
print(f"pyvista {pyvista.__version__}, VTK {pyvista.vtk_version_info}, trimesh {trimesh.__version__}")
print("stored", *stored)
by_vtk = np.asarray(pyvista.read("a.ply").point_data["RGB"])[:, 0]
print("pyvista", *by_vtk)
by_trimesh = np.asarray(trimesh.load("a.ply").colors)[:, 0]
print("trimesh", *by_trimesh)
sys.exit(0 if np.array_equal(by_vtk, stored % 256) and np.array_equal(by_trimesh, stored % 256) else 1)
PYTHON
