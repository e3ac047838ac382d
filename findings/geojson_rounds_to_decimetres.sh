#!/usr/bin/env bash
# geojson (the Python package): places are rounded to 6 decimals when read and when made.
#
# One would expect `dumps(loads(text))` to keep the digits of a place. The package rounds each
# coordinate to 6 decimals as soon as a geometry is made, so also while it reads a file: 6 decimals
# of a degree are 0.11 m of latitude. Heights and projected metres pass, as 6 decimals are plenty
# there, which is why it goes unnoticed. Python's own `json` keeps them; here the precision must be
# raised before the first geometry (`geojson.geometry.DEFAULT_PRECISION`), also for reading.
# It matters to who passes ground control points or camera positions of RTK through it.
# Seen on 2026-11-29 with geojson 3.3.0: "given 52.123456449 5.123456449, kept 52.123456 5.123456:
# 0.059 m off".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet geojson==3.3.0
"$folder/venv/bin/python" - <<'PYTHON'
import json
import math
import sys
from importlib.metadata import version

import geojson

lon, lat, height = 5.123456449, 52.123456449, 12.345
text = json.dumps({"type": "Point", "coordinates": [lon, lat, height]})


def off_m() -> float:
    """How far the place moves when `text` is read and written by the package, m on a sphere."""
    there = json.loads(geojson.dumps(geojson.loads(text)))["coordinates"]
    east, north = (there[0] - lon) * math.cos(math.radians(lat)), there[1] - lat
    moved_m = math.hypot(east, north) * math.pi / 180 * 6_371_000
    print(f"given {lat} {lon}, kept {there[1]} {there[0]}: {moved_m:.3f} m off")
    return moved_m


print("geojson", version("geojson"))
rounded_m = off_m()
geojson.geometry.DEFAULT_PRECISION = 10
sys.exit(0 if 0.05 < rounded_m < 0.07 and off_m() < 1e-6 else 1)
PYTHON
