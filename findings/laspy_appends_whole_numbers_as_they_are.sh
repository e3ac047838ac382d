#!/usr/bin/env bash
# laspy: points appended to a LAS file land elsewhere if their record has another scale or offset.
#
# A LAS file stores whole numbers; one scale and one offset in its header make coordinates of
# them. A record of points in laspy knows its scales and offsets, and `las.x` uses them.
# `append_points` of a file opened with mode "a" compares point formats alone and copies the whole
# numbers: what was 101 m at a scale of 1 mm and an offset of 100 m is 10 m in a file with 1 cm
# and 0. No error, and the header's bounds agree with what was written.
# It matters to who joins tiles, flights or scans file by file: programs choose an offset for each
# tile. Call `change_scaling` on a copy of the points first, or compare the headers.
# Seen on 2026-12-01 with laspy 2.7.0: "a.las: appended x [101.0, 102.0], read again x [1.0, 2.0,
# 10.0, 20.0], header's largest 20.0", and the same as LAZ by lazrs 0.8.2.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "laspy==2.7.0" "lazrs==0.8.2" "numpy>=2,<3"
cd "$folder"
venv/bin/python - <<'PYTHON'
import sys

import laspy
import numpy as np


def tile(step_m: float, offset_m: float, x: list[float]) -> laspy.LasData:
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.scales, header.offsets = np.full(3, step_m), np.array([offset_m, 0, 0])
    las = laspy.LasData(header)
    las.x, las.y, las.z = np.array(x), np.zeros(len(x)), np.zeros(len(x))
    return las


print("laspy", laspy.__version__)
right = True
for name in ("a.las", "a.laz"):
    tile(0.01, 0, [1.0, 2.0]).write(name)
    second = tile(0.001, 100, [101.0, 102.0])
    with laspy.open(name, mode="a") as file:
        file.append_points(second.points)
    joined = laspy.read(name)
    given, read = np.array(second.x).tolist(), np.array(joined.x).tolist()
    print(f"{name}: appended x {given}, read again x {read}, header's largest {joined.header.maxs[0]}")
    right &= np.allclose(joined.x, [1, 2, 10, 20]) and abs(joined.header.maxs[0] - 20) < 1e-6
sys.exit(0 if right else 1)
PYTHON
