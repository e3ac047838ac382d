#!/usr/bin/env bash
# pycolmap: where EXIF has the whole latitude in the field of degrees, its place is off by
# decimetres.
#
# GPSLatitude is three fractions: degrees, minutes, seconds. A program that geotags photographs from
# a corrected flight path may put 521234567/10000000, 0, 0, which is as good. pycolmap rounds each
# of the three to 32 bits: near 50 degrees the steps of a float are 4e-6 degrees, 0.42 m, so
# positions snap to a lattice. The same place as 52, 7, 24.44412 is right to 0.1 mm.
# It matters to who aligns models to RTK or PPK positions of centimetres: nothing tells that they
# were rounded. Degrees, minutes and seconds, or positions given apart, keep them.
# Seen on 2026-11-29 with pycolmap 4.2.1: "whole degrees: the file says 52.123456700, pycolmap
# 52.123455048 (0.184 m off in latitude)", "degrees, minutes, seconds: the file says 52.123456700,
# pycolmap 52.123456700 (0.000 m off in latitude)".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "pycolmap==4.2.1" "numpy>=1.26,<3" "pillow==13.0.0"
cd "$folder"
venv/bin/python - <<'PYTHON'
import sys

import pycolmap
from PIL import Image
from PIL.TiffImagePlugin import IFDRational as Fraction

GPS, METRES_A_DEGREE = 0x8825, 111_267.0
forms = {
    "whole degrees": (Fraction(521234567, 10**7), Fraction(0, 1), Fraction(0, 1)),
    "degrees, minutes, seconds": (Fraction(52, 1), Fraction(7, 1), Fraction(2444412, 10**5)),
}
print("pycolmap", pycolmap.__version__)
off_m = []
for name, latitude in forms.items():
    exif = Image.Exif()
    exif[GPS] = {1: "N", 2: latitude, 3: "E", 4: (Fraction(5, 1), Fraction(0, 1), Fraction(0, 1))}
    Image.new("RGB", (64, 48)).save("a.jpg", exif=exif)
    stored = sum(float(part) / 60**power for power, part in enumerate(Image.open("a.jpg").getexif().get_ifd(GPS)[2]))
    read = pycolmap.Bitmap.read("a.jpg", True).exif_latitude()
    off_m.append(abs(read - stored) * METRES_A_DEGREE)
    print(f"{name}: the file says {stored:.9f}, pycolmap {read:.9f} ({off_m[-1]:.3f} m off in latitude)")
sys.exit(0 if 0.1 < off_m[0] < 0.3 and off_m[1] < 0.001 else 1)
PYTHON
