#!/usr/bin/env bash
# pycolmap: a model written as text and read again has other names of images where they hold a
# blank.
#
# One would expect `read_text` to give what `write_text` was given. The writer puts the name at the
# end of its line as it is, "first flight/DJI 0001.jpg"; the reader stops at the first blank and
# keeps "first". Two photographs of one such folder have the same name then, and nothing is said: no
# error, no warning. The binary form of the same model keeps the names.
# It matters to who converts a model to text to edit or inspect it and back: the photographs are not
# found any more, or the wrong ones, and everything that is looked up by name.
# Seen on 2026-11-29 with pycolmap 4.2.1: "text: ['first', 'first']", "binary: ['first flight/DJI
# 0001.jpg', 'first flight/DJI 0002.jpg']".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "pycolmap==4.2.1" "numpy>=1.26,<3"
cd "$folder"
mkdir text binary
venv/bin/python - <<'PYTHON'
import sys

import pycolmap

names = ["first flight/DJI 0001.jpg", "first flight/DJI 0002.jpg"]
model = pycolmap.Reconstruction()
model.add_camera_with_trivial_rig(pycolmap.Camera(model="SIMPLE_PINHOLE", width=8, height=6, params=[9, 4, 3], camera_id=1))
for number, name in enumerate(names, start=1):
    model.add_image_with_trivial_frame(pycolmap.Image(name=name, camera_id=1, image_id=number), pycolmap.Rigid3d())
model.write_text("text")
model.write_binary("binary")
print("pycolmap", pycolmap.__version__)
written = all(name in open("text/images.txt").read() for name in names)
text, binary = pycolmap.Reconstruction(), pycolmap.Reconstruction()
text.read_text("text")
binary.read_binary("binary")
from_text, from_binary = (sorted(image.name for image in each.images.values()) for each in (text, binary))
print("whole names stand in images.txt:", written)
print("text:", from_text)
print("binary:", from_binary)
sys.exit(0 if written and from_text == ["first", "first"] and from_binary == names else 1)
PYTHON
