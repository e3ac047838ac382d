#!/bin/bash
# SPZ is one format with two readings of its axes, and no file says which was meant.
#
# Expected: the same SPZ gives the same coordinates in every program.
# Happens: Open3D 0.20.0 takes them as they stand; PlayCanvas's splat-transform 2.7.1 (the tool behind
# SuperSplat) turns them by 180 degrees about x when it reads and writes, as the format's description
# (x right, y up, z back) against PLY's (x right, y down, z forward) asks. Version 2 and 3 of the
# format have no field for it. A model that is converted PLY -> SPZ by one and read by the other stands
# upside down, without a word from either.
# Matters to whoever reads or writes SPZ: numbers of two readers that differ by (1, -1, -1) are no bug.
# Seen on 2026-11-29: Open3D 0.20.0 reads [1, 2, 3], splat-transform 2.7.1 reads [1, -2, -3].
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
python3 -m venv venv
venv/bin/pip install -q "open3d==0.20.0" "numpy>=2"
npm init -y >/dev/null
npm install --silent --ignore-scripts @playcanvas/splat-transform@2.7.1 >/dev/null
cat > look.py <<'PY'
import gzip, struct, subprocess, sys
import numpy as np
import open3d as o3d

# One Gaussian of SPZ version 2 at (1, 2, 3): 24-bit centre with 12 bits of a fraction, opacity, colour,
# log scales, rotation.
centre = b"".join(int(value * 4096).to_bytes(3, "little", signed=True) for value in (1, 2, 3))
data = struct.pack("<4sIIBBBB", b"NGSP", 2, 1, 0, 12, 0, 0) + centre + bytes([200, 128, 128, 128, 100, 100, 100, 128, 128, 128])
open("one.spz", "wb").write(gzip.compress(data))
by_open3d = o3d.t.io.read_point_cloud("one.spz").point.positions.numpy()[0]
tool = "node_modules/@playcanvas/splat-transform/bin/cli.mjs"
subprocess.run(["node", tool, "-q", "-w", "one.spz", "one.csv"], check=True)
head, row = open("one.csv").read().splitlines()[:2]
by_name = dict(zip(head.split(","), row.split(",")))
by_splat_transform = np.array([float(by_name[axis]) for axis in "xyz"])
print("open3d", o3d.__version__, "reads", by_open3d.tolist())
print("splat-transform 2.7.1 reads", by_splat_transform.tolist())
sys.exit(0 if np.allclose(by_open3d, [1, 2, 3]) and np.allclose(by_splat_transform, [1, -2, -3]) else 1)
PY
venv/bin/python look.py
