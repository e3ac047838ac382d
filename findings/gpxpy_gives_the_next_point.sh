#!/usr/bin/env bash
# gpxpy: `get_location_at` gives the next point of the track, not the place at that time.
#
# One would expect a place between the two points around the time, or the nearer of them. The
# method returns the first point that is not earlier: 0.1 s after a point one gets the following
# one, 0.9 s ahead, and nothing in it says so but its time. Every place is ahead of the truth, so
# a mean does not cancel it. (Its docstring says "approx. location".)
# It matters to who geotags photographs by a track: at 15 m/s and a point each second they lie 7.5
# m along the flight on average, forth and back in opposite directions. Interpolate.
# Seen on 2026-12-01 with gpxpy 1.6.2: "at 3.1 s: the place of 4.0 s, 10.0 m ahead", "at 3.5 s:
# the place of 4.0 s, 5.5 m ahead", "at 3.9 s: the place of 4.0 s, 1.1 m ahead".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "gpxpy==1.6.2"
"$folder/venv/bin/python" - <<'PYTHON'
import sys
from datetime import datetime, timedelta, timezone
from importlib.metadata import version

import gpxpy

start = datetime(2026, 6, 1, 10, tzinfo=timezone.utc)
points = "".join(
    f'<trkpt lat="{50 + 0.0001 * second:.4f}" lon="8"><time>{(start + timedelta(seconds=second)):%Y-%m-%dT%H:%M:%SZ}</time></trkpt>'
    for second in range(10)
)
text = f'<gpx version="1.1" creator="a" xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>{points}</trkseg></trk></gpx>'
track = gpxpy.parse(text)
print("gpxpy", version("gpxpy"))
given = {}
for second in (3.0, 3.1, 3.5, 3.9):
    (place,) = track.get_location_at(start + timedelta(seconds=second))
    given[second] = round((place.latitude - 50) * 1e4, 3)
    print(f"at {second} s: the place of {given[second]} s, {(given[second] - second) * 11.1:.1f} m ahead")
sys.exit(0 if given == {3.0: 3, 3.1: 4, 3.5: 4, 3.9: 4} else 1)
PYTHON
