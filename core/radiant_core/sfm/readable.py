"""Photographs whose samples are not 8-bit numbers, as pictures that every later step reads alike.

    work/readable/a/b.tif      in 8 bits, by the one stretch of its kind; links to all others

COLMAP, OpenCV and others cut 16 bits to 8 in their own ways, and read no floating point. Once per
scene, and only where a listing has stretches.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2

from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.io.photos.listing import MAX_FILE_BYTES, Photograph, PhotoListing, decode_image
from radiant_core.io.photos.samples import Stretch, stretch_of, stretched
from radiant_core.io.run_store import read_bounded, write_atomic

READABLE = "readable"


def readable_folder(listing: PhotoListing, photo_folder: Path, work_folder: Path) -> Path:
    """The folder whose photographs later steps read: `photo_folder`, or one in `work_folder` with
    the same names. Raises BadInput where a photograph was changed meanwhile."""
    folder = work_folder / READABLE
    shutil.rmtree(folder, ignore_errors=True)
    if not listing.stretches:
        return photo_folder
    for photo in listing.photographs:
        path = folder / photo.name
        path.parent.mkdir(parents=True, exist_ok=True)
        stretch = stretch_of(photo.samples, listing.stretches)
        if stretch is None:
            _link(photo.path, path)
        else:
            write_atomic(path, _encoded(photo, stretch))
    return folder


def remove_readable(work_folder: Path) -> None:
    """Remove what `readable_folder` made, once everything is undistorted."""
    shutil.rmtree(work_folder / READABLE, ignore_errors=True)


def stretch_decisions(listing: PhotoListing) -> tuple[Decision, ...]:
    """How each kind of samples is shown in 8 bits."""
    return tuple(
        Decision(
            stage="sfm",
            topic="stretch",
            choice=f"{stretch.low:,.6g} to {stretch.high:,.6g} shown as 0 to 255",
            figure=float(stretch.num_photographs),
            unit="photographs",
            reason=f"they have {stretch.kind.bits}-bit {stretch.kind.format} samples in this range; all photographs are stretched alike",
        )
        for stretch in listing.stretches
    )


def _encoded(photo: Photograph, stretch: Stretch) -> bytes:
    data = read_bounded(photo.path, MAX_FILE_BYTES) if photo.path.is_file() else b""
    pixels = decode_image(data, cv2.IMREAD_UNCHANGED)
    if pixels is None or pixels.shape[1::-1] != photo.size_wh:
        raise BadInput(f"the photograph {photo.path} is not whole or cannot be decoded: remove it or fetch it again.")
    _, encoded = cv2.imencode(photo.path.suffix.lower(), stretched(pixels, stretch))
    return encoded.tobytes()


def _link(source: Path, path: Path) -> None:
    try:
        path.symlink_to(source.resolve())
    except OSError:
        # Windows lets few users make links.
        shutil.copyfile(source, path)
