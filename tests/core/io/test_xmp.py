"""How accurate a position is, as DJI, senseFly and EXIF write it; a stranger's packet never raises."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import ExifTags, Image

from radiant_core.io.photos.jpeg import read_jpeg_facts
from radiant_core.io.photos.xmp import xmp_sigma_m

DJI = b'<rdf:Description drone-dji:RtkFlag="50" drone-dji:RtkStdLon="0.0123" drone-dji:RtkStdLat="0.0145" drone-dji:RtkStdHgt="0.0312"/>'
SENSEFLY = b"<Camera:GPSXYAccuracy>0.05</Camera:GPSXYAccuracy><Camera:GPSZAccuracy>0.07</Camera:GPSZAccuracy>"


@pytest.mark.parametrize(
    ("packet", "expected"),
    [
        (DJI, (0.0123, 0.0145, 0.0312)),
        (SENSEFLY, (0.05, 0.05, 0.07)),
        (b'<x Camera:GPSXYAccuracy="2"/>', (2.0, 2.0, 3.0)),
        (b"", None),
        (DJI.replace(b"0.0145", b"0"), None),
        (DJI.replace(b"0.0145", b"-1"), None),
        (DJI.replace(b"0.0145", b"nan"), None),
        (b"RtkStdLon=" * 10_000, None),
    ],
)
def test_accuracies_are_found(packet: bytes, expected: tuple[float, float, float] | None) -> None:
    assert xmp_sigma_m(packet) == expected


def test_random_bytes_never_raise() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        xmp_sigma_m(rng.integers(0, 256, 500, np.uint8).tobytes())


def photograph(packet: bytes | None, error_m: float | None) -> bytes:
    exif = Image.Exif()
    gps = exif.get_ifd(ExifTags.IFD.GPSInfo)
    gps.update({1: "N", 2: (47.0, 22.0, 12.0), 3: "E", 4: (8.0, 32.0, 24.0), 5: b"\x00", 6: 430.0})
    if error_m is not None:
        gps[31] = error_m
    buffer = io.BytesIO()
    Image.new("RGB", (8, 8)).save(buffer, "JPEG", exif=exif, **({} if packet is None else {"xmp": packet}))
    return buffer.getvalue()


def test_a_jpeg_says_it_in_xmp_first_and_else_in_exif() -> None:
    assert read_jpeg_facts(photograph(DJI, 5.0)).exif.position_sigma_m == (0.0123, 0.0145, 0.0312)
    assert read_jpeg_facts(photograph(None, 5.0)).exif.position_sigma_m == (5.0, 5.0, 7.5)
    facts = read_jpeg_facts(photograph(None, None)).exif
    assert facts.position_sigma_m is None and facts.lat_lon_alt is not None
