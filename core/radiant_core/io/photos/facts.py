"""What a JPEG, PNG or TIFF says before its pixels, whichever of them it is. Once per photograph."""

from __future__ import annotations

from pathlib import Path

from radiant_core.io.photos.jpeg import ExifFacts, join_facts, read_jpeg_facts, read_jpeg_outline, read_tiff_facts, read_tiff_size
from radiant_core.io.photos.png import PNG_SIGNATURE, png_blocks, read_without_pixels
from radiant_core.io.photos.tiff import TIFF_SIGNATURES
from radiant_core.io.run_store import open_without_waiting

HEAD_BYTES = 1 << 18
"""Where a JPEG has its EXIF: a segment holds at most 64 KiB and comes among the first."""
_JPEG, _PNG_HEAD = b"\xff\xd8", b"\0\0\0\rIHDR"


def file_facts(data: bytes) -> tuple[tuple[int, int] | None, bool, ExifFacts]:
    """Size in px (None for other formats), whether the file has its end, and its EXIF."""
    if data.startswith(TIFF_SIGNATURES):
        # Where the pixels of a TIFF end its decoder alone finds out, which refuses one cut off.
        return read_tiff_size(data), True, read_tiff_facts(data)
    if data.startswith(PNG_SIGNATURE):
        return _png_size(data), _png_is_whole(data), join_facts(*png_blocks(data))
    facts = read_jpeg_facts(data)
    return facts.size_wh, facts.whole, facts.exif


def file_outline(data: bytes) -> tuple[tuple[int, int] | None, bool]:
    """Size and end as in `file_facts`, without its EXIF, which takes longer than all else."""
    if data.startswith(TIFF_SIGNATURES):
        return read_tiff_size(data), True
    return (_png_size(data), _png_is_whole(data)) if data.startswith(PNG_SIGNATURE) else read_jpeg_outline(data)


def read_exif_of(path: Path, max_bytes: int) -> ExifFacts:
    """EXIF and XMP of a file without reading its pixels where the format tells where they are."""
    with open(path, "rb", opener=open_without_waiting) as file:
        head = file.read(HEAD_BYTES)
        file.seek(0)
        if head.startswith(PNG_SIGNATURE):
            return file_facts(read_without_pixels(file, max_bytes))[2]
        if head.startswith(TIFF_SIGNATURES):
            # A TIFF has its directory wherever its writer put it, often at the end.
            return file_facts(file.read(max_bytes))[2]
        facts = read_jpeg_facts(head)
        if head.startswith(_JPEG) and not facts.has_scan and len(head) == HEAD_BYTES:
            # Thermal pictures may have megabytes of segments before their pixels.
            facts = read_jpeg_facts(file.read(max_bytes))
        return facts.exif


def _png_size(data: bytes) -> tuple[int, int] | None:
    width, height = int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
    return (width, height) if data[8:16] == _PNG_HEAD and width and height else None


def _png_is_whole(data: bytes) -> bool:
    """Whether every chunk of a PNG lies inside the file; only then OpenCV decodes it."""
    offset = len(PNG_SIGNATURE)
    while offset + 12 <= len(data):
        end = offset + 12 + int.from_bytes(data[offset : offset + 4], "big")
        if data[offset + 4 : offset + 8] == b"IEND":
            return end <= len(data)
        offset = end
    return False
