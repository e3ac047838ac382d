"""What a JPEG says before its pixels: size, camera, focal length, GPS, whether it is whole; and
what EXIF and XMP of any file say together.

Walks the marker segments once per photograph, a few kilobytes each; no pixel is decoded. A damaged
EXIF block only loses its own facts. Layout: ITU-T T.81 annex B (markers), CIPA DC-008 (EXIF), Adobe
XMP part 3 (packets longer than a segment); directories are read by `tiff.py`, positions by
`gps.py` and `xmp_position.py`.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime

import numpy as np

from radiant_core.frames import enu_from_geodetic
from radiant_core.io.photos.gps import GPS_ERROR, Position, read_fix
from radiant_core.io.photos.tiff import XMP_PACKET, first_directory, inner_directory, number, text
from radiant_core.io.photos.xmp import VERTICAL_SHARE, Sphere, xmp_sigma_m, xmp_sphere
from radiant_core.io.photos.xmp_position import xmp_counts_from_sea, xmp_position

_START_OF_FRAME = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_START_OF_SCAN, _END_OF_IMAGE, _APP1, _APP2 = 0xDA, 0xD9, 0xE1, 0xE2
_EXIF_SIGNATURE = b"Exif\0\0"
_KEPT_SIGNATURES = {_APP1: (_EXIF_SIGNATURE, b"http://ns.adobe.com/xap/1.0/\0"), _APP2: (b"ICC_PROFILE\0",)}
"""EXIF, XMP and colour profiles say the same of pixels that were moved; other segments may not."""
IMAGE_WIDTH, IMAGE_HEIGHT = 0x0100, 0x0101
BITS_PER_SAMPLE, PHOTOMETRIC, SAMPLES_PER_PIXEL, EXTRA_SAMPLES = 0x0102, 0x0106, 0x0115, 0x0152
_RGB, _UNSPECIFIED = 2, 0
MAKE, MODEL, EXIF_POINTER, GPS_POINTER = 0x010F, 0x0110, 0x8769, 0x8825
FOCAL_LENGTH, FOCAL_35MM, DIGITAL_ZOOM = 0x920A, 0xA405, 0xA404
PIXEL_WIDTH, PIXEL_HEIGHT = 0xA002, 0xA003
BODY_SERIAL, CAMERA_SERIAL, LENS_MODEL, LENS_SERIAL = 0xA431, 0xC62F, 0xA434, 0xA435
EXPOSURE_TIME, F_NUMBER, ISO_SPEED, DATE_TIME_ORIGINAL, SUBSEC_TIME_ORIGINAL = 0x829A, 0x829D, 0x8827, 0x9003, 0x9291
_XMP, _MORE_XMP = b"http://ns.adobe.com/xap/1.0/\0", b"http://ns.adobe.com/xmp/extension/\0"
_MORE_XMP_HEAD = 40
"""Before each part of a longer packet: its name, its length and where the part belongs."""
LEAST_APART_M = 30.0
"""Two positions of one photograph that lie farther apart contradict each other: formats round to
metres, receivers are good to ten."""
_WRITTEN_SERIAL = re.compile(rb"[\s<:](?:Drone|Camera)?SerialNumber\s{0,4}(?:=\s{0,4}[\"']|>)\s{0,8}([\w -]{1,64})")


@dataclass(frozen=True, kw_only=True)
class ExifFacts:
    """What EXIF says; empty text or None where it says nothing usable."""

    make: str = ""
    model: str = ""
    focal_mm: float | None = None
    lat_lon_alt: tuple[float, float, float] | None = None
    """Degrees north and east, metres (NaN: no altitude); None without a place on the globe."""
    taken_s: float | None = None
    """When it was taken, in seconds of the camera's clock."""
    position_sigma_m: tuple[float, float, float] | None = None
    """Standard deviations of the position east, north, up, where the receiver says."""
    log2_exposure: float | None = None
    """log₂(t ISO / N²): how bright the camera makes a scene, in stops."""
    focal_35mm: float | None = None
    """Focal length that gives the same view on 36 × 24 mm, as the camera says."""
    digital_zoom: float = 1.0
    lens: str = ""
    serial: str = ""
    """Of the body and the lens."""
    taken_wh: tuple[int, int] | None = None
    """Size in px that the camera says it took; a picture cut from it has another."""
    position_doubt: str = ""
    """What stands in place of a position, or what is doubtful in one."""
    altitude_from_sea: bool = False
    """Whether it is said that the altitude counts from the sea; else nobody says from what."""
    sphere: Sphere = ""
    """Of an equirectangular panorama that says so: how much of the sphere it shows."""


@dataclass(frozen=True, kw_only=True)
class JpegFacts:
    """What a JPEG's markers say; size_wh None: no frame header, whole False: the end is missing."""

    size_wh: tuple[int, int] | None
    whole: bool
    exif: ExifFacts
    has_scan: bool = False
    """Whether the bytes reach to the pixels, so that all segments were seen."""


def read_jpeg_outline(data: bytes) -> tuple[tuple[int, int] | None, bool]:
    """Size and wholeness of the JPEG `data` as `read_jpeg_facts` has them, its EXIF left unread."""
    size_wh, scan_offset = _size_and_scan(data)
    return size_wh, _is_whole(data, scan_offset)


def _size_and_scan(data: bytes) -> tuple[tuple[int, int] | None, int | None]:
    size_wh, scan_offset = None, None
    for marker, start, end in _segments(data):
        if marker in _START_OF_FRAME and end - start >= 5:
            height, width = struct.unpack_from(">HH", data, start + 1)
            size_wh = (width, height) if width and height else None
        elif marker == _START_OF_SCAN:
            scan_offset = end
    return size_wh, scan_offset


def _is_whole(data: bytes, scan_offset: int | None) -> bool:
    # In a scan 0xFF is followed by 0x00 or a restart marker, so FF D9 behind it is the real end.
    return scan_offset is not None and data.rfind(b"\xff\xd9", scan_offset) >= 0


def read_jpeg_facts(data: bytes) -> JpegFacts:
    """Size, wholeness and EXIF of the JPEG `data`; never raises, whatever the bytes are."""
    size_wh, scan_offset = _size_and_scan(data)
    blocks: list[bytes] = []
    packets: list[bytes] = []
    longer: dict[bytes, list[tuple[int, bytes]]] = {}
    for marker, start, end in _segments(data):
        if marker == _APP1 and data.startswith(_EXIF_SIGNATURE, start):
            blocks.append(data[start + len(_EXIF_SIGNATURE) : end])
        elif marker == _APP1 and data.startswith(_XMP, start):
            packets.append(data[start + len(_XMP) : end])
        elif marker == _APP1 and data.startswith(_MORE_XMP, start):
            name, at, part = _part_of_xmp(data[start + len(_MORE_XMP) : end])
            longer.setdefault(name, []).append((at, part))
    packets += [b"".join(part for _, part in sorted(parts)) for parts in longer.values()]
    whole, has_scan = _is_whole(data, scan_offset), scan_offset is not None
    return JpegFacts(size_wh=size_wh, whole=whole, exif=join_facts(blocks, packets), has_scan=has_scan)


def _part_of_xmp(segment: bytes) -> tuple[bytes, int, bytes]:
    """Name, place and content of a part of a packet that is longer than a segment."""
    return segment[:32], int.from_bytes(segment[36:_MORE_XMP_HEAD], "big"), segment[_MORE_XMP_HEAD:]


def join_facts(blocks: Sequence[bytes], packets: Sequence[bytes]) -> ExifFacts:
    """What EXIF blocks and XMP packets of one file say together: the first that says something; a
    position of EXIF before one of XMP, and a doubt where both are there and lie apart."""
    exif = _first_said([read_exif(block) for block in blocks])
    sigma_m = next((sigma for packet in packets if (sigma := xmp_sigma_m(packet)) is not None), None)
    serial = next((match[1].decode().strip() for packet in packets if (match := _WRITTEN_SERIAL.search(packet))), "")
    positioning_packet, written = next(((packet, place) for packet in packets if (place := xmp_position(packet)) is not None), (b"", None))
    sphere = next((part for packet in packets if (part := xmp_sphere(packet))), "")
    exif = replace(exif, position_sigma_m=sigma_m or exif.position_sigma_m, serial=exif.serial or serial, sphere=sphere)
    if written is None:
        return exif
    if exif.lat_lon_alt is None:
        return replace(exif, lat_lon_alt=written, position_doubt="", altitude_from_sea=xmp_counts_from_sea(positioning_packet))
    compared = _compared(exif, exif.lat_lon_alt, written)
    takes_altitude = compared.lat_lon_alt != exif.lat_lon_alt
    return replace(compared, altitude_from_sea=xmp_counts_from_sea(positioning_packet)) if takes_altitude else compared


def _first_said(facts: Sequence[ExifFacts]) -> ExifFacts:
    joined = facts[0] if facts else ExifFacts()
    for more in facts[1:]:
        unsaid = {field.name for field in fields(ExifFacts) if getattr(joined, field.name) == field.default}
        joined = replace(joined, **{name: getattr(more, name) for name in unsaid})
    return joined


def _compared(exif: ExifFacts, position: Position, written: Position) -> ExifFacts:
    """The facts with the altitude of XMP where EXIF has none, and with what contradicts."""
    apart_m = _apart_m(position, written)
    if apart_m > LEAST_APART_M:
        return replace(exif, position_doubt=exif.position_doubt or f"EXIF and XMP with positions {_said_m(apart_m)} apart")
    if math.isnan(position[2]):
        return replace(exif, lat_lon_alt=(*position[:2], written[2]))
    up_m = abs(position[2] - written[2])
    if up_m > LEAST_APART_M:
        return replace(exif, position_doubt=exif.position_doubt or f"EXIF and XMP with altitudes {_said_m(up_m)} apart")
    return exif


def _said_m(metres: float) -> str:
    """To two digits, so that photographs of one fault are counted together."""
    step = 10 ** max(0, math.floor(math.log10(metres)) - 1)
    return f"about {round(metres / step) * step:,.0f} m" if metres < 1e4 else f"about {round(metres / step) * step / 1e3:,.0f} km"


def _apart_m(first: Position, second: Position) -> float:
    """Distance of two positions on the ellipsoid, through it."""
    here, there = ((lat, lon, 0.0) for lat, lon, _ in (first, second))
    return float(np.linalg.norm(enu_from_geodetic([there], here)))


def kept_segments(data: bytes) -> bytes:
    """EXIF, XMP and colour profile of the JPEG `data` for one made from it; never raises."""
    segments = [
        data[start - 4 : end] for marker, start, end in _segments(data) if data[start:end].startswith(_KEPT_SIGNATURES.get(marker, ()))
    ]
    return b"".join(segments)


def _segments(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Marker, start and end of each segment's content, up to and with the first start of scan."""
    offset = 2 if data[:2] == b"\xff\xd8" else len(data)
    while offset + 4 <= len(data) and data[offset] == 0xFF:
        marker = data[offset + 1]
        if marker == 0xFF:
            offset += 1
            continue
        end = offset + 2 + int.from_bytes(data[offset + 2 : offset + 4], "big")
        if end < offset + 4 or end > len(data):
            return
        yield marker, offset + 4, end
        if marker in (_START_OF_SCAN, _END_OF_IMAGE):
            return
        offset = end


def read_tiff_size(tiff: bytes) -> tuple[int, int] | None:
    """Width and height in px of the first picture in a TIFF file, or None; never raises."""
    main = first_directory(tiff)
    width, height = (number(main.get(tag)) for tag in (IMAGE_WIDTH, IMAGE_HEIGHT))
    return (int(width), int(height)) if width and height and width >= 1 and height >= 1 else None


def has_tiff_alpha(tiff: bytes) -> bool:
    """Whether the first picture in a TIFF is RGB with an alpha channel; a fourth channel that is
    said to be something else is none."""
    main = first_directory(tiff)
    is_rgb_and_one = number(main.get(PHOTOMETRIC)) == _RGB and number(main.get(SAMPLES_PER_PIXEL)) == 4
    # Many write RGBA without a word on what the fourth is.
    return is_rgb_and_one and number(main.get(EXTRA_SAMPLES)) != _UNSPECIFIED


def read_tiff_facts(tiff: bytes) -> ExifFacts:
    """What the directories of a TIFF file and the XMP packet in it say; never raises."""
    packet = first_directory(tiff).get(XMP_PACKET)
    return join_facts([tiff], [packet] if isinstance(packet, bytes) else [])


def read_exif(tiff: bytes) -> ExifFacts:
    """The facts in an EXIF block (a TIFF header and its directories); never raises."""
    main = first_directory(tiff)
    details = inner_directory(tiff, main.get(EXIF_POINTER))
    # The standard has it in the main directory; some writers have it in the one of EXIF.
    gps = inner_directory(tiff, main.get(GPS_POINTER, details.get(GPS_POINTER)))
    fix = read_fix(gps)
    zoom = number(details.get(DIGITAL_ZOOM))
    taken_wh = tuple(int(number(details.get(tag)) or 0) for tag in (PIXEL_WIDTH, PIXEL_HEIGHT))
    serials = (text(details.get(BODY_SERIAL)) or text(main.get(CAMERA_SERIAL)), text(details.get(LENS_SERIAL)))
    return ExifFacts(
        make=text(main.get(MAKE)),
        model=text(main.get(MODEL)),
        focal_mm=_positive(number(details.get(FOCAL_LENGTH))),
        focal_35mm=_positive(number(details.get(FOCAL_35MM))),
        # 0 is how the standard says that there was none.
        digital_zoom=zoom if zoom is not None and zoom > 0 else 1.0,
        lens=text(details.get(LENS_MODEL)),
        serial=" ".join(part for part in serials if part),
        taken_wh=(taken_wh[0], taken_wh[1]) if min(taken_wh) > 0 else None,
        lat_lon_alt=fix.lat_lon_alt,
        position_doubt=fix.fault or (f"GPS in the datum {fix.datum}" if fix.datum and fix.lat_lon_alt else ""),
        altitude_from_sea=fix.counts_from_sea,
        position_sigma_m=_sigma_of(number(gps.get(GPS_ERROR))),
        taken_s=_seconds(text(details.get(DATE_TIME_ORIGINAL)), text(details.get(SUBSEC_TIME_ORIGINAL))),
        log2_exposure=_log2_exposure(*(number(details.get(tag)) for tag in (EXPOSURE_TIME, F_NUMBER, ISO_SPEED))),
    )


def _positive(value: float | None) -> float | None:
    return value if value is not None and value > 0 else None


def _sigma_of(error_m: float | None) -> tuple[float, float, float] | None:
    return (error_m, error_m, VERTICAL_SHARE * error_m) if error_m is not None and 0 < error_m < math.inf else None


def _seconds(date_time: str, fraction: str) -> float | None:
    """Seconds of "2016:06:23 16:31:59" and the digits behind its point; None for anything else."""
    try:
        moment = datetime.strptime(date_time, "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC).timestamp()
    except ValueError:
        return None
    digits = fraction if fraction.isascii() and fraction.isdigit() else "0"
    return moment + float(f"0.{digits}")


def _log2_exposure(time_s: float | None, f_number: float | None, iso: float | None) -> float | None:
    if time_s is None or f_number is None or iso is None or min(time_s, f_number, iso) <= 0:
        return None
    return math.log2(time_s) + math.log2(iso) - 2 * math.log2(f_number)
