"""What a JPEG says before its pixels: size, camera, focal length, GPS, whether it is whole.

Walks the marker segments once per photograph, a few kilobytes each; no pixel is decoded. A damaged
EXIF block only loses its own facts. Layout: ITU-T T.81 annex B (markers), TIFF 6.0 section 2
(directories), CIPA DC-008 (EXIF and GPS tags).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np

from radiant_core.io.photos.xmp import VERTICAL_SHARE, xmp_sigma_m
from radiant_core.numerics import FloatArray

_START_OF_FRAME = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_START_OF_SCAN, _END_OF_IMAGE, _APP1, _APP2 = 0xDA, 0xD9, 0xE1, 0xE2
_EXIF_SIGNATURE = b"Exif\0\0"
_KEPT_SIGNATURES = {_APP1: (_EXIF_SIGNATURE, b"http://ns.adobe.com/xap/1.0/\0"), _APP2: (b"ICC_PROFILE\0",)}
"""EXIF, XMP and colour profiles say the same of pixels that were moved; other segments may not."""
_TYPE_BYTES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 7: 1, 9: 4, 10: 8}

_ORDERS = {b"II*\0": "<", b"MM\0*": ">"}
TIFF_SIGNATURES = tuple(_ORDERS)
IMAGE_WIDTH, IMAGE_HEIGHT = 0x0100, 0x0101
BITS_PER_SAMPLE, PHOTOMETRIC, SAMPLES_PER_PIXEL, EXTRA_SAMPLES = 0x0102, 0x0106, 0x0115, 0x0152
_RGB, _UNSPECIFIED = 2, 0
MAKE, MODEL, EXIF_POINTER, GPS_POINTER = 0x010F, 0x0110, 0x8769, 0x8825
FOCAL_LENGTH = 0x920A
EXPOSURE_TIME, F_NUMBER, ISO_SPEED, TAKEN, TAKEN_FRACTION = 0x829A, 0x829D, 0x8827, 0x9003, 0x9291
MAX_VALUE_BYTES = 1024
"""Of one tag: none that is read here needs more, and a directory may name thousands of 64 KiB, all
of the same bytes."""
GPS_ERROR = 0x1F
_XMP = b"http://ns.adobe.com/xap/1.0/\0"
LATITUDE_REF, LATITUDE, LONGITUDE_REF, LONGITUDE, ALTITUDE_REF, ALTITUDE = range(1, 7)


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


@dataclass(frozen=True, kw_only=True)
class JpegFacts:
    """What a JPEG's markers say; size_wh None: no frame header, whole False: the end is missing."""

    size_wh: tuple[int, int] | None
    whole: bool
    exif: ExifFacts


def read_jpeg_facts(data: bytes) -> JpegFacts:
    """Size, wholeness and EXIF of the JPEG `data`; never raises, whatever the bytes are."""
    size_wh, exif, scan_offset = None, None, None
    sigma_m: tuple[float, float, float] | None = None
    for marker, start, end in _segments(data):
        if marker in _START_OF_FRAME and end - start >= 5:
            height, width = struct.unpack_from(">HH", data, start + 1)
            size_wh = (width, height) if width and height else None
        elif marker == _APP1 and exif is None and data[start : start + 6] == _EXIF_SIGNATURE:
            exif = read_exif(data[start + 6 : end])
        elif marker == _APP1 and data.startswith(_XMP, start):
            sigma_m = xmp_sigma_m(data[start + len(_XMP) : end]) or sigma_m
        elif marker == _START_OF_SCAN:
            scan_offset = end
    # In a scan 0xFF is followed by 0x00 or a restart marker, so FF D9 behind it is the real end.
    whole = scan_offset is not None and data.rfind(b"\xff\xd9", scan_offset) >= 0
    exif = exif or ExifFacts()
    return JpegFacts(size_wh=size_wh, whole=whole, exif=exif if sigma_m is None else replace(exif, position_sigma_m=sigma_m))


def kept_segments(data: bytes) -> bytes:
    """EXIF, XMP and colour profile of the JPEG `data` for one made from it; never raises."""
    kept = [data[start - 4 : end] for marker, start, end in _segments(data) if data[start:end].startswith(_KEPT_SIGNATURES.get(marker, ()))]
    return b"".join(kept)


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
    main = _first_directory(tiff)
    width, height = (_number(main.get(tag)) for tag in (IMAGE_WIDTH, IMAGE_HEIGHT))
    return (int(width), int(height)) if width and height and width >= 1 and height >= 1 else None


def read_tiff_bits(tiff: bytes) -> int:
    """Bits per channel of the first picture in a TIFF, 1 where it does not say; never raises."""
    return int(_number(_first_directory(tiff).get(BITS_PER_SAMPLE)) or 1)


def has_tiff_alpha(tiff: bytes) -> bool:
    """Whether the first picture in a TIFF is RGB with an alpha channel; a fourth channel that is
    said to be something else is none."""
    main = _first_directory(tiff)
    is_rgb_and_one = _number(main.get(PHOTOMETRIC)) == _RGB and _number(main.get(SAMPLES_PER_PIXEL)) == 4
    # Many write RGBA without a word on what the fourth is.
    return is_rgb_and_one and _number(main.get(EXTRA_SAMPLES)) != _UNSPECIFIED


def _first_directory(tiff: bytes) -> dict[int, Value]:
    order = _ORDERS.get(tiff[:4])
    if order is None or len(tiff) < 8:
        return {}
    return _directory(tiff, order, struct.unpack_from(order + "I", tiff, 4)[0])


def read_exif(tiff: bytes) -> ExifFacts:
    """The facts in an EXIF block (a TIFF header and its directories); never raises."""
    order = _ORDERS.get(tiff[:4])
    if order is None or len(tiff) < 8:
        return ExifFacts()
    main = _directory(tiff, order, struct.unpack_from(order + "I", tiff, 4)[0])
    details = _directory(tiff, order, _number(main.get(EXIF_POINTER)))
    focal_mm = _number(details.get(FOCAL_LENGTH))
    gps = _directory(tiff, order, _number(main.get(GPS_POINTER)))
    return ExifFacts(
        make=_text(main.get(MAKE)),
        model=_text(main.get(MODEL)),
        focal_mm=focal_mm if focal_mm is not None and focal_mm > 0 else None,
        lat_lon_alt=_position(gps),
        position_sigma_m=_sigma_of(_number(gps.get(GPS_ERROR))),
        taken_s=_seconds(_text(details.get(TAKEN)), _text(details.get(TAKEN_FRACTION))),
        log2_exposure=_log2_exposure(*(_number(details.get(tag)) for tag in (EXPOSURE_TIME, F_NUMBER, ISO_SPEED))),
    )


def _sigma_of(error_m: float | None) -> tuple[float, float, float] | None:
    return (error_m, error_m, VERTICAL_SHARE * error_m) if error_m is not None and 0 < error_m < math.inf else None


def _seconds(taken: str, fraction: str) -> float | None:
    """Seconds of "2016:06:23 16:31:59" and the digits behind its point; None for anything else."""
    try:
        moment = datetime.strptime(taken, "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC).timestamp()
    except ValueError:
        return None
    digits = fraction if fraction.isascii() and fraction.isdigit() else "0"
    return moment + float(f"0.{digits}")


def _log2_exposure(time_s: float | None, f_number: float | None, iso: float | None) -> float | None:
    if time_s is None or f_number is None or iso is None or min(time_s, f_number, iso) <= 0:
        return None
    return math.log2(time_s) + math.log2(iso) - 2 * math.log2(f_number)


Value = bytes | FloatArray
"""A tag's value: bytes of text or undefined types, else its numbers as float64."""


def _directory(tiff: bytes, order: str, offset: float | None) -> dict[int, Value]:
    """Tag → value of the directory at `offset`, entries that point outside left out; empty when
    there is none or it does not fit."""
    if offset is None or not 8 <= offset <= len(tiff) - 2:
        return {}
    offset = int(offset)
    count = struct.unpack_from(order + "H", tiff, offset)[0]
    if offset + 2 + 12 * count > len(tiff):
        return {}
    values = {}
    for entry in range(offset + 2, offset + 2 + 12 * count, 12):
        tag, kind, length = struct.unpack_from(order + "HHI", tiff, entry)
        num_bytes = _TYPE_BYTES.get(kind, 0) * length
        start = entry + 8 if num_bytes <= 4 else struct.unpack_from(order + "I", tiff, entry + 8)[0]
        if 0 < num_bytes <= MAX_VALUE_BYTES and start + num_bytes <= len(tiff):
            values[tag] = _value(tiff[start : start + num_bytes], order, kind)
    return values


def _value(raw: bytes, order: str, kind: int) -> Value:
    if kind in (1, 2, 7):
        return raw
    numbers = np.frombuffer(raw, dtype=order + {3: "u2", 4: "u4", 5: "u4", 9: "i4", 10: "i4"}[kind]).astype(np.float64)
    if kind in (3, 4, 9):
        return numbers
    nominators, denominators = numbers[0::2], numbers[1::2]
    return np.divide(nominators, denominators, out=np.full(len(nominators), np.nan), where=denominators != 0)


def _number(value: Value | None) -> float | None:
    if value is None or isinstance(value, bytes) or not math.isfinite(value[0]):
        return None
    return float(value[0])


def _text(value: Value | None) -> str:
    return value.split(b"\0")[0].decode("ascii", "replace").strip() if isinstance(value, bytes) else ""


def _position(gps: dict[int, Value]) -> tuple[float, float, float] | None:
    lat = _degrees(gps.get(LATITUDE), gps.get(LATITUDE_REF), b"NS")
    lon = _degrees(gps.get(LONGITUDE), gps.get(LONGITUDE_REF), b"EW")
    if lat is None or lon is None or abs(lat) > 90 or abs(lon) > 180:
        return None
    # Receivers without a fix write exact zeros.
    if lat == 0 and lon == 0:
        return None
    alt, below_sea = _number(gps.get(ALTITUDE)), gps.get(ALTITUDE_REF)
    if alt is None:
        return lat, lon, math.nan
    return lat, lon, -alt if isinstance(below_sea, bytes) and below_sea[:1] == b"\x01" else alt


def _degrees(value: Value | None, reference: Value | None, letters: bytes) -> float | None:
    """Degrees of a (degrees, minutes, seconds) triple with its letter; None when unusable."""
    letter = reference[:1] if isinstance(reference, bytes) else b""
    if value is None or isinstance(value, bytes) or len(value) != 3 or not letter or letter not in letters:
        return None
    degrees = float(value @ (1, 1 / 60, 1 / 3600))
    if not math.isfinite(degrees):
        return None
    return -degrees if letter == letters[1:] else degrees
