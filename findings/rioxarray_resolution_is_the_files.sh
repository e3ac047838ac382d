#!/usr/bin/env bash
# rioxarray: a raster that was coarsened or thinned says the resolution of the file it came from.
#
# One would expect `rio.resolution()`, `rio.transform()` and `rio.bounds()` of an array to be those
# of its coordinates. They come from an attribute that was read with the file, and xarray's
# `coarsen` and `isel` with a step carry it along: two cells of 1 m made into one still say 1 m, and a raster
# 10 m wide is 9 m. `to_raster` and `recalc=True` go by the coordinates, so the file that is written
# next shows nothing.
# It matters to who coarsens heights and multiplies by the area of a cell: volumes are a quarter,
# slopes double. Give `recalc=True`.
# Seen on 2026-12-01 with rioxarray 0.19.0, xarray 2026.9.0: "coarsened by 2: says 1.0 m, 9 m wide;
# recalculated 2.0 m, 10 m wide; written 2.0 m", and the same for every second cell.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "rioxarray==0.19.0" "xarray==2026.9.0" "rasterio==1.4.4" "numpy>=2,<3"
cd "$folder"
venv/bin/python - <<'PYTHON'
import sys
from importlib.metadata import version

import numpy as np
import rasterio
import rioxarray
from rasterio.transform import from_origin

place = {"crs": "EPSG:32632", "transform": from_origin(500000, 5000000, 1, 1)}
with rasterio.open("heights.tif", "w", driver="GTiff", width=10, height=10, count=1, dtype="float32", **place) as raster:
    raster.write(np.ones((1, 10, 10), np.float32))
heights = rioxarray.open_rasterio("heights.tif")
arrays = {"file": heights, "coarsened by 2": heights.coarsen(x=2, y=2).mean(), "every second": heights[:, ::2, ::2]}
print(f"rioxarray {version('rioxarray')}, xarray {version('xarray')}")
seen = {}
for name, array in arrays.items():
    says_m, really_m = array.rio.resolution()[0], array.rio.resolution(recalc=True)[0]
    (west, _, east, _), (left, _, right, _) = array.rio.bounds(), array.rio.bounds(recalc=True)
    array.rio.to_raster("again.tif")
    with rasterio.open("again.tif") as raster:
        written_m = raster.res[0]
    seen[name] = says_m, really_m, written_m, east - west, right - left
    print(f"{name}: says {says_m} m, {east - west:.0f} m wide; recalculated {really_m} m, {right - left:.0f} m wide; written {written_m} m")
right = seen["file"] == (1, 1, 1, 10, 10)
sys.exit(0 if right and seen["coarsened by 2"] == seen["every second"] == (1, 2, 2, 9, 10) else 1)
PYTHON
