"""Pictures as arrays (H,W,3) uint8 and as PNG files, written whole or not at all."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.io.photos.listing import MAX_FILE_BYTES, decode_image
from radiant_core.io.run_store import read_bounded, write_atomic
from radiant_core.numerics import FloatArray

Image = NDArray[np.uint8]


@dataclass(frozen=True, kw_only=True, eq=False)
class Drawing:
    """A picture (H,W,3) of layers without text, and the pixels of its labels.

    label_px (L,2): pixels of all labels in order, NaN behind the camera; mark_px (M,2): markers to
    keep free; extent: x_min, x_max, y_min, y_max of a map in world coordinates, None for a view in
    perspective.
    """

    image: Image
    label_px: FloatArray
    mark_px: FloatArray
    extent: tuple[float, float, float, float] | None


def save_png(path: Path, image: Image) -> None:
    """Write an image (H,W,3) uint8 as PNG, atomically; BadInput for another shape, type or ending,
    or where it cannot be written."""
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or 0 in image.shape:
        raise BadInput(f"a picture of shape {image.shape} and type {image.dtype} came, expected (H, W, 3) uint8.")
    if path.suffix.lower() != ".png":
        raise BadInput(f"cannot write {path}: pictures are written as PNG, let the name end in .png.")
    _, encoded = cv2.imencode(".png", np.ascontiguousarray(image[:, :, ::-1]))
    write_atomic(path, encoded.tobytes())


def load_image(path: Path) -> Image:
    """Read an image file of the run as (H,W,3) uint8; BadInput where it is missing or no image."""
    pixels = decode_image(read_bounded(path, MAX_FILE_BYTES) if path.is_file() else b"", cv2.IMREAD_COLOR)
    if pixels is None:
        raise BadInput(f"cannot read the picture {path}: it is missing or broken, run the evaluation again.")
    return np.ascontiguousarray(pixels[:, :, ::-1], dtype=np.uint8)
