#!/usr/bin/env bash
# trimesh: a camera that is given a K whose principal point is off the middle has another picture.
#
# One would expect `camera.K = K` to keep the picture's size, or to refuse what it cannot hold. A
# trimesh camera has a focal length and a resolution and no principal point: the setter makes the
# resolution twice the principal point, in whole pixels, so a camera of 640 x 480 with (300.4,
# 250.2) is one of 600 x 500 from then on, and fields of view, rays and pictures follow.
# `camera.K` then says (300, 250), near enough to pass a look.
# It matters to who carries calibrated cameras over for ray casting or masks: arrays of rays do
# not fit the photograph.
# Seen on 2026-12-01 with trimesh 5.2.0: "resolution [640, 480] -> [600, 500], K [[500.0, 0.0,
# 300.0], [0.0, 500.0, 250.0], [0.0, 0.0, 1.0]], rays of a picture: 300000".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "trimesh==5.2.0" "numpy>=2,<3"
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import numpy as np
import trimesh

camera = trimesh.scene.Camera(resolution=(640, 480), focal=(500, 500))
before = camera.resolution.tolist()
camera.K = np.array([[500.0, 0, 300.4], [0, 500, 250.2], [0, 0, 1]])
print("trimesh", trimesh.__version__)
print(f"resolution {before} -> {camera.resolution.tolist()}, K {camera.K.tolist()}, rays of a picture: {len(camera.to_rays()[0])}")
sys.exit(0 if before == [640, 480] and camera.resolution.tolist() != before else 1)
PYTHON
