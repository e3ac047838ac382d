#!/usr/bin/env bash
# geotiff.js: the box of a raster of points is half a pixel off the box that GDAL gives for the same
# file.
#
# A GeoTIFF says whether its tie point is the corner of the first pixel (PixelIsArea) or its middle
# (PixelIsPoint, usual for heights). GDAL moves the latter by half a pixel, so that bounds are those
# of the pixels' outer edges for both. geotiff.js knows the key (`pixelIsArea()` says false) but its
# `getOrigin` and `getBoundingBox` do not use it: they begin at the middle of the first pixel and
# end half a pixel beyond the last one.
# It matters to who lays a raster of heights into a web map: with cells of 10 m it lies 5 m to the
# south-east.
# Seen on 2026-11-29 with geotiff 3.0.5 and rasterio 1.4.4: "Area: geotiff.js [500000, 4999970,
# 500040, 5000000], rasterio" the same, "Point: geotiff.js [500005, 4999965, 500045, 4999995],
# rasterio [500000, 4999970, 500040, 5000000]".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet "rasterio==1.4.4" "numpy>=1.26,<3"
npm init -y >/dev/null
npm install --silent --ignore-scripts geotiff@3.0.5 >/dev/null
cat > box.mjs <<'JS'
import { readFileSync } from 'node:fs';
import { fromArrayBuffer } from 'geotiff';

const bytes = readFileSync(process.argv[2]);
const image = await (await fromArrayBuffer(new Uint8Array(bytes).buffer)).getImage();
console.log(JSON.stringify({ box: image.getBoundingBox(), area: image.pixelIsArea() }));
JS
cat > seen.py <<'PY'
import json
import subprocess
import sys

import numpy as np
import rasterio
from rasterio.transform import from_origin

shape = {"driver": "GTiff", "width": 4, "height": 3, "count": 1, "dtype": "float32"}
place = {"crs": "EPSG:32631", "transform": from_origin(500000, 5000000, 10, 10)}
off_m = {}
for kind in ("Area", "Point"):
    with rasterio.open(f"{kind}.tif", "w", **shape, **place) as raster:
        raster.update_tags(AREA_OR_POINT=kind)
        raster.write(np.zeros((1, 3, 4), dtype=np.float32))
    with rasterio.open(f"{kind}.tif") as raster:
        bounds = list(raster.bounds)
    seen = json.loads(subprocess.check_output(["node", "box.mjs", f"{kind}.tif"]))
    off_m[kind] = (np.array(seen["box"]) - bounds).tolist()
    print(f"{kind}: geotiff.js {seen['box']} (pixelIsArea {seen['area']}), rasterio {bounds}")
sys.exit(0 if off_m == {"Area": [0, 0, 0, 0], "Point": [5, -5, 5, -5]} else 1)
PY
venv/bin/python seen.py
