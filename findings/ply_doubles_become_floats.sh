#!/usr/bin/env bash
# PLY: VTK and trimesh round coordinates of 64 bits to 32 without a word, one reading, the other
# writing.
#
# A PLY may hold coordinates as `double`, and scans in projected coordinates do: a float's steps are
# 0.5 m at a northing of 5,800,000 m. VTK's reader of PLY (`pyvista.read`) gives float32 for such a
# file, though its reader of OBJ gives float64. trimesh reads PLY in float64 and writes float32
# ("property float x"), while its OBJ and XYZ keep the digits.
# It matters to who passes a georeferenced mesh or cloud through either: edges of decimetres
# collapse, and nothing fails. Take off a local origin first.
# Seen on 2026-11-29 with pyvista 0.49.1, VTK 9.7.2, trimesh 5.2.0: "pyvista: ply float32, 0.211 m
# off; obj 0.000 m off", "trimesh: read 0.000 m off; written as ply and read again 0.211 m, as obj
# 0.000 m".
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

places = np.array([[389123.456, 5819123.789, 34.5], [389124.456, 5819123.789, 34.5], [389123.456, 5819124.789, 34.5]])
head = ["ply", "format binary_little_endian 1.0", "element vertex 3", *(f"property double {axis}" for axis in "xyz")]
head += ["element face 1", "property list uchar int vertex_indices", "end_header\n"]
with open("a.ply", "wb") as file:
    file.write("\n".join(head).encode() + places.astype("<f8").tobytes() + b"\x03" + np.arange(3, dtype="<i4").tobytes())


def off_m(points: np.ndarray) -> float:
    return float(np.abs(np.asarray(points, dtype=np.float64) - places).max())


mesh = trimesh.load("a.ply", process=False)
mesh.export("again.ply")
mesh.export("again.obj")
by_vtk, by_vtk_obj = pyvista.read("a.ply"), pyvista.read("again.obj")
again = {kind: off_m(trimesh.load(f"again.{kind}", process=False).vertices) for kind in ("ply", "obj")}
print(f"pyvista {pyvista.__version__}, VTK {pyvista.vtk_version_info}, trimesh {trimesh.__version__}")
print(f"pyvista: ply {by_vtk.points.dtype}, {off_m(by_vtk.points):.3f} m off; obj {off_m(by_vtk_obj.points):.3f} m off")
print(f"trimesh: read {off_m(mesh.vertices):.3f} m off; written as ply and read again {again['ply']:.3f} m, as obj {again['obj']:.3f} m")
vtk_rounds = by_vtk.points.dtype == np.float32 and off_m(by_vtk.points) > 0.2
sys.exit(0 if vtk_rounds and off_m(mesh.vertices) == 0 and again["ply"] > 0.2 and again["obj"] < 1e-6 else 1)
PYTHON
