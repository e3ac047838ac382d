#!/usr/bin/env bash
# pyproj: `only_best=True` with `allow_ballpark=False` does not mean "the best operation or an error".
#
# One would expect that a transformation whose best operation lacks its grid fails, as it does for a
# compound system (EPSG:7415). For a horizontal system PROJ takes the next operation without a word:
# WGS 84 to EPSG:27700 without the OSTN15 grid is 4.7 m off at Ordnance Survey's published test
# point TP01. Only TransformerGroup tells (best_available, unavailable_operations with all grids).
# Whoever places surveyed points relies on these two switches to be told. pyproj 3.7.2, PROJ 9.5.1.
# Seen on 2026-11-29: "EPSG:27700, strict: no error, 4.74 m off the published place", "EPSG:7415, strict:
# error: transform error: No operation matching criteria found for coordinate", "TransformerGroup: best
# available False missing ['uk_os_OSTN15_NTv2_OSGBtoETRS.tif']".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pyproj==3.7.2
export PROJ_NETWORK=OFF PROJ_USER_WRITABLE_DIRECTORY="$folder/none"
"$folder/venv/bin/python" - <<'PYTHON'
import math
import sys
import warnings

import pyproj
from pyproj import Transformer
from pyproj.exceptions import ProjError
from pyproj.transformer import AreaOfInterest, TransformerGroup

warnings.simplefilter("ignore")
print("pyproj", pyproj.__version__, "PROJ", pyproj.proj_version_str)
strict = {"always_xy": True, "only_best": True, "allow_ballpark": False}
lon, lat, east, north = -6.29977752014, 49.92226393730, 91492.146, 11318.804  # TP01, OSTN15 developers' pack 2016
found = Transformer.from_crs("EPSG:4979", "EPSG:27700", **strict).transform(lon, lat, 100.0, errcheck=True)
off_m = math.hypot(found[0] - east, found[1] - north)
print(f"EPSG:27700, strict: no error, {off_m:.2f} m off the published place")
try:
    Transformer.from_crs("EPSG:4979", "EPSG:7415", **strict).transform(5.0, 52.2, 100.0, errcheck=True)
    compound = "no error"
except ProjError as error:
    compound = f"error: {error}"
print("EPSG:7415, strict:", compound)
group = TransformerGroup("EPSG:4979", "EPSG:27700", area_of_interest=AreaOfInterest(lon, lat, lon, lat), allow_ballpark=False)
missing = [grid.short_name for grid in group.unavailable_operations[0].grids]
print("TransformerGroup: best available", group.best_available, "missing", missing)
sys.exit(0 if 4 < off_m < 6 and compound.startswith("error") and not group.best_available else 1)
PYTHON
