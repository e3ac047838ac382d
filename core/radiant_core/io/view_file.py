"""Synthetic views on disk. Once per view.

`save_view`: one view, lossless, for processes beside: image and weight as the four channels of a
PNG in a file of arrays. 400 × 300 px: 275 kB instead of 480, 10 ms to write and 4 ms to read
where rendering took 28 (docs/experiments/uploads.md).
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.io.array_file import load_arrays, name_file_in_errors, save_arrays
from radiant_core.io.photos.listing import decode_image

SCHEMA = "radiant.view"


def save_view(path: Path, image: NDArray[np.uint8], weight: NDArray[np.uint8]) -> None:
    """Write image (H,W,3) and weight (H,W) uint8, atomically; BadInput for another shape or type,
    else raises as `write_atomic`."""
    if image.dtype != np.uint8 or weight.dtype != np.uint8 or image.shape != (*weight.shape, 3) or not weight.size:
        raise BadInput(
            f"a view has image {image.shape} {image.dtype} and weight {weight.shape} {weight.dtype}, expected (H,W,3), (H,W) uint8."
        )
    # The lowest level: the next ones take 1.5 and 4 times as long for 3 and 6 % fewer bytes.
    encoded, png = cv2.imencode(".png", np.dstack([image[..., ::-1], weight]), [cv2.IMWRITE_PNG_COMPRESSION, 1])
    assert encoded
    save_arrays(path, SCHEMA, {"png": png}, {"size_wh": [image.shape[1], image.shape[0]]})


def load_view(path: Path, width: int, height: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Image (H,W,3) and weight (H,W) that `save_view` wrote; StoreDamaged when broken, BadInput
    when it holds something else or a view of another size."""
    arrays, about = load_arrays(path, SCHEMA, {"png": "U8"})
    with name_file_in_errors(path):
        # Before decoding, so that no more memory is taken than the view is expected to need.
        png = arrays["png"]
        size_wh = _png_size_wh(png)
        if not about["size_wh"] == size_wh == [width, height]:
            raise BadInput(f"it is a view of {size_wh[0]} × {size_wh[1]} px, expected {width} × {height}: render it anew.")
        pixels = decode_image(png.tobytes(), cv2.IMREAD_UNCHANGED)
        if pixels is None or pixels.shape != (height, width, 4) or pixels.dtype != np.uint8:
            raise StoreDamaged(f"{path} holds no whole picture: render it anew.")
    return np.array(pixels[..., 2::-1], np.uint8, order="C"), np.array(pixels[..., 3], np.uint8, order="C")


def _png_size_wh(png: NDArray[np.uint8]) -> list[int]:
    """Width and height that the head of a PNG (n,) says; zeros where it is none."""
    if png.ndim != 1 or len(png) < 24 or png[:8].tobytes() != b"\x89PNG\r\n\x1a\n":
        return [0, 0]
    return [int(side) for side in png[16:24].view(">u4")]
