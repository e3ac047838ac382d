"""Synthetic views on disk. Once per view.

`save_view`: one view, lossless, for processes beside: image and weight as the four channels of a
PNG in a file of arrays. 400 × 300 px: 275 kB instead of 480, 10 ms to write and 4 ms to read
where rendering took 28 (docs/experiments/uploads.md).

`save_views`: all views of an edge, on their way up, not lossless: images as JPEG, weights in 16
steps as PNG, one after the other. 384 × 288 px: 33 + 22 kB; with a quality of 95 and every step of
the weights it was 43 + 66 kB.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.io.array_file import load_arrays, name_file_in_errors, save_arrays
from radiant_core.io.photos.listing import decode_image, read_size_wh

SCHEMA, VIEWS_SCHEMA = "radiant.view", "radiant.views"
JPEG_QUALITY, WEIGHT_STEP = 90, 17
_VIEWS_DTYPES = {"images": "U8", "image_ends": "I64", "weights": "U8", "weight_ends": "I64"}


def save_view(path: Path, image: NDArray[np.uint8], weight: NDArray[np.uint8]) -> None:
    """Write image (H,W,3) and weight (H,W) uint8, atomically; raises as `write_atomic`."""
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


def save_views(path: Path, views: Sequence[tuple[NDArray[np.uint8], NDArray[np.uint8]]]) -> None:
    """Write images (H,W,3), weights (H,W) of V views, with loss; raises as `write_atomic`."""
    images = [_encode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]) for image, _ in views]
    coarse = [(np.rint(weight / WEIGHT_STEP) * WEIGHT_STEP).astype(np.uint8) for _, weight in views]
    weights = [_encode(".png", weight, [cv2.IMWRITE_PNG_COMPRESSION, 6]) for weight in coarse]
    arrays = {"images": _chain(images), "image_ends": _ends(images), "weights": _chain(weights), "weight_ends": _ends(weights)}
    save_arrays(path, VIEWS_SCHEMA, arrays, {})


def load_views(path: Path, sizes_wh: Sequence[tuple[int, int]]) -> list[tuple[NDArray[np.uint8], NDArray[np.uint8]]]:
    """The V views that `save_views` wrote, of these sizes, or none. Raises as `load_view`."""
    arrays, _ = load_arrays(path, VIEWS_SCHEMA, _VIEWS_DTYPES)
    with name_file_in_errors(path):
        if not arrays["image_ends"].size:
            return []
        images, weights = (_split_chain(arrays[f"{name}s"], arrays[f"{name}_ends"], len(sizes_wh)) for name in ("image", "weight"))
        views = []
        for image, weight, (width, height) in zip(images, weights, sizes_wh, strict=True):
            for data in (image, weight):
                # Before decoding: no more memory is taken than the view is expected to need.
                if read_size_wh(data) != (width, height):
                    raise BadInput(f"it has a view of {read_size_wh(data)} px, expected {width} × {height}: send it anew.")
            pixels = decode_image(image, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
            alphas = decode_image(weight, cv2.IMREAD_UNCHANGED)
            if pixels is None or alphas is None or pixels.shape != (height, width, 3) or alphas.shape != (height, width):
                raise BadInput("it has a view that is no whole picture: send it anew.")
            views.append((np.array(pixels[..., ::-1], np.uint8, order="C"), np.asarray(alphas, np.uint8)))
    return views


def _encode(kind: str, pixels: NDArray[np.uint8], settings: list[int]) -> NDArray[np.uint8]:
    encoded, data = cv2.imencode(kind, np.ascontiguousarray(pixels), settings)
    assert encoded
    return np.asarray(data, np.uint8).ravel()


def _chain(parts: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    return np.concatenate([np.zeros(0, np.uint8), *parts])


def _ends(parts: Sequence[NDArray[np.uint8]]) -> NDArray[np.int64]:
    return np.cumsum([len(part) for part in parts], dtype=np.int64)


def _split_chain(data: NDArray[np.uint8], ends: NDArray[np.int64], count: int) -> list[bytes]:
    """The parts of what `_chain` and `_ends` made; BadInput where count or ends do not fit."""
    if data.ndim != 1 or ends.shape != (count,):
        raise BadInput(f"it holds {ends.shape} views, expected {count}: send it anew.")
    starts = np.concatenate([[0], ends])
    if (np.diff(starts) < 0).any() or starts[-1] != len(data):
        raise BadInput("its views end where no bytes are: send it anew.")
    return [data[start:end].tobytes() for start, end in pairwise(starts)]


def _png_size_wh(png: NDArray[np.uint8]) -> list[int]:
    """Width and height that the head of a PNG (n,) says; zeros where it is none."""
    if png.ndim != 1 or len(png) < 24 or png[:8].tobytes() != b"\x89PNG\r\n\x1a\n":
        return [0, 0]
    return [int(side) for side in png[16:24].view(">u4")]
