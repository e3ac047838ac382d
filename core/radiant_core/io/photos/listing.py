"""Photographs in a folder: which can be used, their size, camera and GPS; and one as an array.

`list_photographs` decodes every file once, at an eighth of its size, to be sure that it is whole;
`load_photograph` decodes one at the size asked for. EXIF orientation is ignored: pixels stay as
they are stored, as structure from motion needs them.
"""

from __future__ import annotations

import os
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
from radiant_core.io.photos.facts import file_facts, file_outline, read_exif_of
from radiant_core.io.photos.folders import (
    READ_KINDS,
    SAVED,
    SUFFIXES,
    FolderContent,
    folders_warning,
    list_kinds,
    read_folder,
)
from radiant_core.io.photos.jpeg import ExifFacts, has_tiff_alpha
from radiant_core.io.photos.png import PNG_SIGNATURE
from radiant_core.io.photos.samples import DARK_16, SampleKind, SampleRange, Stretch, choose_stretches, range_of, sample_kind, stretch_of
from radiant_core.io.photos.tiff import TIFF_SIGNATURES
from radiant_core.io.run_store import open_without_waiting, read_bounded

DECODED_BYTES_PER_PX = 6
"""What `load_photograph` holds at once per stored pixel: measured with JPEG of 50 megapixels."""
MAX_SIDE_RATIO = 100
"""Reduced to what structure from motion looks at, a narrower strip would have no pixels across."""
MAX_FILE_BYTES = 1 << 29
MAX_PIXELS = 1 << 28
JPEG_PIXELS_PER_BYTE, DEFLATE_RATIO = 512, 1032
"""A file that promises more is none: a JPEG spends a bit or more on every 64 pixels, and no zlib
stream packs better."""
MAX_NAMED = 3


@dataclass(frozen=True, kw_only=True)
class CameraKey:
    """Photographs with equal keys share one set of intrinsics."""

    make: str
    model: str
    focal_mm: float | None
    size_wh: tuple[int, int]
    focal_35mm: float | None = None
    digital_zoom: float = 1.0
    lens: str = ""
    serial: str = ""
    """Of the body and the lens: two drones of one model have two lenses."""
    taken_wh: tuple[int, int] | None = None
    """Size that the camera says it took, where the picture has another shape: it is cut from it."""
    folder: str = ""
    """Of photographs that say nothing of their camera: frames of one film lie in one folder."""


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
    position_doubt: str = ""
    """What stands in place of a position, or what is doubtful in one."""
    altitude_from_sea: bool = False
    """Whether it is said that the altitude counts from the sea."""
    samples: SampleRange | None = None
    """The values it uses, where they are not 8-bit numbers."""


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

    content: FolderContent = field(default_factory=FolderContent)
    """What else lies in their folder; empty where they were asked for by name."""
    stretches: tuple[Stretch, ...] = ()
    """How photographs of more than 8 bits are shown in 8."""

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
        photographs = tuple(photo for photo in self.photographs if photo.name not in odd)
        return replace(self, photographs=photographs, skipped=(*self.skipped, *skipped))

    def without_copies(self) -> PhotoListing:
        """The listing without photographs that hold the same bytes as another one. Raises BadInput
        where fewer than two are left."""
        paths = {photo.name: photo.path for photo in self.photographs}
        copies = file_copies(paths)
        photographs = tuple(photo for photo in self.photographs if photo.name not in copies)
        if len(photographs) < 2:
            first = next(iter(copies.values()))
            raise BadInput(f"all {len(paths)} photographs are copies of {first}: at least 2 that overlap are needed.")
        return replace(self, photographs=photographs, copies=copies)


def list_photographs(folder: Path, on_photo: Callable[[int, int], None] | None = None, names: Sequence[str] | None = None) -> PhotoListing:
    """The usable photographs (JPEG, PNG, TIFF) in `folder` and below; others are skipped and named.

    `on_photo(done, total)` is called after each file; `names` asks for these files only. Raises
    BadInput when `folder` is missing, is no folder, or holds fewer than two usable photographs.
    """
    content = FolderContent() if names is not None and folder.is_dir() else _read_folder(folder)
    names = [name for name in (content.names if names is None else names) if (folder / name).is_file()]
    if not names:
        raise _no_photographs(folder, content)
    photographs: list[Photograph] = []
    skipped: list[Skipped] = []
    for num_done, photo in enumerate(_inspect_all(folder, names), start=1):
        if isinstance(photo, Photograph):
            photographs.append(photo)
        else:
            skipped.append(photo)
        if on_photo is not None:
            on_photo(num_done, len(names))
    stretches = choose_stretches([photo.samples for photo in photographs if photo.samples is not None])
    dark = [photo.name for photo in photographs if _is_black(photo, stretches)]
    photographs = [photo for photo in photographs if photo.name not in dark]
    skipped += [Skipped(name=name, reason=_BLACK) for name in dark]
    if len(photographs) < 2:
        reasons = f" ({len(skipped)} skipped: {'; '.join(skipped_in_short(skipped))})" if skipped else ""
        raise BadInput(f"{folder} has {len(photographs)} usable photograph(s){reasons}: at least 2 that overlap are needed.")
    return PhotoListing(photographs=tuple(photographs), skipped=tuple(skipped), content=content, stretches=stretches)


_BLACK = "has 16 bits a channel and uses 12 or fewer, which is black in 8 (stretch it to the full range)"


def _is_black(photo: Photograph, stretches: tuple[Stretch, ...]) -> bool:
    """Whether 16 bits that are not stretched, since others use them all, are black in 8."""
    samples = photo.samples
    return samples is not None and samples.high <= DARK_16 and samples.kind.is_wide and stretch_of(samples, stretches) is None


def skipped_in_short(skipped: Sequence[Skipped]) -> tuple[str, ...]:
    """One clause for each reason: the first names, how many more, and the reason."""
    clauses = []
    for reason in dict.fromkeys(photo.reason for photo in skipped):
        names = [photo.name for photo in skipped if photo.reason == reason]
        more = (
            f" and {len(names) - MAX_NAMED} more, each of which" if len(names) > MAX_NAMED else ", each of which" if len(names) > 1 else ""
        )
        clauses.append(f"{', '.join(names[:MAX_NAMED])}{more} {reason}")
    return tuple(clauses)


def _read_folder(folder: Path) -> FolderContent:
    if not folder.is_dir():
        raise BadInput(f"the photograph folder {folder} does not exist: give the path of a folder with {READ_KINDS} files.")
    return read_folder(folder)


def _no_photographs(folder: Path, content: FolderContent) -> BadInput:
    """What is said of a folder without photographs that can be read, beside files that cannot."""
    where = SAVED if content.unread else "give the folder that holds the image files"
    unread_note = f" but {list_kinds(content.unread)} files, which cannot be read" if content.unread else ""
    closed = " ".join(("", *folders_warning(content)))
    return BadInput(f"{folder} contains no photographs ({', '.join(SUFFIXES)}){unread_note}: {where}.{closed}")


def photograph_positions(folder: Path) -> dict[str, tuple[float, float, float] | None]:
    """GPS (degrees, degrees, metres or NaN) or None of the photographs in `folder`, by sorted name;
    raises as `photograph_heads`."""
    return {name: exif.lat_lon_alt for name, exif in photograph_heads(folder).items()}


def photograph_heads(folder: Path, on_photo: Callable[[int, int], None] | None = None) -> dict[str, ExifFacts]:
    """What EXIF and XMP of the photographs in `folder` and below say, by sorted name.

    Reads the head of each file only; `on_photo(done, total)` is called after each. Raises BadInput
    where there is no such folder or no photograph.
    """
    folder = Path(folder)
    content = _read_folder(folder)
    if not content.names:
        raise _no_photographs(folder, content)
    heads = {}
    for num_done, name in enumerate(content.names, start=1):
        heads[name] = read_exif_of(folder / name, MAX_FILE_BYTES)
        if on_photo is not None:
            on_photo(num_done, len(content.names))
    return heads


def doubts_warning(doubts: Mapping[str, str], num_photographs: int, *, named: bool = True) -> tuple[str, ...]:
    """What is said of positions (photograph → its doubt) that are not used, or not sure; one
    sentence for each kind."""
    sentences = []
    for doubt in sorted({doubt for doubt in doubts.values() if doubt}):
        names = [name for name, found_doubt in doubts.items() if found_doubt == doubt]
        listed = f": {', '.join(names[:MAX_NAMED])}{' …' if len(names) > MAX_NAMED else ''}" if named else ""
        sentences.append(f"{len(names)} of {num_photographs} photographs have {doubt}{_consequence(doubt)}{listed}.")
    return tuple(sentences)


def sea_warning(are_from_sea: Sequence[bool]) -> tuple[str, ...]:
    """What is said where altitudes of photographs are known to count from the sea; a scene takes
    all heights for those over the ellipsoid."""
    if not any(are_from_sea):
        return ()
    return (
        f"{sum(are_from_sea)} of {len(are_from_sea)} photographs have GPS altitudes that count from the sea (GPSAltitudeRef 2 or 3), up to "
        "107 m from those of the ellipsoid, which they are taken for: name no vertical datum in --crs.",
    )


def _consequence(doubt: str) -> str:
    if doubt.startswith("EXIF and XMP"):
        return ", of which that of EXIF is used"
    if doubt.startswith("GPS in the datum"):
        return ", which is taken for WGS 84 and may be off by hundreds of metres"
    return ", which is no position and not used"


def photograph_exposures(path: Path) -> tuple[float | None, float | None]:
    """When a photograph was taken, in seconds of its camera's clock, and its log₂ exposure, from
    its head; None where EXIF does not say."""
    exif = read_exif_of(path, MAX_FILE_BYTES)
    return exif.taken_s, exif.log2_exposure


def photograph_size_wh(path: Path) -> tuple[int, int] | None:
    """Size in px of a photograph, decoding nothing; None where the file does not say."""
    return read_size_wh(read_bounded(path, MAX_FILE_BYTES))


def load_photograph(path: Path, size_wh: tuple[int, int]) -> NDArray[np.float32]:
    """The photograph (H,W,3) float32 RGB in 0..1, otherwise as `load_photograph_bytes`."""
    return load_photograph_bytes(path, size_wh).astype(np.float32) / np.float32(255)


def load_photograph_bytes(path: Path, size_wh: tuple[int, int]) -> NDArray[np.uint8]:
    """The photograph (H,W,3) uint8 RGB, area-averaged to `size_wh` px; BadInput when it is not
    whole or cannot be decoded."""
    data = read_bounded(path, MAX_FILE_BYTES) if path.is_file() else b""
    image = decode_image(data, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise BadInput(f"the photograph {path} is not whole or cannot be decoded: remove it or fetch it again.")
    if (image.shape[1], image.shape[0]) != tuple(size_wh):
        image = cv2.resize(image, tuple(size_wh), interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(image[:, :, ::-1], np.uint8)


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
    return head.startswith(PNG_SIGNATURE) and len(head) == 26 and head[25] in (4, 6)


def decode_image(data: bytes, flags: int) -> NDArray[Any] | None:
    """A JPEG, PNG or TIFF as `cv2.imdecode` gives it, or None; nothing is allocated for a file that
    cannot hold what it promises."""
    size_wh, whole = file_outline(data)
    if size_wh is None or not whole or _promises_too_much(size_wh, data):
        return None
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        return None


def read_size_wh(data: bytes) -> tuple[int, int] | None:
    """Size in px that the head of a JPEG, PNG or TIFF says; None for anything else."""
    return file_outline(data)[0]


def _promises_too_much(size_wh: tuple[int, int], data: bytes) -> bool:
    per_byte = JPEG_PIXELS_PER_BYTE
    if data.startswith(PNG_SIGNATURE):
        bits, channels = data[24], {2: 3, 4: 2, 6: 4}.get(data[25], 1)
        per_byte = DEFLATE_RATIO * 8 // max(1, bits * channels)
    elif data.startswith(TIFF_SIGNATURES):
        per_byte = DEFLATE_RATIO
    return size_wh[0] * size_wh[1] > min(MAX_PIXELS, per_byte * len(data))


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
    if not data:
        return Skipped(name=name, reason="is an empty file (0 bytes)")
    size_wh, whole, exif = file_facts(data)
    if size_wh is None:
        return Skipped(name=name, reason="is not a JPEG, PNG or TIFF image")
    if size_wh[0] * size_wh[1] > MAX_PIXELS:
        return Skipped(name=name, reason=f"has {size_wh[0]} × {size_wh[1]} pixels, more than {MAX_PIXELS}")
    if not whole or _promises_too_much(size_wh, data):
        return Skipped(name=name, reason="is truncated (its end is missing)")
    kind = sample_kind(data)
    if kind.is_plain and not _decodes(data, size_wh):
        return Skipped(name=name, reason=_undecoded(kind))
    samples = None
    if not kind.is_plain:
        samples = _samples(data, size_wh, kind)
        if samples is None:
            return Skipped(name=name, reason=_undecoded(kind))
    if max(size_wh) > MAX_SIDE_RATIO * min(size_wh):
        return Skipped(name=name, reason=f"is a strip of {size_wh[0]} × {size_wh[1]} pixels")
    return Photograph(
        name=name,
        path=path,
        size_wh=size_wh,
        lat_lon_alt=exif.lat_lon_alt,
        camera=_camera_of(exif, name, size_wh),
        position_sigma_m=exif.position_sigma_m,
        position_doubt=exif.position_doubt,
        altitude_from_sea=exif.altitude_from_sea,
        samples=samples,
    )


def _undecoded(kind: SampleKind) -> str:
    if kind.is_usual:
        return "cannot be decoded"
    return f"holds {kind}, which cannot be decoded (save it with 1 or 3 bands of 8 or 16 bits)"


def _camera_of(exif: ExifFacts, name: str, size_wh: tuple[int, int]) -> CameraKey:
    says_nothing = not (exif.make or exif.model or exif.lens or exif.serial or exif.focal_mm or exif.focal_35mm)
    return CameraKey(
        make=exif.make,
        model=exif.model,
        focal_mm=exif.focal_mm,
        size_wh=size_wh,
        focal_35mm=exif.focal_35mm,
        digital_zoom=exif.digital_zoom,
        lens=exif.lens,
        serial=exif.serial,
        taken_wh=exif.taken_wh if exif.taken_wh is not None and _is_cut(size_wh, exif.taken_wh) else None,
        folder=name.rpartition("/")[0] if says_nothing else "",
    )


def _is_cut(size_wh: tuple[int, int], taken_wh: tuple[int, int]) -> bool:
    """Whether a picture is a part of what was taken: no larger, and of another shape, however it
    was turned."""
    (short, long), (taken_short, taken_long) = sorted(size_wh), sorted(taken_wh)
    return long <= taken_long and short <= taken_short and abs(long * taken_short - short * taken_long) > 0.01 * long * taken_short


def _samples(data: bytes, size_wh: tuple[int, int], kind: SampleKind) -> SampleRange | None:
    """The values that a picture of unusual samples uses; None where it cannot be decoded whole."""
    pixels = decode_image(data, cv2.IMREAD_UNCHANGED)
    return None if pixels is None or pixels.shape[1::-1] != size_wh else range_of(kind, pixels)


def _decodes(data: bytes, size_wh: tuple[int, int]) -> bool:
    """Whether the whole bit stream decodes to the promised shape (within rounding of 1/8 size)."""
    image = decode_image(data, cv2.IMREAD_REDUCED_GRAYSCALE_8 | cv2.IMREAD_IGNORE_ORIENTATION)
    return image is not None and all(abs(got * 8 - want) <= 8 for got, want in zip(image.shape[::-1], size_wh, strict=True))
