#!/usr/bin/env bash
# Open3D: a Gaussian more than 2,048 units from the origin comes back from SPZ on the other side of
# it.
#
# SPZ keeps centres in 24 bits of fixed point; how many of them are the fraction stands in the
# header. Open3D always writes 12, so the range is +-2,048, and what is beyond wraps round: 3,000.25
# becomes -1,095.75. One would expect an error or fewer bits of fraction; `write_point_cloud`
# returns True. Also the opacities of the nearly opaque and the nearly transparent come back as
# logits of +-infinity, which a sigmoid stands but neither an average nor an optimizer does.
# It matters to who stores a town in metres, or anything in millimetres or projected coordinates:
# move the model to its middle first, and look at the largest coordinate.
# Seen on 2026-11-29 with Open3D 0.20.0: "written: True", "x: [1.0, 2047.5, 3000.25] -> [1.0,
# 2047.5, -1095.75]", "logits: [2.0, 20.0, -20.0] -> [2.01, inf, -inf]".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "open3d==0.20.0" "numpy>=2,<3"
cd "$folder"
venv/bin/python - <<'PYTHON'
import sys

import numpy as np
import open3d as o3d

xs, logits = np.float32([1, 2047.5, 3000.25]), np.float32([2, 20, -20])
cloud = o3d.t.geometry.PointCloud(np.stack([xs, xs * 0, xs * 0], axis=1))
cloud.point["opacity"] = logits[:, None]
cloud.point["scale"] = np.full((3, 3), 0.05, dtype=np.float32)
cloud.point["rot"] = np.tile(np.float32([1, 0, 0, 0]), (3, 1))
cloud.point["f_dc"] = np.zeros((3, 3), dtype=np.float32)
print("Open3D", o3d.__version__)
written = o3d.t.io.write_point_cloud("a.spz", cloud)
print("written:", written)
read = o3d.t.io.read_point_cloud("a.spz")
xs_read, logits_read = read.point.positions.numpy()[:, 0], read.point["opacity"].numpy()[:, 0]
print("x:", xs.tolist(), "->", xs_read.tolist())
print("logits:", logits.tolist(), "->", [float(f"{logit:.2f}") for logit in logits_read])
wrapped = np.allclose(xs_read, [1, 2047.5, 3000.25 - 4096])
sys.exit(0 if written and wrapped and np.isposinf(logits_read[1]) and np.isneginf(logits_read[2]) else 1)
PYTHON
