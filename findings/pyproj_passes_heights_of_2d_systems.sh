#!/usr/bin/env bash
# pyproj: a height that goes in beside EPSG:4326 comes out of a system with levels of its own
# unchanged.
#
# EPSG:7415 is Dutch plane coordinates with heights above NAP, some 43 m below those above the
# ellipsoid. Its transformation needs the grid of a geoid. From EPSG:4979 (WGS 84 with heights) and
# without the grid, the strict switches raise an error, as they should. From EPSG:4326, which has no
# heights, the third number is no coordinate and is handed through: 100 m in, 100 m out, with
# `only_best=True`, `allow_ballpark=False` and `errcheck=True` all the same.
# It matters as photographs' positions are said to be "EPSG:4326" and have a height: it must be
# EPSG:4979.
# Seen on 2026-11-29 with pyproj 3.7.2, PROJ 9.5.1: "EPSG:4326: height 100.0", "EPSG:4979: error:
# transform error: No operation matching criteria found for coordinate".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pyproj==3.7.2
export PROJ_NETWORK=OFF PROJ_USER_WRITABLE_DIRECTORY="$folder/none"
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import pyproj
from pyproj import Transformer
from pyproj.exceptions import ProjError

print("pyproj", pyproj.__version__, "PROJ", pyproj.proj_version_str)
says = {}
for source in ("EPSG:4326", "EPSG:4979"):
    try:
        strict = Transformer.from_crs(source, "EPSG:7415", always_xy=True, only_best=True, allow_ballpark=False)
        says[source] = f"height {strict.transform(5.0, 52.2, 100.0, errcheck=True)[2]}"
    except ProjError as error:
        says[source] = f"error: {error}"
    print(f"{source}: {says[source]}")
sys.exit(0 if says["EPSG:4326"] == "height 100.0" and says["EPSG:4979"].startswith("error") else 1)
PYTHON
