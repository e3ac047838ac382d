#!/usr/bin/env bash
# pycolmap: pictures that it undistorts carry the orientation tag of the photograph, its cameras do
# not.
#
# `undistort_images` works on the stored pixels of a photograph: a camera of 320 x 240 whose JPEG
# has EXIF orientation 6 (held upright) becomes a PINHOLE camera of about 320 x 240. The tag is
# copied into the new picture all the same. So the model and its pictures agree only for a reader
# that ignores the tag; whoever obeys it, as OpenCV's `imread` does by default, gets the picture
# turned by 90 degrees, with width and height exchanged, beside a camera that was not.
# It matters to who trains or measures on undistorted pictures of a telephone: read them with the
# orientation ignored.
# Seen on 2026-11-29 with pycolmap 4.2.1 and OpenCV 5.0.0: "camera of the model: 323 x 240, tag in
# the picture: 6", "imread: 240 x 323, with IMREAD_IGNORE_ORIENTATION: 323 x 240".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "pycolmap==4.2.1" "numpy>=2,<3" "pillow==13.0.0" "opencv-contrib-python-headless==5.0.0.93"
cd "$folder"
mkdir images model out
venv/bin/python - <<'PYTHON'
import sys

import cv2
import numpy as np
import pycolmap
from PIL import Image

ORIENTATION = 0x0112
exif = Image.Exif()
exif[ORIENTATION] = 6
Image.fromarray(np.tile(np.arange(320, dtype=np.uint8), (240, 1))).save("images/a.jpg", exif=exif)
model = pycolmap.Reconstruction()
camera = pycolmap.Camera(model="SIMPLE_RADIAL", width=320, height=240, params=[300, 160, 120, -0.05], camera_id=1)
model.add_camera_with_trivial_rig(camera)
model.add_image_with_trivial_frame(pycolmap.Image(name="a.jpg", camera_id=1, image_id=1), pycolmap.Rigid3d())
model.write("model")
pycolmap.undistort_images("out", "model", "images")
camera = pycolmap.Reconstruction("out/sparse").cameras[1]
size = (camera.width, camera.height)
tag = Image.open("out/images/a.jpg").getexif().get(ORIENTATION)
print(f"pycolmap {pycolmap.__version__}, OpenCV {cv2.__version__}")
print(f"camera of the model: {size[0]} x {size[1]}, tag in the picture: {tag}")
read = cv2.imread("out/images/a.jpg").shape[1::-1]
ignored = cv2.imread("out/images/a.jpg", cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION).shape[1::-1]
print(f"imread: {read[0]} x {read[1]}, with IMREAD_IGNORE_ORIENTATION: {ignored[0]} x {ignored[1]}")
sys.exit(0 if tag == 6 and ignored == size and read == size[::-1] else 1)
PYTHON
