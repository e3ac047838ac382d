#!/usr/bin/env bash
# pyproj: between systems that move against each other, a place without a time gets no motion at
# all.
#
# ITRF2014 (what PPP and most corrections give) and Australia's GDA2020 agreed in 2020.0 and part by
# 7 cm a year. One would expect a transformation that depends on the time to ask for it. Where the
# fourth number is left out, PROJ takes the epoch of the parameters: the place comes back as it went
# in, half a metre from where it is in 2026. `only_best=True`, `allow_ballpark=False` and
# `errcheck=True` change nothing, as the operation is the best one; it has all it needs but the
# time.
# It matters to who puts surveyed marks or camera positions into a national system: give the decimal
# year as fourth coordinate.
# Seen on 2026-11-29 with pyproj 3.7.2, PROJ 9.5.1: "no time: moved 0.000 m", "2026.9: moved 0.462
# m".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pyproj==3.7.2
export PROJ_NETWORK=OFF PROJ_USER_WRITABLE_DIRECTORY="$folder/none"
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import pyproj
from pyproj import Geod, Transformer

ITRF2014, GDA2020 = "EPSG:7912", "EPSG:7843"
lon, lat, height = 133.0, -25.0, 100.0
print("pyproj", pyproj.__version__, "PROJ", pyproj.proj_version_str)
transformer = Transformer.from_crs(ITRF2014, GDA2020, always_xy=True, only_best=True, allow_ballpark=False)
print("operation:", transformer.description.split(" + ")[2])
moved_m = []
for name, time in (("no time", ()), ("2026.9", (2026.9,))):
    there = transformer.transform(lon, lat, height, *time, errcheck=True)
    moved_m.append(Geod(ellps="GRS80").inv(lon, lat, *there[:2])[2])
    print(f"{name}: moved {moved_m[-1]:.3f} m")
sys.exit(0 if moved_m[0] < 0.001 and 0.4 < moved_m[1] < 0.5 else 1)
PYTHON
