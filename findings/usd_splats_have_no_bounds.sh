#!/usr/bin/env bash
# USD: a prim of 3D Gaussians has no bounding box unless its writer computed one.
#
# One would expect `UsdGeom.BBoxCache` to bound a ParticleField3DGaussianSplat from its positions
# and scales, as it does for UsdGeom.Points of the same places without an `extent`. It has no
# function to compute an extent for this type: the box is the empty one (least +3.4e38, most
# -3.4e38), `ComputeExtentFromPlugins` gives None, and nothing is said. So a scene of nothing else
# has no size: "frame all" of a viewer has nothing to go by.
# It matters to who exports splats as USD: write `extent` too.
# Seen on 2026-11-29 with usd-core 26.11: "Points: box is empty: False",
# "ParticleField3DGaussianSplat: box is empty: True, extent by plugins: None", "with extent written:
# box is empty: False".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "usd-core==26.11"
"$folder/venv/bin/python" - <<'PYTHON'
import sys

from pxr import Gf, Usd, UsdGeom, UsdVol

print("USD", ".".join(map(str, Usd.GetVersion())))
now, places = Usd.TimeCode.Default(), [(0, 0, 0), (10, 0, 0)]


def box_is_empty(prim: UsdGeom.Boundable) -> bool:
    """What a new cache says of the prim's box in the world."""
    return UsdGeom.BBoxCache(now, [UsdGeom.Tokens.default_]).ComputeWorldBound(prim.GetPrim()).GetRange().IsEmpty()


stage = Usd.Stage.CreateInMemory()
points = UsdGeom.Points.Define(stage, "/points")
points.CreatePointsAttr(places)
points.CreateWidthsAttr([1, 1])
splats = UsdVol.ParticleField3DGaussianSplat.Define(stage, "/splats")
splats.CreatePositionsAttr(places)
splats.CreateScalesAttr([(1, 1, 1)] * 2)
splats.CreateOrientationsAttr([Gf.Quatf(1, 0, 0, 0)] * 2)
splats.CreateOpacitiesAttr([1, 1])
seen = [box_is_empty(points), box_is_empty(splats)]
extent = UsdGeom.Boundable.ComputeExtentFromPlugins(UsdGeom.Boundable(splats), now)
print("Points: box is empty:", seen[0])
print(f"ParticleField3DGaussianSplat: box is empty: {seen[1]}, extent by plugins: {extent}")
splats.CreateExtentAttr([(-3, -3, -3), (13, 3, 3)])
seen.append(box_is_empty(splats))
print("with extent written: box is empty:", seen[2])
sys.exit(0 if seen == [False, True, False] and extent is None else 1)
PYTHON
