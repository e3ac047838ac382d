"""Where and how a position stands in photographs, against what exiftool 12.57 reads of the same files.

Two tests write the rows of the tables of EXIF and of XMP into photographs and compare them with
`exiftool -n`; rows that it reads otherwise, or not at all, are named with the reason. It is older
than EXIF 3.0 (CIPA DC-008-2023, GPSAltitudeRef), whose rows say so.
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
from radiant_core.sfm.colmap.workspace import warn_of_unused
from radiant_core.waypoints.reader import exif_waypoints

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


REFERENCES = {"none": (None, False), "0": (0, False), "1": (1, False), "2": (2, True), "3": (3, True), "4": (4, False)}


@pytest.mark.parametrize(("code", "is_of_sea"), REFERENCES.values(), ids=REFERENCES)
def test_what_an_altitude_counts_from_is_kept_where_it_is_said(code: int | None, is_of_sea: bool, tmp_path: Path) -> None:
    """GPSAltitudeRef of EXIF 3.0: 2 and 3 are of the sea; 0 and 1 are of the ellipsoid there and of
    the sea in EXIF 2.32."""
    exif = exif_with(changed((5, None if code is None else (BYTE, bytes([code]), 1))))
    packet = f'exif:GPSLatitude="47,22.1234N" exif:GPSLongitude="8,32.5E" exif:GPSAltitude="4555/10" exif:GPSAltitudeRef="{code}"'
    (tmp_path / "a.jpg").write_bytes(with_exif(exif))
    (tmp_path / "b.jpg").write_bytes(jpeg_with(NAMESPACE + packet_with(packet)))
    flight = exif_waypoints(tmp_path)
    assert flight.waypoints.height_kinds == (("sea",) if is_of_sea else ("absolute",))
    listing = list_photographs(tmp_path)
    assert [photo.altitude_from_sea for photo in listing.photographs] == [is_of_sea] * 2
    said = [warning for warning in warn_of_unused(listing) if "count from the sea" in warning]
    assert said == (
        [
            "2 of 2 photographs have GPS altitudes that count from the sea (GPSAltitudeRef 2 or 3), up to 107 m from those of the "
            "ellipsoid, which they are taken for: name no vertical datum in --crs."
        ]
        if is_of_sea
        else []
    )


def test_a_reference_without_an_altitude_says_nothing() -> None:
    assert not join_facts([exif_with(changed((5, (BYTE, b"\2", 1)), (6, None)))], []).altitude_from_sea


def test_names_in_utf_8_are_read() -> None:
    """Type 129 of EXIF 3.0; the lens of a photograph is told by them."""
    entries = struct.pack("<HHII", 0x0110, 129, 10, 8 + 2 + 12 + 4)
    block = b"II*\0" + struct.pack("<I", 8) + struct.pack("<H", 1) + entries + bytes(4) + b"Drone 3 x\0"
    assert join_facts([block], []).model == "Drone 3 x"


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


# What writers put into XMP; degrees and metres. `test_the_table_of_xmp_is_what_exiftool_reads` has
# exiftool's.
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
    "below the sea, EXIF 3.0": (
        'exif:GPSLatitude="47,22.1234N" exif:GPSLongitude="8,32.5E" exif:GPSAltitude="4555/10" exif:GPSAltitudeRef="3"',
        (*ZURICH[:2], -455.5),
    ),
    "beside what is shown": (
        "<Iptc4xmpExt:LocationShown><rdf:Bag><rdf:li><rdf:Description><exif:GPSLatitude>1,2N</exif:GPSLatitude>"
        "<exif:GPSLongitude>1,2E</exif:GPSLongitude></rdf:Description></rdf:li></rdf:Bag></Iptc4xmpExt:LocationShown>"
        "<exif:GPSLatitude>47,22.1234N</exif:GPSLatitude><exif:GPSLongitude>8,32.5E</exif:GPSLongitude>"
        "<Iptc4xmpExt:LocationShown/>",
        (*ZURICH[:2], math.nan),
    ),
    "of what is shown": (
        '<Iptc4xmpExt:LocationShown rdf:parseType="Resource"><exif:GPSLatitude>1,2N</exif:GPSLatitude>'
        "<exif:GPSLongitude>1,2E</exif:GPSLongitude></Iptc4xmpExt:LocationShown>",
        None,
    ),
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
    found = xmp_position(packet_with(written))
    # DJI's ten digits are 0.01 mm.
    assert found is None if wanted is None else found == pytest.approx(wanted, abs=1e-9, nan_ok=True)


def packet_with(written: str) -> bytes:
    """A whole packet with these attributes or elements."""
    names = {
        "rdf": "http://www.w3.org/1999/02/22-rdf-syntax-ns#",
        "exif": "http://ns.adobe.com/exif/1.0/",
        "drone-dji": "http://www.dji.com/drone-dji/1.0/",
        "Iptc4xmpExt": "http://iptc.org/std/Iptc4xmpExt/2008-02-29/",
        "a": "http://example.org/a/",
    }
    spaces = " ".join(f'xmlns:{name}="{address}"' for name, address in names.items())
    content = f"<rdf:Description {written}/>" if "<" not in written else f"<rdf:Description>{written}</rdf:Description>"
    return f'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF {spaces}>{content}</rdf:RDF></x:xmpmeta>'.encode()


@pytest.mark.parametrize("name", [name for name, (_, wanted) in PACKETS.items() if wanted is not None])
def test_the_table_of_xmp_is_what_exiftool_reads(name: str, tmp_path: Path) -> None:
    """Rows without a position are not compared: exiftool prints what stands there, 0, 0 and 97°
    too."""
    written, wanted = PACKETS[name]
    assert wanted is not None
    (tmp_path / "a.jpg").write_bytes(jpeg_with(NAMESPACE + packet_with(written)))
    tags = ("GPSLatitude", "GPSLongitude", "GPSLongtitude", "GPSAltitude", "AbsoluteAltitude", "GPSAltitudeRef")
    command = [needs_exiftool(), "-n", "-a", "-s", *(f"-XMP:{tag}" for tag in tags), str(tmp_path / "a.jpg")]
    lines = subprocess.check_output(command, text=True).lower().splitlines()
    told = {tag.strip(): float(value) for tag, value in (line.split(":") for line in lines)}
    alt = told.get("gpsaltitude", told.get("absolutealtitude", math.nan))
    # exiftool tells the reference on its own.
    alt = -alt if told.get("gpsaltituderef") in (1, 3) else alt
    longitude = told["gpslongitude"] if "gpslongitude" in told else told["gpslongtitude"]
    assert (told["gpslatitude"], longitude, alt) == pytest.approx(wanted, abs=1e-9, nan_ok=True)


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


def nested(block: bytes) -> bytes:
    """The block behind a directory that leads to its own one as that of EXIF."""
    first = struct.pack("<HHHII", 1, 0x8769, 4, 1, 8) + bytes(4)
    return block[:4] + struct.pack("<I", len(block)) + block[8:] + first


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
    "JPEG EXIF, in the directory of EXIF": with_exif(nested(BLOCK)),
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
