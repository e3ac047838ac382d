#!/usr/bin/env bash
# trimesh: texture coordinates that a glTF stores in 8 or 16 bits are taken for whole numbers.
#
# glTF's core allows TEXCOORD_0 as floats or as normalized unsigned bytes or shorts, where 65,535
# is 1; programs that pack meshes for the web write the latter. One would expect 0 to 1 either
# way. trimesh ignores `normalized` and gives 65535.0; v, which it turns over by 1 - v, wraps
# below 0. As a picture repeats at every whole number, every corner takes the colour of one corner
# of it.
# It matters to who reads textured meshes of a photogrammetry program or a web pipeline to sample
# colours, to bake or to convert them: the geometry is right, the texture collapses. VTK reads
# both.
# Seen on 2026-12-01 with trimesh 5.2.0, VTK 9.7.2: "ushort.glb: trimesh [[0.0, 1.0], [65535.0,
# 1.0], [0.0, 52430.0]], VTK [[0.0, 0.0], [1.0, 0.0], [0.0, 0.2]]".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "trimesh==5.2.0" "vtk==9.7.2" "pillow==13.0.0" "numpy>=2,<3"
cd "$folder"
venv/bin/python - <<'PYTHON'
import io
import json
import struct
import sys

import numpy as np
import trimesh
import vtk
from PIL import Image
from vtk.util.numpy_support import vtk_to_numpy

SHARES = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 0.2]])
picture = io.BytesIO()
Image.new("RGB", (4, 4), (255, 0, 0)).save(picture, "PNG")


def write_glb(name: str, kind: int, uv: np.ndarray) -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4")
    parts = [corners.tobytes(), uv.tobytes(), np.arange(4, dtype="<u2").tobytes(), picture.getvalue()]
    starts = np.cumsum([0, *map(len, parts)]).tolist()
    accessors = [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}]
    accessors += [{"bufferView": 1, "componentType": kind, "normalized": kind != 5126, "count": 3, "type": "VEC2"}]
    accessors += [{"bufferView": 2, "componentType": 5123, "count": 3, "type": "SCALAR"}]
    head = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": starts[-1]}],
        "bufferViews": [{"buffer": 0, "byteOffset": at, "byteLength": len(part)} for at, part in zip(starts, parts)],
        "accessors": accessors,
        "images": [{"bufferView": 3, "mimeType": "image/png"}],
        "textures": [{"source": 0}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
        "scene": 0,
    }
    text, blob = json.dumps(head).encode(), b"".join(parts)
    text, blob = text + b" " * (-len(text) % 4), blob + bytes(-len(blob) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(blob), b"BIN\0") + blob
    with open(name, "wb") as file:
        file.write(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def by_vtk(name: str) -> np.ndarray:
    reader = vtk.vtkGLTFReader()
    reader.SetFileName(name)
    reader.Update()
    points = reader.GetOutput().NewIterator().GetCurrentDataObject().GetPointData()
    return vtk_to_numpy(points.GetArray("TEXCOORD_0"))


write_glb("float.glb", 5126, SHARES.astype("<f4"))
write_glb("ushort.glb", 5123, np.rint(SHARES * 65535).astype("<u2"))
print("trimesh", trimesh.__version__, "VTK", vtk.vtkVersion.GetVTKVersion())
read = {}
for name in ("float.glb", "ushort.glb"):
    read[name] = np.asarray(trimesh.load(name, force="mesh", process=False).visual.uv, float)
    print(f"{name}: trimesh {read[name].round(4).tolist()}, VTK {by_vtk(name).astype(float).round(4).tolist()}")
    if not np.allclose(by_vtk(name), SHARES, atol=1e-4):
        sys.exit(1)
float_is_right = np.allclose(read["float.glb"], [[0, 1], [1, 1], [0, 0.8]], atol=1e-4)
sys.exit(0 if float_is_right and read["ushort.glb"].max() > 60000 else 1)
PYTHON
