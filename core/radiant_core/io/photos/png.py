"""What a PNG says beside its pixels: EXIF and XMP. Once per photograph.

    eXIf                                EXIF, as PNG's third edition has it
    zTXt, tEXt "Raw profile type …"     EXIF, APP1 or XMP in hexadecimal digits, by ImageMagick
    iTXt "XML:com.adobe.xmp"            an XMP packet, which may be packed

Before or behind the pixels. Nothing packed grows beyond 1 MiB; never raises.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator
from typing import IO

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
MAX_TEXT_BYTES = 1 << 20
_PIXELS = b"IDAT"
_PROFILE = re.compile(rb"\s*[\w ]{1,20}\s+\d{1,9}\s+([0-9A-Fa-f\s]*)")
EXIF_SIGNATURE = b"Exif\0\0"
_XMP_SIGNATURE = b"http://ns.adobe.com/xap/1.0/\0"


def png_blocks(data: bytes) -> tuple[list[bytes], list[bytes]]:
    """The EXIF blocks and the XMP packets in the chunks of a PNG."""
    exif: list[bytes] = []
    xmp: list[bytes] = []
    for kind, content in _chunks(data):
        if kind == b"eXIf":
            exif.append(content.removeprefix(EXIF_SIGNATURE))
        elif kind in (b"zTXt", b"tEXt", b"iTXt"):
            keyword, written = _text_of(kind, content)
            if keyword == b"XML:com.adobe.xmp":
                xmp.append(written)
            elif keyword.lower() in (b"raw profile type exif", b"raw profile type app1", b"raw profile type xmp"):
                _sort_profile(_unhex(written), exif, xmp)
    return exif, xmp


def _sort_profile(profile: bytes, exif: list[bytes], xmp: list[bytes]) -> None:
    """A profile is what it begins with, whatever it is called."""
    if profile.startswith((EXIF_SIGNATURE, b"II", b"MM")):
        exif.append(profile.removeprefix(EXIF_SIGNATURE))
    elif profile:
        xmp.append(profile.removeprefix(_XMP_SIGNATURE))


def _text_of(kind: bytes, content: bytes) -> tuple[bytes, bytes]:
    """Keyword and text of a chunk, unpacked."""
    keyword, _, data = content.partition(b"\0")
    if kind == b"tEXt":
        return keyword, data[:MAX_TEXT_BYTES]
    if kind == b"zTXt":
        return keyword, _unpack(data[1:])
    packed, (_, _, data) = data[:1] == b"\1", data[2:].partition(b"\0")
    written = data.partition(b"\0")[2]
    return keyword, _unpack(written) if packed else written[:MAX_TEXT_BYTES]


def _unpack(packed: bytes) -> bytes:
    try:
        return zlib.decompressobj().decompress(packed, MAX_TEXT_BYTES)
    except zlib.error:
        return b""


def _unhex(written: bytes) -> bytes:
    match = _PROFILE.fullmatch(written)
    try:
        return bytes.fromhex(match[1].decode()) if match is not None else b""
    except ValueError:
        return b""


def _chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    offset = len(PNG_SIGNATURE)
    while offset + 12 <= len(data):
        end = offset + 12 + int.from_bytes(data[offset : offset + 4], "big")
        if end > len(data):
            return
        yield data[offset + 4 : offset + 8], data[offset + 8 : end - 4]
        offset = end


def read_without_pixels(file: IO[bytes], max_bytes: int) -> bytes:
    """A PNG without its pixels, of at most about `max_bytes`: EXIF may stand behind them."""
    parts = [file.read(len(PNG_SIGNATURE))]
    while len(head := file.read(8)) == 8:
        length = int.from_bytes(head[:4], "big")
        if head[4:] == _PIXELS or length > max_bytes:
            file.seek(length + 4, 1)
            continue
        parts += [head, file.read(length + 4)]
        max_bytes -= length
    return b"".join(parts)
