"""Photographs in a folder: which can be used, their size, camera and GPS; and one as an array.

`list_photographs` decodes every file once, at an eighth of its size, to be sure that it is whole;
`load_photograph` decodes one at the size asked for. EXIF orientation is ignored: pixels stay as
they are stored, as structure from motion needs them.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.io.colmap.records import is_image_name
from radiant_core.io.photos.copies import file_copies
from radiant_core.io.photos.jpeg import (
    TIFF_SIGNATURES,
    ExifFacts,
    has_tiff_alpha,
    read_exif,
    read_jpeg_facts,
    read_tiff_bits,
    read_tiff_size,
)
from radiant_core.io.run_store import open_without_waiting, read_bounded

SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
READ_KINDS = "JPEG, PNG or TIFF"
PHOTOGRAPHS_UNREAD = (
    *(".heic", ".heif", ".avif", ".webp", ".jp2", ".jxl", ".bmp", ".gif", ".insp", ".dng", ".cr2", ".cr3", ".nef", ".nrw", ".arw"),
    *(".orf", ".rw2", ".raf", ".pef", ".srw", ".raw", ".3fr", ".iiq", ".gpr"),
)
FILMS_UNREAD = (".mp4", ".mov", ".avi", ".mts", ".m2ts", ".m4v", ".mkv", ".webm", ".insv", ".360")
UNREAD_SUFFIXES = frozenset((*PHOTOGRAPHS_UNREAD, *FILMS_UNREAD))
"""Photographs and films that nothing here can read, or that COLMAP cannot."""
DECODED_BYTES_PER_PX = 6
"""What `load_photograph` holds at once per stored pixel: measured with JPEG of 50 megapixels."""
MAX_SIDE_RATIO = 100
"""Reduced to what structure from motion looks at, a narrower strip would have no pixels across."""
MAX_FILE_BYTES = 1 << 29
MAX_PIXELS = 1 << 28
JPEG_PIXELS_PER_BYTE, DEFLATE_RATIO = 512, 1032
"""A file that promises more is none: a JPEG spends a bit or more on every 64 pixels, and no zlib
stream packs better."""
EXIF_HEAD_BYTES = 1 << 18
"""Where EXIF is found: its segment holds at most 64 KiB and comes among the first."""
_SAVED = f"save photographs as {READ_KINDS}, and frames of films, to use them"
_PNG_SIGNATURE, _PNG_HEAD = b"\x89PNG\r\n\x1a\n", b"\0\0\0\rIHDR"


@dataclass(frozen=True, kw_only=True)
class CameraKey:
    """Photographs with equal keys share one set of intrinsics."""

    make: str
    model: str
    focal_mm: float | None
    size_wh: tuple[int, int]


@dataclass(frozen=True, kw_only=True)
class Photograph:
    """One usable photograph: its file name, path, size in pixels, GPS position and camera."""

    name: str
    path: Path
    size_wh: tuple[int, int]
    lat_lon_alt: tuple[float, float, float] | None
    """Degrees, degrees, metres; NaN metres where GPS has no altitude, None without GPS."""
    camera: CameraKey
    position_sigma_m: tuple[float, float, float] | None = None
    """Standard deviations east, north, up that the receiver gives; None where it gives none."""


@dataclass(frozen=True, kw_only=True)
class Skipped:
    """A file that looks like a photograph and cannot be used, with the reason."""

    name: str
    reason: str


@dataclass(frozen=True, kw_only=True)
class PhotoListing:
    """The photographs of a folder in the order of their names, and what was skipped."""

    photographs: tuple[Photograph, ...]
    skipped: tuple[Skipped, ...]
    copies: dict[str, str] = field(default_factory=dict)
    """Usable photographs that are left out as copies of another one, and of which."""

    unread: dict[str, int] = field(default_factory=dict)
    """Suffix → number of files beside them that hold photographs or films and cannot be read."""

    @property
    def left_out(self) -> set[str]:
        """Names of all that is not used."""
        return {skipped.name for skipped in self.skipped} | self.copies.keys()

    def without_odd_suffixes(self) -> PhotoListing:
        """The listing without photographs whose name does not say what they are: nothing can be
        written under such a name."""
        odd = [photo.name for photo in self.photographs if photo.path.suffix.lower() not in SUFFIXES]
        reason = f"has a name without {', '.join(SUFFIXES)}, under which it cannot be undistorted (rename it, in the model too)"
        skipped = tuple(Skipped(name=name, reason=reason) for name in odd)
        kept = tuple(photo for photo in self.photographs if photo.name not in odd)
        return replace(self, photographs=kept, skipped=(*self.skipped, *skipped))

    def without_copies(self) -> PhotoListing:
        """The listing without photographs that hold the same bytes as another one. Raises BadInput
        where fewer than two are left."""
        paths = {photo.name: photo.path for photo in self.photographs}
        copies = file_copies(paths)
        left = tuple(photo for photo in self.photographs if photo.name not in copies)
        if len(left) < 2:
            first = next(iter(copies.values()))
            raise BadInput(f"all {len(paths)} photographs are copies of {first}: at least 2 that overlap are needed.")
        return replace(self, photographs=left, copies=copies)


def list_photographs(folder: Path, on_photo: Callable[[int, int], None] | None = None, names: Sequence[str] | None = None) -> PhotoListing:
    """The usable photographs (JPEG, PNG, TIFF) directly in `folder`; others are skipped and named.

    `on_photo(done, total)` is called after each file; `names` asks for these files only, subfolders
    with '/' allowed. Raises BadInput when `folder` is missing, is no folder, or holds fewer than
    two usable photographs.
    """
    if not folder.is_dir():
        raise BadInput(f"the photograph folder {folder} does not exist: give the path of a folder with {READ_KINDS} files.")
    skipped: list[Skipped] = []
    unread: dict[str, int] = {}
    if names is None:
        names = sorted(path.name for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)
        skipped, unread = _subfolders(folder), unread_files(folder)
    names = [name for name in names if (folder / name).is_file()]
    if not names:
        raise _no_photographs(folder, unread)
    photographs: list[Photograph] = []
    for done, found in enumerate(_inspect_all(folder, names), start=1):
        if isinstance(found, Photograph):
            photographs.append(found)
        else:
            skipped.append(found)
        if on_photo is not None:
            on_photo(done, len(names))
    if len(photographs) < 2:
        lost = f" ({len(skipped)} skipped: {skipped[0].name} {skipped[0].reason})" if skipped else ""
        raise BadInput(f"{folder} has {len(photographs)} usable photograph(s){lost}: at least 2 that overlap are needed.")
    return PhotoListing(photographs=tuple(photographs), skipped=tuple(skipped), unread=unread)


def unread_warning(unread: Mapping[str, int]) -> tuple[str, ...]:
    """The warning about files that cannot be read, by their kinds; none where there are none."""
    if not unread:
        return ()
    return (f"{_list_kinds(unread)} files are not read: {_SAVED}.",)


def _no_photographs(folder: Path, unread: Mapping[str, int]) -> BadInput:
    """What is said of a folder without photographs that can be read, beside files that cannot."""
    inner = next((path.parent for path in sorted(folder.rglob("*")) if path.suffix.lower() in SUFFIXES and path.is_file()), None)
    where = _SAVED if unread else "give the folder that holds the image files"
    if inner is not None:
        where = f"there are some in {inner}: give that folder"
    other = f" but {_list_kinds(unread)} files, which cannot be read" if unread else ""
    return BadInput(f"{folder} itself contains no photographs ({', '.join(SUFFIXES)}){other}: {where}.")


def _list_kinds(unread: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {suffix}" for suffix, count in sorted(unread.items()))


def unread_files(folder: Path) -> dict[str, int]:
    """How many files of each kind in `folder` hold photographs or films that are not read."""
    return dict(Counter(path.suffix.lower() for path in folder.iterdir() if path.suffix.lower() in UNREAD_SUFFIXES and path.is_file()))


def photograph_positions(folder: Path, on_photo: Callable[[int, int], None] | None = None) -> dict[str, tuple[float, float, float] | None]:
    """GPS (degrees, degrees, metres or NaN) or None of the photographs in `folder`, by sorted name.

    Reads the head of each file only; `on_photo(done, total)` is called after each. Raises BadInput
    where there is no such folder or no photograph.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise BadInput(f"the photograph folder {folder} does not exist: give the path of a folder with {READ_KINDS} files.")
    names = sorted(path.name for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and path.is_file())
    if not names:
        raise _no_photographs(folder, unread_files(folder))
    positions = {}
    for done, name in enumerate(names, start=1):
        positions[name] = _facts(_read_head(folder / name))[2].lat_lon_alt
        if on_photo is not None:
            on_photo(done, len(names))
    return positions


def photograph_exposures(path: Path) -> tuple[float | None, float | None]:
    """When a photograph was taken, in seconds of its camera's clock, and its log₂ exposure, from
    its head; None where EXIF does not say."""
    exif = _facts(_read_head(path))[2]
    return exif.taken_s, exif.log2_exposure


def photograph_size_wh(path: Path) -> tuple[int, int] | None:
    """Size in px of a photograph, from its head; None where that does not say."""
    return _facts(_read_head(path))[0]


def _read_head(path: Path) -> bytes:
    """What holds the EXIF of a file: a TIFF has its directory wherever its writer put it, often at
    the end."""
    with open(path, "rb", opener=open_without_waiting) as file:
        return file.read(MAX_FILE_BYTES if path.suffix.lower() in SUFFIXES[3:] else EXIF_HEAD_BYTES)


def load_photograph(path: Path, size_wh: tuple[int, int]) -> NDArray[np.float32]:
    """The photograph (H,W,3) float32 RGB in 0..1, area-averaged to `size_wh` px; BadInput when it
    is not whole or cannot be decoded."""
    data = read_bounded(path, MAX_FILE_BYTES) if path.is_file() else b""
    image = decode_image(data, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise BadInput(f"the photograph {path} is not whole or cannot be decoded: remove it or fetch it again.")
    if (image.shape[1], image.shape[0]) != tuple(size_wh):
        image = cv2.resize(image, tuple(size_wh), interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(image[:, :, ::-1], dtype=np.float32) / np.float32(255)


def load_thumbnail(path: Path, long_side_px: int) -> NDArray[np.uint8]:
    """The photograph (H,W,3) uint8 RGB of at most `long_side_px`; raises as `load_photograph`. A
    JPEG is decoded at an eighth of its size where that is large enough."""
    data = read_bounded(path, MAX_FILE_BYTES) if path.is_file() else b""
    size_wh = read_size_wh(data) or (1, 1)
    reduced = cv2.IMREAD_REDUCED_COLOR_8 if max(size_wh) >= 16 * long_side_px else cv2.IMREAD_COLOR
    image = decode_image(data, reduced | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise BadInput(f"the photograph {path} is not whole or cannot be decoded: remove it or fetch it again.")
    scale = min(1.0, long_side_px / max(image.shape[:2]))
    reduced_wh = max(1, round(scale * image.shape[1])), max(1, round(scale * image.shape[0]))
    return np.asarray(cv2.resize(image, reduced_wh, interpolation=cv2.INTER_AREA)[:, :, ::-1], np.uint8)


def has_alpha(path: Path) -> bool:
    """Whether a PNG or TIFF has a channel that says how transparent each pixel is."""
    with open(path, "rb", opener=open_without_waiting) as file:
        head = file.read(26)
        if head.startswith(TIFF_SIGNATURES):
            return has_tiff_alpha(head + file.read(MAX_FILE_BYTES))
    return head.startswith(_PNG_SIGNATURE) and len(head) == 26 and head[25] in (4, 6)


def decode_image(data: bytes, flags: int) -> NDArray[Any] | None:
    """A JPEG, PNG or TIFF as `cv2.imdecode` gives it, or None; nothing is allocated for a file that
    cannot hold what it promises."""
    size_wh, whole, _ = _facts(data)
    if size_wh is None or not whole or _promises_too_much(size_wh, data):
        return None
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        return None


def read_size_wh(data: bytes) -> tuple[int, int] | None:
    """Size in px that the head of a JPEG, PNG or TIFF says; None for anything else."""
    return _facts(data)[0]


def _promises_too_much(size_wh: tuple[int, int], data: bytes) -> bool:
    per_byte = JPEG_PIXELS_PER_BYTE
    if data.startswith(_PNG_SIGNATURE):
        bits, channels = data[24], {2: 3, 4: 2, 6: 4}.get(data[25], 1)
        per_byte = DEFLATE_RATIO * 8 // max(1, bits * channels)
    elif data.startswith(TIFF_SIGNATURES):
        per_byte = DEFLATE_RATIO
    return size_wh[0] * size_wh[1] > min(MAX_PIXELS, per_byte * len(data))


def _subfolders(folder: Path) -> list[Skipped]:
    """The folders in `folder` that hold JPEG files; a camera starts one when the last is full."""
    inner_folders = [inner for inner in folder.iterdir() if inner.is_dir() and os.access(inner, os.R_OK | os.X_OK)]
    counts = {inner.name: sum(_is_jpeg(path) for path in inner.iterdir()) for inner in inner_folders}
    reason = "is a subfolder with {} photographs (move them beside the others to use them)"
    return [Skipped(name=f"{name}/", reason=reason.format(count)) for name, count in sorted(counts.items()) if count]


def _is_jpeg(path: Path) -> bool:
    return path.suffix.lower() in SUFFIXES[:2] and path.is_file()


def _inspect_all(folder: Path, names: list[str]) -> Iterator[Photograph | Skipped]:
    """What each file is, in order; decoding releases the interpreter lock, so threads help."""
    with ThreadPoolExecutor(max_workers=min(8, os.cpu_count() or 1)) as pool:
        yield from pool.map(lambda name: _inspect(folder / name, name), names)


def _inspect(path: Path, name: str) -> Photograph | Skipped:
    if not is_image_name(name):
        return Skipped(name=repr(name), reason="has characters in its name that COLMAP cannot keep (rename it)")
    if path.stat().st_size > MAX_FILE_BYTES:
        return Skipped(name=name, reason=f"is larger than {MAX_FILE_BYTES >> 20} MiB")
    try:
        data = read_bounded(path, MAX_FILE_BYTES)
    except StoreDamaged:
        return Skipped(name=name, reason="cannot be read")
    size_wh, whole, exif = _facts(data)
    if size_wh is None:
        return Skipped(name=name, reason="is not a JPEG, PNG or TIFF image")
    if size_wh[0] * size_wh[1] > MAX_PIXELS:
        return Skipped(name=name, reason=f"has {size_wh[0]} × {size_wh[1]} pixels, more than {MAX_PIXELS}")
    if not whole or _promises_too_much(size_wh, data):
        return Skipped(name=name, reason="is truncated (its end is missing)")
    if not _decodes(data, size_wh):
        return Skipped(name=name, reason="cannot be decoded")
    if _is_all_but_black(data):
        return Skipped(name=name, reason="has 16 bits a channel and uses 12 or fewer, which is black in 8 (stretch it to the full range)")
    if max(size_wh) > MAX_SIDE_RATIO * min(size_wh):
        return Skipped(name=name, reason=f"is a strip of {size_wh[0]} × {size_wh[1]} pixels")
    camera = CameraKey(make=exif.make, model=exif.model, focal_mm=exif.focal_mm, size_wh=size_wh)
    return Photograph(
        name=name,
        path=path,
        size_wh=size_wh,
        lat_lon_alt=exif.lat_lon_alt,
        camera=camera,
        position_sigma_m=exif.position_sigma_m,
    )


def _facts(data: bytes) -> tuple[tuple[int, int] | None, bool, ExifFacts]:
    """Size in px (None for other formats), whether the file has its end, and its EXIF."""
    if data.startswith(TIFF_SIGNATURES):
        # Where the pixels of a TIFF end its decoder alone finds out, which refuses one cut off.
        return read_tiff_size(data), True, read_exif(data)
    if data.startswith(_PNG_SIGNATURE):
        return _png_facts(data)
    facts = read_jpeg_facts(data)
    return facts.size_wh, facts.whole, facts.exif


def _png_facts(data: bytes) -> tuple[tuple[int, int] | None, bool, ExifFacts]:
    width, height = int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
    is_png = data[8:16] == _PNG_HEAD and width and height
    return (width, height) if is_png else None, _png_is_whole(data), ExifFacts()


def _png_is_whole(data: bytes) -> bool:
    """Whether every chunk of a PNG lies inside the file: OpenCV makes room for any length."""
    offset = len(_PNG_SIGNATURE)
    while offset + 12 <= len(data):
        end = offset + 12 + int.from_bytes(data[offset : offset + 4], "big")
        if data[offset + 4 : offset + 8] == b"IEND":
            return end <= len(data)
        offset = end
    return False


def _is_all_but_black(data: bytes) -> bool:
    """Whether an image of 16 bits holds values of 12 or fewer bits, which look black in 8 bits."""
    bits = data[24] if data.startswith(_PNG_SIGNATURE) else read_tiff_bits(data)
    if bits != 16:
        return False
    image = decode_image(data, cv2.IMREAD_REDUCED_GRAYSCALE_8 | cv2.IMREAD_IGNORE_ORIENTATION)
    return image is not None and int(image.max()) <= (1 << 12 - 8)


def _decodes(data: bytes, size_wh: tuple[int, int]) -> bool:
    """Whether the whole bit stream decodes to the promised shape (within rounding of 1/8 size)."""
    image = decode_image(data, cv2.IMREAD_REDUCED_GRAYSCALE_8 | cv2.IMREAD_IGNORE_ORIENTATION)
    return image is not None and all(abs(got * 8 - want) <= 8 for got, want in zip(image.shape[::-1], size_wh, strict=True))
