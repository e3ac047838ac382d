#!/usr/bin/env bash
# pycolmap: `GPSTransform.ellipsoid_to_utm` tears a site on the equator apart by 10,000 km.
#
# One would expect the places of one call in one system: the function returns one zone for all. It
# takes one zone indeed, but the false northing of 10,000,000 m is added to
# each place that lies south of the equator by itself, and no hemisphere is returned. Two places 22
# m apart, one on each side, come back 9,999,978 m apart; which of the two systems a place is in
# cannot be told. Also it knows the plain zones of 6 degrees alone: Bergen is put into 31, where UTM
# says 32 (32V).
# It matters to who maps in Kenya, Uganda, Gabon, Ecuador or Indonesia, and to who compares its
# numbers with those of a GIS in Norway or Svalbard. East, north, up (`ellipsoid_to_enu`) has no
# such seam.
# Seen on 2026-11-29 with pycolmap 4.2.1: "zone 36, northings 11.1 and 9999988.9 m", "Bergen: zone
# 31".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "pycolmap==4.2.1" "numpy>=1.26,<3"
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import numpy as np
import pycolmap

print("pycolmap", pycolmap.__version__)
transform = pycolmap.GPSTransform()
site = np.array([[0.0001, 33.0, 1100.0], [-0.0001, 33.0, 1100.0]])  # latitude, longitude, altitude
places, zone = transform.ellipsoid_to_utm(site)
print(f"zone {zone}, northings {places[0, 1]:.1f} and {places[1, 1]:.1f} m")
local = transform.ellipsoid_to_enu(site, *site[0])
apart_m = float(np.linalg.norm(local[1] - local[0]))
print(f"apart in east, north, up: {apart_m:.1f} m")
bergen = transform.ellipsoid_to_utm(np.array([[60.39, 5.32, 10.0]]))[1]
print("Bergen: zone", bergen)
torn_m = abs(places[0, 1] - places[1, 1])
sys.exit(0 if 22 < apart_m < 23 and abs(torn_m - 9_999_978) < 1 and bergen == 31 else 1)
PYTHON
