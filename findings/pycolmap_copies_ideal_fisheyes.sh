#!/usr/bin/env bash
# pycolmap takes an ideal fisheye for a camera without distortion and copies its pictures unchanged.
#
# One would expect `undistort_image` to turn the picture of a FISHEYE camera (an equidistant lens,
# model 15 of COLMAP 4) into that of the pinhole which `undistort_camera` returns. What happens:
# `Camera.is_undistorted` looks at the extra parameters alone. FISHEYE and SIMPLE_FISHEYE have none,
# and OPENCV_FISHEYE, RADIAL_FISHEYE and others may have zeros, so it is true for them although a ray
# at 45 degrees is drawn at 0.785 f, not at f. `undistort_images` then copies the bent pictures and
# leaves the camera as FISHEYE in the "undistorted" model.
# Seen with pycolmap 4.2.1. It matters to everybody who undistorts fisheye photographs before dense
# stereo or Gaussian splatting: nothing fails, the pictures are just not straight.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "pycolmap==4.2.1" "numpy>=1.26,<3"
cd "$folder"
cat > seen.py <<'PY'
import sys
from pathlib import Path

import numpy as np
import pycolmap

print("pycolmap", pycolmap.__version__)
lenses = {
    "SIMPLE_FISHEYE": [190.0, 160.0, 120.0],
    "FISHEYE": [190.0, 190.0, 160.0, 120.0],
    "OPENCV_FISHEYE": [190.0, 190.0, 160.0, 120.0, 0.0, 0.0, 0.0, 0.0],
}
same = True
for name, params in lenses.items():
    camera = pycolmap.Camera(model=name, width=320, height=240, params=params, camera_id=1)
    drawn = float(np.asarray(camera.img_from_cam(np.array([[1.0, 0.0, 1.0]])))[0, 0]) - 160.0
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(camera)
    model.add_image_with_trivial_frame(pycolmap.Image(name="a.png", camera_id=1, image_id=1), pycolmap.Rigid3d())
    work = Path(name)
    for inner in ("images", "model", "out"):
        (work / inner).mkdir(parents=True)
    pycolmap.Bitmap.from_array(np.tile(np.arange(320, dtype=np.uint8), (240, 1))).write(work / "images" / "a.png")
    model.write(work / "model")
    pycolmap.undistort_images(work / "out", work / "model", work / "images")
    after = pycolmap.Reconstruction(work / "out" / "sparse").cameras[1].model.name
    print(f"{name}: a ray at 45 degrees is drawn {drawn:.1f} px from the middle (a pinhole: 190.0);",
          f"is_undistorted: {camera.is_undistorted()}; camera of the undistorted model: {after}")
    same &= abs(drawn - 190 * np.pi / 4) < 1e-6 and camera.is_undistorted() and after == name
sys.exit(0 if same else 1)
PY
"$folder/venv/bin/python" seen.py
