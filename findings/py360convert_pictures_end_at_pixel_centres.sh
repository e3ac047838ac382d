#!/usr/bin/env bash
# py360convert: pictures and cube faces cut from a panorama have another focal length than their
# field of view says.
#
# `e2p` cuts a perspective picture of `fov_deg` out of a panorama. One would expect that angle from
# rim to rim: f = W / 2 / tan(fov / 2), which is W / 2 at 90 degrees. It puts the centres of the
# first and the last pixel at the limits of the angle, so f is (W - 1) / 2 there, and the picture
# sees half a pixel more on each side. So do the faces of `e2c`: neighbours share a row of pixels.
# It matters to who turns panoramas into pinhole photographs for COLMAP or 3DGS and writes the
# camera from the angle: at the rim it is half a pixel off, at every size. Write
# f = (W - 1) / 2 / tan(fov / 2).
# Seen on 2026-12-01 with py360convert 1.0.4: "e2p, 90 degrees, 100 px: f 49.50 px, middle 50.00, at
# the rim 0.50 px off", "e2p, 60 degrees, 400 px: f 345.54 px, middle 200.00, at the rim 0.50 px
# off", "e2c, 100 px: f 49.50 px, middle 50.00, at the rim 0.50 px off".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "py360convert==1.0.4" "numpy>=1.26,<3"
"$folder/venv/bin/python" - <<'PYTHON'
import sys
from importlib.metadata import version

import numpy as np
import py360convert

HEIGHT, WIDTH = 512, 1024
row, column = np.mgrid[0:HEIGHT, 0:WIDTH] + 0.5
lon, lat = (column / WIDTH - 0.5) * 2 * np.pi, (0.5 - row / HEIGHT) * np.pi
panorama = np.stack([np.cos(lat) * np.sin(lon), np.sin(lat), np.cos(lat) * np.cos(lon)], axis=-1)


def errors(name: str, rays: np.ndarray, fov_deg: float) -> tuple[float, float]:
    """(f - what the angle says, f - one pixel less), px, of a picture (W, W, 3) that holds its rays."""
    size = len(rays)
    across = rays[size // 2, :, 0] / rays[size // 2, :, 2]
    focal, middle = np.polyfit(across, np.arange(size) + 0.5, 1)
    said = size / 2 / np.tan(np.radians(fov_deg) / 2)
    rim_px = (said - focal) * np.tan(np.radians(fov_deg) / 2)
    print(f"{name}, {size} px: f {focal:.2f} px, middle {middle:.2f}, at the rim {rim_px:.2f} px off")
    return focal - said, focal - said * (size - 1) / size


print("py360convert", version("py360convert"))
seen = []
for fov_deg, size in ((90, 100), (60, 400)):
    picture = py360convert.e2p(panorama, fov_deg=fov_deg, u_deg=0, v_deg=0, out_hw=(size, size), mode="bilinear")
    seen.append(errors(f"e2p, {fov_deg} degrees", picture, fov_deg))
seen.append(errors("e2c", py360convert.e2c(panorama, face_w=100, cube_format="dict")["F"], 90))
sys.exit(0 if all(by_angle < -0.4 and abs(by_centres) < 0.01 for by_angle, by_centres in seen) else 1)
PYTHON
