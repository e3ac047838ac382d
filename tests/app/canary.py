"""Canaries: what is known of a device's photographs and poses, as bytes that can be looked for in the files of everybody else."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.io.photos import photograph_positions

COMMENT = b"canary of %s: this string stands in the photograph alone"
NUM_ROWS, STRETCH_PX = 6, 12
"""Rows of a photograph that are looked for, and how many pixels of each."""


@dataclass(frozen=True, kw_only=True)
class Canaries:
    """Bytes that belong to one device, by what they are of. An edge may hold its devices' poses; everything else stays."""

    photographs: dict[str, list[bytes]]
    poses: list[bytes]


def mark(photograph: Path) -> None:
    """Put a comment into a JPEG, behind its EXIF."""
    data = photograph.read_bytes()
    end = 2
    while data[end : end + 2] in (b"\xff\xe0", b"\xff\xe1"):
        end += 2 + struct.unpack(">H", data[end + 2 : end + 4])[0]
    text = COMMENT % photograph.name.encode()
    photograph.write_bytes(data[:end] + b"\xff\xfe" + struct.pack(">H", len(text) + 2) + text + data[end:])


def canaries_of(photographs: Path, poses: Cameras, sizes_px: Iterable[int]) -> Canaries:
    """What to look for of the device with these photographs and poses; pixels at their own size and at long sides of `sizes_px`."""
    found: dict[str, list[bytes]] = {"names": [], "EXIF": [], "GPS": [], "pixels": [], "comments": []}
    for name, place in photograph_positions(photographs).items():
        data = (photographs / name).read_bytes()
        found["names"].append(name.encode())
        found["comments"].append(COMMENT % name.encode())
        exif = data.find(b"Exif\0\0")
        assert exif > 0 and place is not None, "the sample photographs have EXIF with GPS"
        # From the GPS directory on: what stands before is the same in photographs of other devices.
        length = struct.unpack(">H", data[exif - 2 : exif])[0]
        found["EXIF"] += [data[start : start + 24] for start in range(exif + length - 80, exif + length - 32, 8)]
        for degrees in place[:2]:
            assert len(repr(degrees)) > 9, "a round number may stand anywhere"
            found["GPS"] += [struct.pack("<d", degrees), struct.pack(">d", degrees), repr(degrees).encode()]
        found["pixels"] += _stretches(photographs / name, sizes_px)
    rows = poses.cam_from_world[:, :3].reshape(-1, 4)
    written = [array.astype(kind).tobytes() for array in (*rows, *poses.centers) for kind in ("<f4", "<f8")]
    texts = [repr(float(value)).encode() for array in (*poses.cam_from_world[:, :3, 3], *poses.centers) for value in array]
    # A round number may stand anywhere.
    return Canaries(photographs=found, poses=[*written, *(text for text in texts if len(text) > 12)])


def _stretches(photograph: Path, sizes_px: Iterable[int]) -> list[bytes]:
    image = np.asarray(cv2.imread(str(photograph)))[..., ::-1]
    height, width = image.shape[:2]
    scales = [1.0, *(size / max(height, width) for size in sizes_px)]
    found = []
    for scale in scales:
        small = image if scale == 1 else cv2.resize(image, (round(scale * width), round(scale * height)), interpolation=cv2.INTER_AREA)
        for row in np.linspace(0, len(small) - 1, NUM_ROWS).astype(int):
            stretch = np.ascontiguousarray(small[row, :STRETCH_PX])
            if stretch.std() > 4:  # what is all one colour may stand anywhere
                found += [stretch.tobytes(), (stretch.astype(np.float32) / np.float32(255)).tobytes()]
    return found


def finds(patterns: Iterable[bytes], places: Iterable[Path]) -> list[str]:
    """Which patterns stand in which files at these places, in their names too."""
    patterns = list(patterns)
    hits = []
    for place in places:
        for path in sorted(place.rglob("*")) if place.is_dir() else [place]:
            content = str(path.relative_to(place.parent)).encode() + b"\0" + (path.read_bytes() if path.is_file() else b"")
            hits += [f"{pattern[:40]!r} in {path}" for pattern in patterns if pattern in content]
    return hits
