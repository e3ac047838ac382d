#!/usr/bin/env bash
# USD: products of `Gf.Rotation` go from left to right, those of `Gf.Quatd` from right to left.
#
# One would expect that `Gf.Rotation(a) * Gf.Rotation(b)` is `Gf.Rotation(a * b)`, as the one is
# made from the other. For quaternions a * b turns by b first, as everywhere. Rotations multiply
# as USD's matrices do, whose vectors are rows: the left one first. All three classes give a
# rotation without a word, and the docstring of the product is empty in Python.
# It matters to who composes poses of cameras or of splats for USD: changing from quaternions to
# rotations or matrices on the way turns the order round.
# Seen on 2026-12-01 with usd-core 26.11, a and b quarter turns about x and z: "quaternions a * b:
# x axis to [0, 0, 1]", "rotations a * b: x axis to [0, 1, 0]", "matrices a * b: x axis to [0, 1,
# 0]".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "usd-core==26.11"
"$folder/venv/bin/python" - <<'PYTHON'
import sys
from importlib.metadata import version

from pxr import Gf

a, b = Gf.Rotation(Gf.Vec3d(1, 0, 0), 90), Gf.Rotation(Gf.Vec3d(0, 0, 1), 90)
places = {
    "quaternions a * b": (a.GetQuat() * b.GetQuat()).Transform(Gf.Vec3d(1, 0, 0)),
    "rotations a * b": (a * b).TransformDir(Gf.Vec3d(1, 0, 0)),
    "matrices a * b": (Gf.Matrix4d(a, Gf.Vec3d(0)) * Gf.Matrix4d(b, Gf.Vec3d(0))).TransformDir(Gf.Vec3d(1, 0, 0)),
}
places = {name: [round(number) for number in place] for name, place in places.items()}
print("usd-core", version("usd-core"))
for name, place in places.items():
    print(f"{name}: x axis to {place}")
sys.exit(0 if list(places.values()) == [[0, 0, 1], [0, 1, 0], [0, 1, 0]] else 1)
PYTHON
