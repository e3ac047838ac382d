"""Canaries: what is known of a device's photographs and poses, as bytes that can be looked for in
what everybody else holds or is sent.

    watermark(photograph)                  noise in its pixels, a text in every segment that can carry one
    canaries = canaries_of(...)            patterns by kind, each in the ways it could be written
    Search(canaries).kinds_in(content)     kinds that stand in some bytes, packed or not
    files_with(canaries, places)           the same for all files of some folders

A file is looked through as it is, and as what it may pack: UTF-16, base64, hexadecimal, zlib and
gzip streams, the pixels of JPEG and PNG, numbers with one blank between them. Poses are looked for
as numbers too, to a millimetre.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import re
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from radiant_core.cameras import Cameras
from radiant_core.io.photos.listing import load_photograph, photograph_positions

TEXT = b"%s canary of %s"
"""What `watermark` writes: where, and into which photograph."""
SEGMENTS = {
    # A little TIFF with one entry, ImageDescription, whose text follows.
    "EXIF text": (0xE1, b"Exif\0\0II*\0\x08\0\0\0\1\0\x0e\1\2\0\x28\0\0\0\x1a\0\0\0\0\0\0\0"),
    "XMP": (0xE1, b"http://ns.adobe.com/xap/1.0/\0"),
    "IPTC": (0xED, b"Photoshop 3.0\0"),
    "comment": (0xFE, b""),
}
NUM_ROWS, STRETCH_PX, BLOCK_PX = 6, 12, 24
"""Rows of a photograph that are looked for, and how many pixels of each; the side of a block of noise."""
LEAST_BYTES = 8
"""Shorter patterns may stand anywhere."""
NEAR_M = 1e-3
TEXT_FORMS = ("%.3f", "%.4f", "%.5f", "%.6f", "%.9f")
MAX_UNPACKED_BYTES = 1 << 26
POSE_KINDS = ("pose float32", "pose float64", "pose float16", "pose quaternion", "pose text")
PHOTOGRAPH_KINDS = ("name", "digest", "EXIF", *SEGMENTS, "GPS", "pixels", "JPEG")


@dataclass(frozen=True, kw_only=True)
class Canaries:
    """Bytes that belong to one device, by what they are of. An edge may hold its devices' poses; everything else stays."""

    patterns: dict[str, list[bytes]]
    centers_m: NDArray[np.float64]
    """Where its photographs were taken (C,3)."""

    def of(self, kinds: Iterable[str]) -> Canaries:
        """Those of some kinds alone; centres with the poses."""
        kinds = tuple(kinds)
        centers_m = self.centers_m if set(POSE_KINDS) & set(kinds) else np.zeros((0, 3))
        return Canaries(patterns={kind: self.patterns[kind] for kind in kinds}, centers_m=centers_m)


def watermark(photograph: Path, seed: int = 0) -> None:
    """Put a block of noise into the corner of a JPEG and a text into each of its segments; its EXIF with GPS stays as it is."""
    data = photograph.read_bytes()
    pixels = np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION))
    noise = np.random.default_rng([seed, *photograph.name.encode()]).integers(0, 256, (BLOCK_PX // 4, BLOCK_PX // 4, 3), np.uint8)
    pixels[:BLOCK_PX, :BLOCK_PX] = noise.repeat(4, axis=0).repeat(4, axis=1)
    encoded, jpeg = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 95])
    assert encoded
    kept = b"".join(data[start:end] for start, end in _application_segments(data))
    marked = b"".join(_segment(code, head + _text(kind, photograph)) for kind, (code, head) in SEGMENTS.items())
    photograph.write_bytes(b"\xff\xd8" + kept + marked + jpeg.tobytes()[2:])


def add_broken(folder: Path) -> list[Path]:
    """Put files beside the photographs of a device that are skipped, find no pose or add nothing; their names are canaries too."""
    first = min(folder.glob("*.jpg"))
    data = first.read_bytes()
    kept = b"".join(data[start:end] for start, end in _application_segments(data))
    pixels = np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION))
    noise = np.random.default_rng(0).integers(0, 256, pixels.shape, np.uint8)
    foreign, blurred = (cv2.imencode(".jpg", image)[1].tobytes() for image in (noise, cv2.GaussianBlur(pixels, (0, 0), 9)))
    content = {"truncated": data[: len(data) // 2], "empty": b"", "foreign": foreign, "copied": data}
    content |= {"blurred": blurred[:2] + kept + blurred[2:], "of no camera": b"no photograph"}
    made = [folder / f"zz secret {what} [{folder.name}].jpg" for what in content]
    for path, written in zip(made, content.values(), strict=True):
        path.write_bytes(written)
    inner = folder / f"secret subfolder [{folder.name}]"
    inner.mkdir()
    (inner / f"secret inner [{folder.name}].jpg").write_bytes(data)
    return [*made, inner]


def _text(kind: str, photograph: Path) -> bytes:
    return TEXT % (kind.encode(), photograph.name.encode())


def _segment(code: int, content: bytes) -> bytes:
    return bytes([0xFF, code]) + struct.pack(">H", len(content) + 2) + content


def _application_segments(data: bytes) -> Iterator[tuple[int, int]]:
    """Where the segments APP0 and APP1 at the head of a JPEG start and end."""
    start = 2
    while data[start : start + 2] in (b"\xff\xe0", b"\xff\xe1"):
        end = start + 2 + struct.unpack(">H", data[start + 2 : start + 4])[0]
        yield start, end
        start = end


def canaries_of(photographs: Path, poses: Cameras, size_px: int, broken: Iterable[str] = ()) -> Canaries:
    """What to look for of the device with these watermarked photographs and poses; pixels at two
    sizes, one given by its long side.

    Of `broken` files only the names are looked for.
    """
    found: dict[str, list[bytes]] = {kind: [] for kind in PHOTOGRAPH_KINDS}
    found["name"] = [path.stem.encode() for path in photographs.rglob("*")]
    for name, place in photograph_positions(photographs).items():
        if name in broken:
            continue
        data = (photographs / name).read_bytes()
        exif = data.find(b"Exif\0\0")
        assert exif > 0 and place is not None, "the sample photographs have EXIF with GPS"
        # From the GPS directory on: what stands before is the same in photographs of other devices.
        length = struct.unpack(">H", data[exif - 2 : exif])[0]
        found["EXIF"] += [data[start : start + 24] for start in range(exif + length - 80, exif + length - 32, 8)]
        found["digest"] += [hashlib.sha256(data).digest(), hashlib.sha256(data).hexdigest().encode()]
        for kind in SEGMENTS:
            found[kind].append(_text(kind, photographs / name))
        found["GPS"] += _place_patterns(place)
        found["pixels"] += _pixel_patterns(photographs / name, size_px)
        found["JPEG"] += [data[start : start + 32] for start in np.linspace(len(data) // 2, len(data) - 40, 6).astype(int)]
    patterns = {**found, **_pose_patterns(poses)}
    return Canaries(patterns={kind: _distinct(given) for kind, given in patterns.items()}, centers_m=poses.centers)


def _distinct(patterns: Iterable[bytes]) -> list[bytes]:
    """Without those that may stand anywhere: short ones, and of one byte only."""
    return sorted({pattern for pattern in patterns if len(pattern) >= LEAST_BYTES and len(set(pattern)) > 4})


def _place_patterns(place: tuple[float, float, float]) -> list[bytes]:
    """A position as doubles, as text with seven digits and more behind the point, as text of a pair with fewer."""
    lat_lon = place[:2]
    assert all(len(repr(degrees)) > 9 for degrees in lat_lon), "a round number may stand anywhere"
    found = [text.encode() for degrees in lat_lon for text in (repr(degrees), f"{degrees:.7f}")]
    found += [struct.pack(order, degrees) for degrees in lat_lon for order in ("<d", ">d")]
    found += [struct.pack(order, *pair) for pair in (lat_lon, lat_lon[::-1]) for order in ("<2f", ">2f")]
    return [*found, *(" ".join(f"{degrees:.{digits}f}" for degrees in lat_lon).encode() for digits in (5, 6))]


def _pixel_patterns(photograph: Path, size_px: int) -> list[bytes]:
    """Stretches of rows as bytes in both orders of the channels, one channel alone, and as floats."""
    image = np.asarray(cv2.imread(str(photograph), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION))
    height, width = image.shape[:2]
    scale = size_px / max(height, width)
    found = []
    for size_wh in {(width, height), (round(scale * width), round(scale * height))}:
        pixels = (load_photograph(photograph, size_wh) * 255).round().astype(np.uint8)
        for row in np.linspace(0, len(pixels) - 1, NUM_ROWS).astype(int):
            stretch = np.ascontiguousarray(pixels[row, :STRETCH_PX])
            if stretch.std() > 4:  # what is all one colour may stand anywhere
                channels = np.ascontiguousarray(pixels[row, : 2 * STRETCH_PX].T)
                found += [stretch.tobytes(), stretch[:, ::-1].tobytes(), *(channel.tobytes() for channel in channels)]
                found.append((stretch.astype(np.float32) / np.float32(255)).tobytes())
    return found


def _pose_patterns(poses: Cameras) -> dict[str, list[bytes]]:
    """Rows and columns of both matrices, centres, quaternions and translations, as numbers of three sizes and as text."""
    cam_from_world, centers = poses.cam_from_world[:, :3], poses.centers
    world_from_cam = np.concatenate([cam_from_world[:, :, :3].transpose(0, 2, 1), centers[:, :, None]], axis=2)
    matrices = np.concatenate([cam_from_world, world_from_cam])
    rows = [*matrices.reshape(-1, 4), *centers]
    # A column of three halves is too short to be anybody's.
    written = [*rows, *matrices.transpose(0, 2, 1).reshape(-1, 3)]
    rows = [row for row in rows if np.count_nonzero(row != row.round()) >= 2]
    written = [row for row in written if np.count_nonzero(row != row.round()) >= 2]
    wxyz = np.concatenate([Rotation.from_matrix(matrix[:, :3]).as_quat()[None, [3, 0, 1, 2]] for matrix in matrices])
    turns = [sign * quat[order] for quat in wxyz for order in ([0, 1, 2, 3], [1, 2, 3, 0]) for sign in (1, -1)]
    numbers = [*cam_from_world[:, :, 3].ravel(), *centers.ravel()]
    triples = [" ".join(form % value for value in triple) for triple in (*centers, *cam_from_world[:, :, 3]) for form in TEXT_FORMS]
    triples += [" ".join(repr(float(np.float32(value))) for value in triple) for triple in (*centers, *cam_from_world[:, :, 3])]
    return {
        "pose float32": [row.astype(kind).tobytes() for row in written for kind in ("<f4", ">f4")],
        "pose float64": [row.astype(kind).tobytes() for row in written for kind in ("<f8", ">f8")],
        "pose float16": [matrix.astype("<f2").tobytes() for matrix in matrices],
        "pose quaternion": [quat.astype(kind).tobytes() for quat in turns for kind in ("<f4", "<f8")],
        # A round number may stand anywhere.
        "pose text": [*(text.encode() for value in numbers if len(text := repr(float(value))) > 12), *(text.encode() for text in triples)],
    }


def files_with(canaries: Canaries, places: Iterable[Path], parts_of: Callable[[Path], Sequence[bytes]] | None = None) -> list[str]:
    """Which kinds stand in which files at these places, in their names too; poses nearby as "pose nearby".

    Where files are searched several times, `parts_of` is one `Parts` for all of them.
    """
    search, parts_of = Search(canaries), parts_of or Parts()
    hits = []
    for place in places:
        for path in sorted(place.rglob("*")) if place.is_dir() else [place]:
            name = str(path.relative_to(place.parent)).encode()
            kinds = search.kinds_in(name) | (search.kinds_in_parts(parts_of(path)) if path.is_file() else set[str]())
            hits += [f"{kind} in {path}" for kind in sorted(kinds)]
    return hits


class Parts:
    """What files are and may pack, unpacked once: the file itself first, nothing twice."""

    def __init__(self) -> None:
        self._known: dict[Path, Sequence[bytes]] = {}

    def __call__(self, path: Path) -> Sequence[bytes]:
        if path not in self._known:
            self._known[path] = tuple(dict.fromkeys(unpacked(path.read_bytes())))
        return self._known[path]


class Search:
    """Looks for all patterns of a device at once: only where three bytes fit is looked further."""

    def __init__(self, canaries: Canaries) -> None:
        self.centers_m = canaries.centers_m
        self._kinds = {pattern: kind for kind, patterns in canaries.patterns.items() for pattern in patterns}
        self._by_head: dict[bytes, list[bytes]] = {}
        self._heads = np.zeros(1 << 24, bool)
        for pattern in self._kinds:
            self._by_head.setdefault(pattern[:LEAST_BYTES], []).append(pattern)
            self._heads[int.from_bytes(pattern[:3], "little")] = True

    def kinds_in(self, content: bytes) -> set[str]:
        """Kinds of canaries in some bytes, as they are or packed."""
        return self.kinds_in_parts([*unpacked(content)])

    def kinds_in_parts(self, parts: Sequence[bytes]) -> set[str]:
        """The same of what some bytes, which come first, were unpacked to."""
        found = {kind for part in parts for kind in self._plain(part)}
        return found | ({"pose nearby"} if len(self.centers_m) and holds_near(parts[0], self.centers_m) else set())

    def _plain(self, content: bytes) -> Iterator[str]:
        data = np.frombuffer(content, np.uint8).astype(np.uint32)
        if len(data) < LEAST_BYTES:
            return
        for start in np.flatnonzero(self._heads[data[:-2] | data[1:-1] << 8 | data[2:] << 16]).tolist():
            for pattern in self._by_head.get(content[start : start + LEAST_BYTES], ()):
                if content.startswith(pattern, start):
                    yield self._kinds[pattern]


def holds_near(content: bytes, centers_m: NDArray[np.float64]) -> bool:
    """Whether three numbers in a row, floats or doubles at any place, lie within a millimetre of a centre (C,3)."""
    low, high = centers_m.min(axis=0) - NEAR_M, centers_m.max(axis=0) + NEAR_M
    for kind in ("<f4", "<f8"):
        size = np.dtype(kind).itemsize
        for offset in range(size):
            count = max(0, len(content) - offset) // size
            values = np.frombuffer(content, kind, count, offset) if count else np.zeros(0)
            if len(values) < 3:
                continue
            with np.errstate(invalid="ignore"):
                between = [(values >= low[axis]) & (values <= high[axis]) for axis in range(3)]
            for start in np.flatnonzero(between[0][:-2] & between[1][1:-1] & between[2][2:]):
                if np.abs(centers_m - values[start : start + 3].astype(np.float64)).max(axis=1).min() <= NEAR_M:
                    return True
    return False


def unpacked(content: bytes, depth: int = 2) -> Iterator[bytes]:
    """The bytes themselves and what they may pack, and what that packs."""
    yield content
    yield re.sub(rb"[\s,;:()\[\]]+", b" ", content)
    # All together, since most are a few bytes that only look like something.
    inner = b"\0\xff".join(part for part in _packed_in(content) if len(part) >= LEAST_BYTES) if depth else b""
    if inner:
        yield from unpacked(inner, depth - 1)


def _packed_in(content: bytes) -> Iterator[bytes]:
    for match in re.finditer(rb"(?:[\x20-\x7e]\0){8,}", content):
        yield match.group()[::2]
    for match in re.finditer(rb"[A-Za-z0-9+/_-]{12,}", content):
        run = match.group().translate(bytes.maketrans(b"-_", b"+/"))
        for skip in range(4):
            text = run[skip:]
            yield base64.b64decode(text + b"A" * (-len(text) % 4))
    for match in re.finditer(rb"[0-9a-fA-F]{16,}", content):
        for skip in range(2):
            text = match.group()[skip:]
            yield binascii.unhexlify(text[: len(text) // 2 * 2])
    for match in re.finditer(rb"\x1f\x8b\x08|\x78[\x01\x5e\x9c\xda]", content):
        try:
            yield zlib.decompressobj(wbits=47).decompress(memoryview(content)[match.start() :], MAX_UNPACKED_BYTES)
        except zlib.error:
            continue
    for match in re.finditer(rb"\xff\xd8\xff|\x89PNG\r\n\x1a\n", content):
        pixels = cv2.imdecode(np.frombuffer(content, np.uint8, offset=match.start()), cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION)
        if pixels is not None:
            yield pixels[..., :3].tobytes()
