#!/usr/bin/env bash
# fastkml: an overlay that is placed by its four corners loses its place when it is read.
#
# KML's GroundOverlay may say where its picture lies by `gx:LatLonQuad`, four corners of any
# quadrilateral, in place of the upright `LatLonBox`: the usual way for a single turned photograph.
# fastkml 1.4.0 does not know the element and skips it without a word, also with `strict=True`: the
# overlay has a picture and no place, and what is written again has lost the corners. An overlay
# with LatLonBox keeps it.
# It matters to who passes orthophotographs as KML through a Python tool: the picture is gone from
# the map.
# Seen on 2026-11-29 with fastkml 1.4.0: "LatLonBox: the overlay is read: True, its place is written
# again: True", "gx:LatLonQuad: the overlay is read: True, its place is written again: False".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "fastkml==1.4.0" "lxml==6.1.3"
"$folder/venv/bin/python" - <<'PYTHON'
import sys
from importlib.metadata import version

from fastkml import kml

CORNERS = "5.10,52.10 5.20,52.11 5.19,52.20 5.09,52.19"
PLACES = {
    "LatLonBox": "<LatLonBox><north>52.2</north><south>52.1</south><east>5.2</east><west>5.1</west></LatLonBox>",
    "gx:LatLonQuad": f"<gx:LatLonQuad><coordinates>{CORNERS}</coordinates></gx:LatLonQuad>",
}
SPACES = 'xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2"'
print("fastkml", version("fastkml"))
kept = {}
for name, place in PLACES.items():
    icon = "<Icon><href>a.jpg</href></Icon>"
    text = f"<kml {SPACES}><Document><GroundOverlay><name>photograph</name>{icon}{place}</GroundOverlay></Document></kml>"
    document = kml.KML.from_string(text, strict=True)
    again = document.to_string()
    kept[name] = name.removeprefix("gx:") in again
    print(f"{name}: the overlay is read: {'photograph' in again}, its place is written again: {kept[name]}")
sys.exit(0 if kept == {"LatLonBox": True, "gx:LatLonQuad": False} else 1)
PYTHON
