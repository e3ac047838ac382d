"""Images that lie in a file and are read each time one is shown, so that the memory of a training
does not grow with its views. Once per view to write, once per step to read.

    file: H W or H W 3 bytes per image, one after the other; it has no name, and goes when
          nobody uses it

As they are: a render of 576 × 432 px as PNG has a third of the bytes and takes 13 times as long to
read, 7.5 ms in place of 0.6 (a photograph-like one has 0.6 of the bytes).
"""

from __future__ import annotations

import os
import tempfile
import weakref
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import CannotWrite, way_to_write

Window = tuple[int, int, int, int]
"""Rows from, to, columns from, to of an image."""


class UnnamedFile:
    """A file without a name in a folder, closed with its last user."""

    def __init__(self, folder: Path) -> None:
        self.bytes: IO[bytes] = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115
        weakref.finalize(self, self.bytes.close)


@dataclass(frozen=True, kw_only=True)
class Place:
    """Where an image (H,W,3) or (H,W) uint8 lies in a file; only `window` of it counts."""

    file: UnnamedFile
    offset: int
    shape: tuple[int, ...]
    window: Window

    @property
    def window_shape(self) -> tuple[int, ...]:
        """Shape of what counts."""
        top, bottom, left, right = self.window
        return (bottom - top, right - left, *self.shape[2:])

    def read(self) -> NDArray[np.uint8]:
        """The window's pixels."""
        top, bottom, left, right = self.window
        rows = np.empty((bottom - top, *self.shape[1:]), np.uint8)
        self.file.bytes.seek(self.offset + top * int(np.prod(self.shape[1:])))
        num_read = self.file.bytes.readinto(rows.data)  # type: ignore[attr-defined]
        assert num_read == rows.size
        return np.ascontiguousarray(rows[:, left:right])


@dataclass(frozen=True, kw_only=True, eq=False)
class StoredImages:
    """V images that lie in files."""

    places: tuple[Place, ...]

    def __len__(self) -> int:
        return len(self.places)

    def __getitem__(self, index: int) -> NDArray[np.uint8]:
        return self.places[index].read()

    def __iter__(self) -> Iterator[NDArray[np.uint8]]:
        return (place.read() for place in self.places)


Images = tuple[NDArray[np.uint8], ...] | StoredImages
"""Images in memory, or in a file."""


def store_views(views: Iterable[tuple[NDArray[np.uint8], NDArray[np.uint8]]], folder: Path | None) -> tuple[Images, Images]:
    """Images (H,W,3) and weights (H,W), uint8, of V views in a file of `folder`, one view at a time
    in memory; all of them in memory without a folder.

    Raises CannotWrite where the folder has no room, or cannot be written.
    """
    if folder is None:
        pairs = list(views)
        return tuple(image for image, _ in pairs), tuple(weight for _, weight in pairs)
    places: tuple[list[Place], list[Place]] = ([], [])
    try:
        file = UnnamedFile(folder)
        for view in views:
            for part, pixels in zip(places, view, strict=True):
                height, width = pixels.shape[:2]
                part.append(Place(file=file, offset=file.bytes.tell(), shape=pixels.shape, window=(0, height, 0, width)))
                file.bytes.write(np.ascontiguousarray(pixels).data)
        file.bytes.flush()
    except OSError as error:
        reason, way = os.strerror(error.errno or 0), way_to_write(error, "free space there")
        raise CannotWrite(f"{folder} cannot hold the pictures that models are joined by ({reason}): {way}.") from error
    return StoredImages(places=tuple(places[0])), StoredImages(places=tuple(places[1]))


def shapes_of(images: Images) -> Sequence[tuple[int, ...]]:
    """The shape of each image; none is read."""
    return [place.window_shape for place in images.places] if isinstance(images, StoredImages) else [image.shape for image in images]


def select_images(images: Images, indices: Iterable[int]) -> Images:
    """Some of the images, in the given order; none is read."""
    if isinstance(images, StoredImages):
        return StoredImages(places=tuple(images.places[index] for index in indices))
    return tuple(images[index] for index in indices)


def crop_images(images: Images, windows: Sequence[Window]) -> Images:
    """A window of each of the images; none is read."""
    if isinstance(images, StoredImages):
        return StoredImages(places=tuple(replace(place, window=w) for place, w in zip(images.places, windows, strict=True)))
    return tuple(image[top:bottom, left:right] for image, (top, bottom, left, right) in zip(images, windows, strict=True))


def concatenate_images(parts: Sequence[Images]) -> Images:
    """All images of `parts` in order; none is read where all of them are stored."""
    stored = [part for part in parts if isinstance(part, StoredImages)]
    if len(stored) < len(parts) or not stored:
        return tuple(image for part in parts for image in part)
    return StoredImages(places=tuple(place for part in stored for place in part.places))
