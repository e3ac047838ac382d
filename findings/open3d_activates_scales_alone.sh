#!/usr/bin/env bash
# Open3D: of a 3DGS PLY it reads the scales activated, the opacities not.
#
# A 3DGS PLY stores logarithms of scales and logits of opacities. One would expect a reader to give
# both as stored or both as they are drawn. Open3D's tensor cloud has exp(scale_i) in `scale` and
# the stored logit in `opacity`, with no word of it in the attributes' names. Its writer takes the
# logarithm back, so a round trip is right, and who fills a cloud with scales as stored, -3, gets
# the logarithm of 1e-20: `write_point_cloud` returns True.
# It matters to who edits or builds splats with it: exp() once more turns 5 cm into 1.05 m, a
# threshold of 0.5 on `opacity` is one of 0.62, and what was written of logarithms is not to be
# seen.
# Seen on 2026-11-29 with Open3D 0.20.0: "stored: scale_0 -3.0, opacity 2.0; read: scale 0.0498,
# opacity 2.0000", "scale -3.0 set and written: True, stored as -46.05".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "open3d==0.20.0" "numpy>=2,<3"
cd "$folder"
venv/bin/python - <<'PYTHON'
import math
import sys

import numpy as np
import open3d as o3d

values = dict.fromkeys(["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2"], 0.0)
values |= {"opacity": 2.0, "scale_0": -3.0, "scale_1": -3.0, "scale_2": -3.0}
values |= {"rot_0": 1.0, "rot_1": 0.0, "rot_2": 0.0, "rot_3": 0.0}
lines = ["ply", "format binary_little_endian 1.0", "element vertex 1", *(f"property float {name}" for name in values)]
with open("a.ply", "wb") as file:
    file.write("\n".join([*lines, "end_header\n"]).encode() + np.array(list(values.values()), dtype="<f4").tobytes())


def stored(path: str) -> dict[str, float]:
    """The first vertex of a binary PLY of floats."""
    with open(path, "rb") as file:
        head, data = file.read().split(b"end_header\n", 1)
    names = [line.split()[-1] for line in head.decode().splitlines() if line.startswith("property float")]
    return dict(zip(names, np.frombuffer(data, dtype="<f4", count=len(names)).tolist(), strict=True))


print("Open3D", o3d.__version__)
cloud = o3d.t.io.read_point_cloud("a.ply")
scale, opacity = float(cloud.point["scale"].numpy()[0, 0]), float(cloud.point["opacity"].numpy()[0, 0])
print(f"stored: scale_0 -3.0, opacity 2.0; read: scale {scale:.4f}, opacity {opacity:.4f}")
o3d.t.io.write_point_cloud("same.ply", cloud)
same = stored("same.ply")
print(f"written again: scale_0 {same['scale_0']:.4f}, opacity {same['opacity']:.4f}")
cloud.point["scale"] = np.full((1, 3), -3, dtype=np.float32)
written = o3d.t.io.write_point_cloud("logarithms.ply", cloud)
wrong = stored("logarithms.ply")["scale_0"]
print(f"scale -3.0 set and written: {written}, stored as {wrong:.2f}")
mixed = abs(scale - math.exp(-3)) < 1e-6 and opacity == 2.0
sys.exit(0 if mixed and abs(same["scale_0"] + 3) < 1e-5 and written and abs(wrong - math.log(1e-20)) < 0.01 else 1)
PYTHON
