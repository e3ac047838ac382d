#!/usr/bin/env bash
# imageio: frames of an upright telephone's film lie on their side, and nothing in the metadata
# tells.
#
# A telephone stores frames as its sensor has them and a matrix in the track that turns them
# upright. OpenCV's `VideoCapture` turns by default. imageio with its PyAV plugin, which it picks
# by itself for MP4 where PyAV is installed, gives the stored frames: `imread`, `imiter` and
# `improps` agree on the lying shape, and `immeta` has no word of a turn. PyAV knows it, as
# `frame.rotation`.
# It matters to who takes pictures for a model with one library and calibrates, masks or tracks
# with the other: width and height are exchanged, and a model of lying pictures is on its side.
# Seen on 2026-12-01 with imageio 2.38.2, av 18.1.0, OpenCV 5.0.0, a film of 160 x 96 turned by 90
# degrees: "imageio (96, 160, 3), OpenCV (160, 96, 3), turn by PyAV -90, by imageio: nothing".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "imageio==2.38.2" "av==18.1.0" "opencv-contrib-python-headless==5.0.0.93" "numpy>=2,<3"
cd "$folder"
venv/bin/python - <<'PYTHON'
import struct
import sys

import av
import cv2
import imageio
import imageio.v3 as iio
import numpy as np

with av.open("film.mp4", "w") as film:
    stream = film.add_stream("mpeg4", rate=10)
    stream.width, stream.height, stream.pix_fmt = 160, 96, "yuv420p"
    for level in range(0, 200, 20):
        film.mux(stream.encode(av.VideoFrame.from_ndarray(np.full((96, 160, 3), level, np.uint8), format="rgb24")))
    film.mux(stream.encode())
content = bytearray(open("film.mp4", "rb").read())
# A track's header (version 0) has its matrix 40 bytes after the name of its box.
at = content.index(b"tkhd") + 44
assert struct.unpack(">9i", content[at : at + 36]) == (1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30)
content[at : at + 36] = struct.pack(">9i", 0, 1 << 16, 0, -(1 << 16), 0, 0, 0, 0, 1 << 30)
with open("upright.mp4", "wb") as file:
    file.write(content)

lying, upright = next(iio.imiter("upright.mp4")).shape, cv2.VideoCapture("upright.mp4").read()[1].shape
with av.open("upright.mp4") as film:
    turn = next(film.decode(video=0)).rotation
told = {key: value for key, value in iio.immeta("upright.mp4").items() if "rot" in key.lower()}
print(f"imageio {imageio.__version__}, av {av.__version__}, OpenCV {cv2.__version__}")
print(f"imageio {lying}, OpenCV {upright}, turn by PyAV {turn}, by imageio: {told or 'nothing'}")
same = iio.improps("upright.mp4").shape[1:] == lying and iio.imread("upright.mp4").shape[1:] == lying
sys.exit(0 if lying == (96, 160, 3) and upright == (160, 96, 3) and abs(turn) == 90 and same and not told else 1)
PYTHON
