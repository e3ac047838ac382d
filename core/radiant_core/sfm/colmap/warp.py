"""One JPEG photograph without lens distortion, decoded and encoded by OpenCV. Once per photograph.

    source px = image(K⁻¹ (column + ½, row + ½, 1)) − ½,    bilinear, black outside

as COLMAP does it, in a third of its time: 28 against 92 ms a megapixel, the same pixels to one step
of brightness (docs/experiments/sfm.md). The map of a block of rows at a time is made, so that a
photograph is held twice and nothing else of its size. EXIF goes along.
"""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.io.photos.jpeg import kept_segments
from radiant_core.io.photos.listing import MAX_FILE_BYTES, decode_image
from radiant_core.io.run_store import read_bounded
from radiant_core.numerics import FloatArray
from radiant_core.sfm.colmap.calls import pycolmap

ROWS_PER_BLOCK = 64
LEAST_SCALE = 0.5
"""A picture that shrinks by more is averaged by COLMAP before it is warped, not here."""
JPEG_SUFFIXES = (".jpg", ".jpeg")
MOST_SIDE_PX = 2**15 - 1
"""OpenCV's `remap` reads no larger pictures."""
_START = b"\xff\xd8"


class Projects(Protocol):
    """A lens: pixels (N,2) of points (N,3) in its frame, not finite where it shows none."""

    def img_from_cam(self, rays: FloatArray, /) -> FloatArray:
        """Pixels, the first one's middle at (0.5, 0.5)."""
        ...


def can_warp(name: str, camera: pycolmap.Camera, pinhole: pycolmap.Camera) -> bool:
    """Whether `warp_jpeg` makes of this photograph what COLMAP would."""
    scale = min(pinhole.width / camera.width, pinhole.height / camera.height)
    fits = max(camera.width, camera.height) <= MOST_SIDE_PX and scale >= LEAST_SCALE
    return name.lower().endswith(JPEG_SUFFIXES) and not camera.is_undistorted() and fits


def warp_jpeg(source: Path, camera: pycolmap.Camera, pinhole: pycolmap.Camera, quality: int) -> bytes:
    """The photograph at `source`, taken by `camera`, as the JPEG that `pinhole` would have taken.
    Raises BadInput where it cannot be decoded, or has another size than its camera."""
    data = read_bounded(source, MAX_FILE_BYTES)
    pixels = decode_image(data, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if pixels is None or pixels.shape[:2] != (camera.height, camera.width):
        raise BadInput(f"the photograph {source} cannot be decoded in the size of its camera: fetch it again.")
    _, encoded = cv2.imencode(".jpg", warp(np.asarray(pixels, np.uint8), camera, pinhole), [cv2.IMWRITE_JPEG_QUALITY, quality])
    jpeg = encoded.tobytes()
    return _START + kept_segments(data) + jpeg[len(_START) :]


def warp(pixels: NDArray[np.uint8], camera: Projects, pinhole: pycolmap.Camera) -> NDArray[np.uint8]:
    """The pixels (H,W) or (H,W,3) of `camera` as `pinhole` would see them."""
    warped = np.empty((pinhole.height, pinhole.width, *pixels.shape[2:]), np.uint8)
    for top in range(0, pinhole.height, ROWS_PER_BLOCK):
        block = warped[top : top + ROWS_PER_BLOCK]
        columns, rows = _source_px(camera, pinhole, np.arange(top, top + len(block)))
        cv2.remap(pixels, columns, rows, cv2.INTER_LINEAR, dst=block, borderMode=cv2.BORDER_CONSTANT)
    return warped


def _source_px(camera: Projects, pinhole: pycolmap.Camera, rows: NDArray[np.int64]) -> NDArray[np.float32]:
    """Where (2,R,W) the pixels of R rows of `pinhole` lie in `camera`, counted from the middle of
    the first; outside of the picture where the lens shows nothing."""
    rays = np.ones((len(rows), pinhole.width, 3))
    rays[..., 0] = (np.arange(pinhole.width) + 0.5 - pinhole.principal_point_x) / pinhole.focal_length_x
    rays[..., 1] = ((rows + 0.5 - pinhole.principal_point_y) / pinhole.focal_length_y)[:, None]
    places = np.asarray(camera.img_from_cam(rays.reshape(-1, 3)), np.float64) - 0.5
    places = np.nan_to_num(places.T, nan=-2.0, posinf=-2.0, neginf=-2.0)
    return np.ascontiguousarray(places, np.float32).reshape(2, len(rows), pinhole.width)
