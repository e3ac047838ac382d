#!/usr/bin/env bash
# laspy: bounds that are wider than 32 bits of steps hold no point of a COPC file.
#
# `CopcReader.query` takes bounds in the file's units, turns them into whole steps of the file's
# scale and casts these to 32 bits before it compares. At a scale of 1 mm the largest step is 2,147
# km from the file's offset: a bound beyond it, a UTM zone's northings 0 to 9,400,000 or an infinite
# side ("all that is east of here"), becomes the smallest whole number. As an upper bound it lies
# below every point: the answer is an empty cloud with no exception, only NumPy's warning of a cast.
# It matters to who asks tiles for the extent of a project, a country or a coordinate system, or
# leaves a side open: cut the bounds to those of the header first.
# Seen on 2026-12-01 with laspy 2.7.0, lazrs 0.8.2, file written by copclib 2.6.3: "the tile: 1000
# points", "western half: 500", "zone of UTM: 0", "west of its middle, open to the other sides: 0".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "laspy==2.7.0" "lazrs==0.8.2" "copclib==2.6.3" "numpy>=2,<3"
cd "$folder"
venv/bin/python -W ignore::RuntimeWarning - <<'PYTHON'
import sys
from importlib.metadata import version

import copclib
import laspy
import numpy as np
from laspy.copc import Bounds

EAST, NORTH, INF = 500000.0, 5800000.0, float("inf")
step = copclib.Vector3(0.001, 0.001, 0.001)
config = copclib.CopcConfigWriter(7, scale=step, offset=copclib.Vector3(EAST, NORTH, 0))
config.las_header.min, config.las_header.max = copclib.Vector3(EAST, NORTH, 0), copclib.Vector3(EAST + 100, NORTH + 100, 10)
info = config.copc_info
info.center_x, info.center_y, info.center_z, info.halfsize, info.spacing = EAST + 50, NORTH + 50, 50, 50, 10
writer = copclib.FileWriter("tile.copc.laz", config)
points = copclib.Points(writer.copc_config.las_header)
for number in range(1000):
    point = points.CreatePoint()
    point.x, point.y, point.z = EAST + 0.05 + 0.1 * number, NORTH + (7 * number) % 100, 5.0
    points.AddPoint(point)
writer.AddNode(copclib.VoxelKey(0, 0, 0, 0), points)
writer.Close()
asked = {
    "the tile": ([EAST, NORTH], [EAST + 100, NORTH + 100]),
    "western half": ([EAST, NORTH], [EAST + 50, NORTH + 100]),
    "zone of UTM": ([166000, 0], [834000, 9400000]),
    "west of its middle, open to the other sides": ([-INF, -INF], [EAST + 50, INF]),
}
print("laspy", version("laspy"))
given = []
for name, (least, most) in asked.items():
    with laspy.CopcReader.open("tile.copc.laz") as reader:
        given.append(len(reader.query(Bounds(np.array(least, float), np.array(most, float)))))
    print(f"{name}: {given[-1]} points")
sys.exit(0 if given == [1000, 500, 0, 0] else 1)
PYTHON
