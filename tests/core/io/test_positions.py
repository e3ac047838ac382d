"""Where and how a position stands in photographs, against what exiftool 12.57 reads of the same files.

The files were made as below and read by `exiftool -n -Composite:GPSLatitude -Composite:GPSLongitude
-Composite:GPSAltitude`; its figures stand in the tables. Where the row says "EXIF 3.0" exiftool
12.57 is older than the standard (CIPA DC-008-2023, 4.6.7.1.6).
"""

from __future__ import annotations

import io
import math
import shutil
import struct
import subprocess
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from radiant_core.io.photos.facts import file_facts, read_exif_of
from radiant_core.io.photos.jpeg import join_facts
from radiant_core.io.photos.listing import MAX_FILE_BYTES, doubts_warning, list_photographs, photograph_positions
from radiant_core.io.photos.xmp_position import xmp_position

PIXELS = np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8)
ZURICH = (47.0 + 22.1234 / 60, 8.0 + 32.5 / 60, 455.5)
RATIONAL, SIGNED, DOUBLE, BYTE, SHORT, TEXT = 5, 10, 12, 1, 3, 2
Entry = tuple[int, int, bytes, int]
"""Tag, type, raw value, count."""


def ratios(*pairs: tuple[int, int], kind: int = RATIONAL) -> tuple[int, bytes, int]:
    return kind, b"".join(struct.pack("<2i" if kind == SIGNED else "<2I", *pair) for pair in pairs), len(pairs)


def letter(text: bytes) -> tuple[int, bytes, int]:
    return TEXT, text, len(text)


LAT, LON = ratios((47, 1), (221234, 10000), (0, 1)), ratios((8, 1), (325, 10), (0, 1))
GPS = {1: letter(b"N\0"), 2: LAT, 3: letter(b"E\0"), 4: LON, 5: (BYTE, b"\0", 1), 6: ratios((4555, 10))}


def exif_with(gps: dict[int, tuple[int, bytes, int]]) -> bytes:
    """A TIFF header, a directory that leads to one of GPS, and that."""
    at = 8 + 2 + 12 + 4
    data_at = at + 2 + 12 * len(gps) + 4
    entries, data = b"", b""
    for tag, (kind, raw, count) in sorted(gps.items()):
        value = raw.ljust(4, b"\0") if len(raw) <= 4 else struct.pack("<I", data_at + len(data))
        data += raw if len(raw) > 4 else b""
        entries += struct.pack("<HHI", tag, kind, count) + value
    main = struct.pack("<HHHII", 1, 0x8825, 4, 1, at) + bytes(4)
    return b"II*\0" + struct.pack("<I", 8) + main + struct.pack("<H", len(gps)) + entries + bytes(4) + data


def position_of(gps: dict[int, tuple[int, bytes, int]]) -> tuple[float, float, float] | None:
    return join_facts([exif_with(gps)], []).lat_lon_alt


def changed(*changes: tuple[int, tuple[int, bytes, int] | None]) -> dict[int, tuple[int, bytes, int]]:
    gps = {**GPS, **{tag: value for tag, value in changes if value is not None}}
    return {tag: value for tag, value in gps.items() if (tag, None) not in changes}


# Changes of the GPS directory; latitude, longitude and altitude that exiftool 12.57 gives.
FORMS = {
    "as the standard has it": (changed(), (47.3687233333333, 8.54166666666667, 455.5)),
    "degrees alone": (changed((2, ratios((473687233, 10000000)))), (47.3687233, 8.54166666666667, 455.5)),
    "two numbers": (changed((2, ratios((47, 1), (221234, 10000)))), (47.3687233333333, 8.54166666666667, 455.5)),
    "seconds of 0/0": (changed((2, ratios((47, 1), (221234, 10000), (0, 0)))), (47.3687233333333, 8.54166666666667, 455.5)),
    "more than 60 minutes": (changed((2, ratios((46, 1), (821234, 10000), (0, 1)))), (47.3687233333333, 8.54166666666667, 455.5)),
    "doubles": (changed((2, (DOUBLE, struct.pack("<3d", 47, 22.1234, 0), 3))), (47.3687233333333, 8.54166666666667, 455.5)),
    "lower case": (changed((1, letter(b"s\0")), (3, letter(b"w\0"))), (-47.3687233333333, -8.54166666666667, 455.5)),
    "a letter without NUL": (changed((1, letter(b"S"))), (-47.3687233333333, 8.54166666666667, 455.5)),
    "words": (changed((1, letter(b"South\0")), (3, letter(b"West\0"))), (-47.3687233333333, -8.54166666666667, 455.5)),
    "below the sea": (changed((5, (BYTE, b"\1", 1))), (47.3687233333333, 8.54166666666667, -455.5)),
    "above, EXIF 3.0": (changed((5, (BYTE, b"\2", 1))), (47.3687233333333, 8.54166666666667, 455.5)),
    "below, EXIF 3.0": (changed((5, (BYTE, b"\3", 1))), (47.3687233333333, 8.54166666666667, -455.5)),
    "a reference that is a short": (changed((5, (SHORT, b"\1\0", 1))), (47.3687233333333, 8.54166666666667, -455.5)),
    "a negative altitude": (changed((6, ratios((-4555, 10), kind=SIGNED))), (47.3687233333333, 8.54166666666667, -455.5)),
    "no altitude": (changed((6, None)), (47.3687233333333, 8.54166666666667, math.nan)),
    "an altitude by zero": (changed((6, ratios((4555, 0)))), (47.3687233333333, 8.54166666666667, math.nan)),
}


@pytest.mark.parametrize(("gps", "wanted"), FORMS.values(), ids=FORMS)
def test_every_form_of_a_position_in_exif(gps: dict[int, tuple[int, bytes, int]], wanted: tuple[float, float, float]) -> None:
    # 1e-9° are 0.1 mm; exiftool prints 15 digits.
    assert position_of(gps) == pytest.approx(wanted, abs=1e-9, nan_ok=True)


def needs_exiftool() -> str:
    path = shutil.which("exiftool")
    if path is None:
        pytest.skip("exiftool is not installed")
    return path


UNREAD_BY_EXIFTOOL = ("above, EXIF 3.0", "below, EXIF 3.0", "words", "seconds of 0/0", "an altitude by zero")
"""Forms that it reads otherwise or not at all; here they mean what the standard's note says of parts
that are left out."""


@pytest.mark.parametrize("name", [name for name in FORMS if name not in UNREAD_BY_EXIFTOOL])
def test_the_table_is_what_exiftool_reads(name: str, tmp_path: Path) -> None:
    gps, wanted = FORMS[name]
    jpeg = with_exif(exif_with(gps))
    (tmp_path / "a.jpg").write_bytes(jpeg)
    tags = ("GPSLatitude", "GPSLongitude", "GPSAltitude")
    asked = [f"-Composite:{tag}" for tag in tags]
    told = subprocess.check_output([needs_exiftool(), "-n", "-s3", "-f", *asked, str(tmp_path / "a.jpg")], text=True).split()
    read = [math.nan if value == "-" else float(value) for value in told]
    assert read == pytest.approx(wanted, abs=1e-9, nan_ok=True)


def with_exif(block: bytes, *, jpeg: bytes | None = None) -> bytes:
    jpeg = jpeg or cv2.imencode(".jpg", PIXELS)[1].tobytes()
    return jpeg[:2] + app1(b"Exif\0\0" + block) + jpeg[2:]


def app1(content: bytes) -> bytes:
    return b"\xff\xe1" + struct.pack(">H", len(content) + 2) + content


@pytest.mark.parametrize(
    ("changes", "doubt"),
    [
        ([(1, None)], "a latitude without its letter N or S"),
        ([(3, letter(b"?\0"))], "a longitude without its letter E or W"),
        ([(2, ratios((47, 0), (22, 1), (0, 1)))], "a latitude divided by zero"),
        ([(2, ratios((97, 1), (22, 1), (0, 1)))], "a position of 97.3667°, 8.54167°"),
        ([(2, ratios((-47, 1), (0, 1), (0, 1), kind=SIGNED))], "a negative latitude with the letter N"),
        ([(2, ratios((0, 1))), (4, ratios((0, 1)))], ""),
    ],
)
def test_what_is_no_position_is_not_used_and_said(changes: list[tuple[int, tuple[int, bytes, int] | None]], doubt: str) -> None:
    facts = join_facts([exif_with(changed(*changes))], [])
    assert facts.lat_lon_alt is None and facts.position_doubt == doubt
    said = doubts_warning({"a.jpg": doubt, "b.jpg": ""}, 2)
    assert said == ((f"1 of 2 photographs have {doubt}, which is no position and not used: a.jpg.",) if doubt else ())


def test_another_datum_is_said_and_taken_for_wgs_84() -> None:
    facts = join_facts([exif_with(changed((0x12, letter(b"TOKYO\0"))))], [])
    assert facts.lat_lon_alt is not None and facts.position_doubt == "GPS in the datum TOKYO"
    for name in (b"WGS-84\0", b"WGS 84\0", b"WGS84\0"):
        assert join_facts([exif_with(changed((0x12, letter(name))))], []).position_doubt == ""


# What writers put into XMP; degrees and metres as exiftool 12.57 reads them.
PACKETS = {
    "exif, minutes": (
        'exif:GPSLatitude="47,22.1234N" exif:GPSLongitude="8,32.5E" exif:GPSAltitude="4555/10" exif:GPSAltitudeRef="0"',
        ZURICH,
    ),
    "exif, seconds": ('exif:GPSLatitude="47,22,7.404N" exif:GPSLongitude="8,32,30E" exif:GPSAltitude="455.5"', ZURICH),
    "exif, elements": (
        "<exif:GPSLatitude>47,22.1234S</exif:GPSLatitude><exif:GPSLongitude>8,32.5W</exif:GPSLongitude>"
        "<exif:GPSAltitudeRef>1</exif:GPSAltitudeRef><exif:GPSAltitude>4555/10</exif:GPSAltitude>",
        (-ZURICH[0], -ZURICH[1], -455.5),
    ),
    "DJI": ('drone-dji:AbsoluteAltitude="+455.50" drone-dji:GpsLatitude="+47.3687233333" drone-dji:GpsLongitude="+8.5416666667"', ZURICH),
    "DJI, as it spells": (
        'drone-dji:GpsLatitude="47.3687233333" drone-dji:GpsLongtitude="-8.5416666667"',
        (ZURICH[0], -ZURICH[1], math.nan),
    ),
    "DJI, relative": (
        'drone-dji:RelativeAltitude="+80.1" drone-dji:GpsLatitude="47.3687233333" drone-dji:GpsLongitude="8.5416666667"',
        (*ZURICH[:2], math.nan),
    ),
    "below": ('a:GpsLatitude="31.5" a:GpsLongitude="35.5" a:AbsoluteAltitude="-412.25"', (31.5, 35.5, -412.25)),
    "no fix": ('drone-dji:GpsLatitude="0.00" drone-dji:GpsLongitude="0.0"', None),
    "of home": (
        'drone-dji:HomeLatitude="47.3" drone-dji:HomeLongitude="8.5" exif:GPSDestLatitude="1,2N" exif:GPSDestLongitude="1,2E"',
        None,
    ),
    "a letter of the other": ('exif:GPSLatitude="47,22.1E" exif:GPSLongitude="8,32.5E"', None),
    "off the globe": ('exif:GPSLatitude="97,22.1N" exif:GPSLongitude="8,32.5E"', None),
}


@pytest.mark.parametrize(("written", "wanted"), PACKETS.values(), ids=PACKETS)
def test_every_form_of_a_position_in_xmp(written: str, wanted: tuple[float, float, float] | None) -> None:
    packet = f"<x:xmpmeta><rdf:Description {written}/></x:xmpmeta>" if "<" not in written else f"<rdf:Description>{written}"
    found = xmp_position(packet.encode())
    # DJI's ten digits are 0.01 mm.
    assert found is None if wanted is None else found == pytest.approx(wanted, abs=1e-9, nan_ok=True)


XMP = (
    b'<x:xmpmeta><rdf:Description drone-dji:GpsLatitude="47.3687233333" drone-dji:GpsLongitude="8.5416666667" a:AbsoluteAltitude="455.5"/>'
)
NAMESPACE, EXTENSION = b"http://ns.adobe.com/xap/1.0/\0", b"http://ns.adobe.com/xmp/extension/\0"


def png(*chunks: tuple[bytes, bytes], behind: bool = False) -> bytes:
    data = cv2.imencode(".png", PIXELS)[1].tobytes()
    at = len(data) - 12 if behind else 8 + 25
    made = b"".join(struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)) for kind, body in chunks)
    return data[:at] + made + data[at:]


def profile(name: bytes, content: bytes) -> bytes:
    """As ImageMagick writes one: name, length and lines of digits."""
    digits = content.hex()
    lines = "\n".join(digits[start : start + 72] for start in range(0, len(digits), 72))
    return f"\n{name.decode()}\n{len(content):8d}\n{lines}\n".encode()


def jpeg_with(*segments: bytes) -> bytes:
    data = cv2.imencode(".jpg", PIXELS)[1].tobytes()
    return data[:2] + b"".join(app1(segment) for segment in segments) + data[2:]


def longer_packet() -> bytes:
    name = b"0123456789ABCDEF0123456789ABCDEF"
    parts = [(60, XMP[60:]), (0, XMP[:60])]
    return jpeg_with(*(EXTENSION + name + struct.pack(">2I", len(XMP), at) + part for at, part in parts))


def tiff_with(*, big: bool, xmp: bool) -> bytes:
    file = io.BytesIO()
    tags = [(700, 1, len(XMP), XMP, True)] if xmp else []
    tifffile.imwrite(file, PIXELS, photometric="rgb", bigtiff=big, extratags=tags)
    return file.getvalue()


def exif_tiff() -> bytes:
    """A picture whose first directory leads to one of GPS that is appended."""
    file = io.BytesIO()
    tifffile.imwrite(file, PIXELS, photometric="rgb", bigtiff=True, extratags=[(0x8826, 16, 1, 0xABCDEF, True)])
    data = file.getvalue().replace(struct.pack("<HH", 0x8826, 16), struct.pack("<HH", 0x8825, 16))
    entries = b"".join(
        struct.pack("<HHQ", tag, kind, count) + (raw if len(raw) <= 8 else struct.pack("<Q", 0)).ljust(8, b"\0")
        for tag, (kind, raw, count) in sorted(GPS.items())
    )
    at = len(data)
    tail = bytearray(struct.pack("<Q", len(GPS)) + entries + bytes(8))
    for index, (_, (_, raw, _)) in enumerate(sorted(GPS.items())):
        if len(raw) > 8:
            struct.pack_into("<Q", tail, 8 + 20 * index + 12, at + len(tail))
            tail += raw
    return data.replace(struct.pack("<Q", 0xABCDEF), struct.pack("<Q", at)) + bytes(tail)


BLOCK = exif_with(GPS)
PLACES = {
    "PNG eXIf": png((b"eXIf", BLOCK)),
    "PNG eXIf behind the pixels": png((b"eXIf", BLOCK), behind=True),
    "PNG eXIf with the head of JPEG": png((b"eXIf", b"Exif\0\0" + BLOCK)),
    "PNG XMP": png((b"iTXt", b"XML:com.adobe.xmp\0\0\0\0\0" + XMP)),
    "PNG XMP, packed": png((b"iTXt", b"XML:com.adobe.xmp\0\1\0\0\0" + zlib.compress(XMP))),
    "PNG profile exif": png((b"zTXt", b"Raw profile type exif\0\0" + zlib.compress(profile(b"exif", b"Exif\0\0" + BLOCK)))),
    "PNG profile APP1": png((b"tEXt", b"Raw profile type APP1\0" + profile(b"generic", b"Exif\0\0" + BLOCK))),
    "PNG profile APP1, XMP": png((b"zTXt", b"Raw profile type APP1\0\0" + zlib.compress(profile(b"generic", NAMESPACE + XMP)))),
    "JPEG EXIF": with_exif(BLOCK),
    "JPEG XMP": jpeg_with(NAMESPACE + XMP),
    "JPEG EXIF behind XMP": jpeg_with(NAMESPACE + b"<x/>", b"Exif\0\0" + BLOCK),
    "JPEG second EXIF": jpeg_with(b"Exif\0\0" + exif_with({0: (BYTE, b"\2\3\0\0", 4)}), b"Exif\0\0" + BLOCK),
    "JPEG EXIF behind 300 kB": jpeg_with(*[b"FLIR\0" + bytes(60_000)] * 5, b"Exif\0\0" + BLOCK),
    "JPEG XMP longer than a segment": longer_packet(),
    "TIFF XMP": tiff_with(big=False, xmp=True),
    "BigTIFF XMP": tiff_with(big=True, xmp=True),
    "BigTIFF GPS": exif_tiff(),
}


@pytest.mark.parametrize(("name", "data"), PLACES.items(), ids=PLACES)
def test_a_position_is_read_wherever_it_stands(name: str, data: bytes, tmp_path: Path) -> None:
    suffix = {"PNG": ".png", "JPEG": ".jpg"}.get(name.split(maxsplit=1)[0], ".tif")
    for stem in ("a", "b"):
        (tmp_path / f"{stem}{suffix}").write_bytes(data)
    assert [photo.lat_lon_alt for photo in list_photographs(tmp_path).photographs] == [pytest.approx(ZURICH, abs=1e-9)] * 2
    assert photograph_positions(tmp_path) == {f"{stem}{suffix}": pytest.approx(ZURICH, abs=1e-9) for stem in ("a", "b")}
    assert read_exif_of(tmp_path / f"a{suffix}", MAX_FILE_BYTES) == file_facts(data)[2]


def test_exif_and_xmp_that_contradict_each_other_are_said() -> None:
    near = XMP.replace(b"47.3687", b"47.3688")
    assert file_facts(jpeg_with(b"Exif\0\0" + BLOCK, NAMESPACE + near))[2].position_doubt == ""
    far = file_facts(jpeg_with(b"Exif\0\0" + BLOCK, NAMESPACE + XMP.replace(b"47.3687", b"48.3687")))[2]
    assert far.lat_lon_alt == pytest.approx(ZURICH, abs=1e-9)
    assert far.position_doubt == "EXIF and XMP with positions about 110 km apart"
    high = file_facts(jpeg_with(b"Exif\0\0" + BLOCK, NAMESPACE + XMP.replace(b'"455.5"', b'"120.0"')))[2]
    assert high.position_doubt == "EXIF and XMP with altitudes about 340 m apart"
    said = doubts_warning({"a.jpg": far.position_doubt}, 1)
    assert said == ("1 of 1 photographs have EXIF and XMP with positions about 110 km apart, of which that of EXIF is used: a.jpg.",)


def test_an_altitude_that_xmp_alone_has_is_used() -> None:
    block = exif_with(changed((6, None)))
    assert file_facts(jpeg_with(b"Exif\0\0" + block, NAMESPACE + XMP))[2].lat_lon_alt == pytest.approx(ZURICH, abs=1e-8)


def test_damaged_chunks_and_packets_never_raise() -> None:
    rng = np.random.default_rng(0)
    for data in PLACES.values():
        for _ in range(60):
            spoiled = bytearray(data[:4000])
            for _ in range(int(rng.integers(1, 8))):
                spoiled[rng.integers(8, len(spoiled))] = rng.integers(256)
            position = file_facts(bytes(spoiled))[2].lat_lon_alt
            assert position is None or (abs(position[0]) <= 90 and abs(position[1]) <= 180)
