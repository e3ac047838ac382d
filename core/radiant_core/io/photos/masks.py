"""Masks of photographs: which pixels count. Their names are those of `mask_folders`: 8-bit grey, as
large as the photograph as it is stored, 0: ignored, anything else: used; of a JPEG, whose edges
ring, half of white and more. A photograph without a file is used whole, or as far as its own alpha
channel says.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.io.photos.listing import MAX_FILE_BYTES, decode_image, has_alpha, read_size_wh
from radiant_core.io.photos.mask_folders import match_masks, question_of_colour
from radiant_core.io.run_store import read_bounded, write_atomic

USED = 255
JPEG_SIGNATURE, HALF = b"\xff\xd8", 127
MAX_READ = 24
"""Masks that are looked at to see which colour they leave out."""


def mask_name(name: str) -> str:
    """Where Radiant keeps the mask of a photograph, inside the folder of masks."""
    return f"{name}.png"


def find_masks(folder: Path, names: Sequence[str]) -> dict[str, Path]:
    """Photograph → file of its mask, where it has one. BadInput where no name in `folder` fits."""
    if not folder.is_dir():
        raise BadInput(f"the folder of masks {folder} does not exist: give a folder with one PNG per photograph, named photograph.jpg.png.")
    masks = dict(match_masks(folder, names).files)
    if not masks:
        example = mask_name(names[0]) if names else "photograph.jpg.png"
        raise BadInput(f"no file in {folder} is named after a photograph: expected for example {example}, or the same with .png alone.")
    return masks


def load_mask(path: Path, size_wh: tuple[int, int]) -> NDArray[np.bool_]:
    """Which pixels (H,W) of a photograph of `size_wh` px are used.

    Raises BadInput where the file cannot be decoded, is not 8-bit grey, has another size, or uses
    no pixel.
    """
    data = read_bounded(path, MAX_FILE_BYTES) if path.is_file() else b""
    found_wh = read_size_wh(data)
    if found_wh is not None and found_wh != tuple(size_wh):
        raise BadInput(_other_size(path, found_wh, size_wh))
    image = decode_image(data, cv2.IMREAD_UNCHANGED)
    if image is None:
        raise BadInput(f"the mask {path} cannot be decoded: write it again as 8-bit grey PNG.")
    image = _grey(image)
    if image.ndim != 2 or image.dtype != np.uint8:
        channels = 1 if image.ndim == 2 else image.shape[2]
        raise BadInput(f"the mask {path} has {channels} channel(s) of {image.dtype}, expected 8-bit grey: 0 to ignore, 255 to use.")
    if image.shape[::-1] != tuple(size_wh):
        raise BadInput(_other_size(path, (image.shape[1], image.shape[0]), size_wh))
    used = image > _black(data)
    if not used.any():
        raise BadInput(f"the mask {path} leaves nothing of its photograph: 0 is ignored, 255 is used; or leave the photograph out.")
    return used


def _black(data: bytes) -> int:
    """The greatest value that counts as black in a file."""
    return HALF if data.startswith(JPEG_SIGNATURE) else 0


def _grey(image: NDArray[Any]) -> NDArray[Any]:
    """A grey picture that was saved in colours, or as the opacity of one colour; a colour
    photograph is no mask and stays as it is."""
    if image.ndim != 3 or image.shape[2] not in (3, 4) or not (image[..., 1:3] == image[..., :1]).all():
        return image
    if image.shape[2] == 3 or (image[..., 3] == np.iinfo(image.dtype).max).all():
        return image[..., 0]
    return image[..., 3] if (image[..., 0] == image[0, 0, 0]).all() else image


def require_black_ignored(folder: Path, masks: Mapping[str, Path]) -> float:
    """The share of pixels that black leaves in the masks, of `MAX_READ` at most; BadInput asks
    which colour is meant where that is less than half."""
    paths = list(masks.values())
    shares = []
    for path in paths[:: -(-len(paths) // MAX_READ)]:
        data = read_bounded(path, MAX_FILE_BYTES)
        image = decode_image(data, cv2.IMREAD_UNCHANGED)
        if image is not None and (grey := _grey(image)).ndim == 2:
            shares.append(float((grey > _black(data)).mean()))
    share = float(np.mean(shares)) if shares else 1.0
    if share < 0.5:
        raise question_of_colour(folder, share, len(shares))
    return share


def turn_masks(masks: Mapping[str, Path], folder: Path) -> None:
    """Write masks of which white is left out into `folder`, so that black is, under the names that
    `mask_name` gives. BadInput where one cannot be decoded or leaves nothing."""
    for name, path in masks.items():
        image = decode_image(read_bounded(path, MAX_FILE_BYTES), cv2.IMREAD_UNCHANGED)
        grey = None if image is None else _grey(image)
        if grey is None or grey.ndim != 2 or grey.dtype != np.uint8:
            raise BadInput(f"the mask {path} cannot be read: write it again as 8-bit grey PNG, white where nothing is used.")
        save_mask(folder / mask_name(name), grey <= HALF)


def alpha_mask(path: Path) -> NDArray[np.bool_] | None:
    """Which pixels (H,W) of a photograph its alpha channel leaves: more than half opaque; None
    where that is all, none or unsaid."""
    if not has_alpha(path):
        return None
    image = decode_image(read_bounded(path, MAX_FILE_BYTES), cv2.IMREAD_UNCHANGED)
    if image is None or image.ndim != 3 or image.shape[2] not in (2, 4):
        return None
    used = image[..., -1] > np.iinfo(image.dtype).max // 2
    return used if used.any() and not used.all() else None


def _other_size(path: Path, found_wh: tuple[int, int], size_wh: tuple[int, int]) -> str:
    actual, expected = f"{found_wh[0]} × {found_wh[1]} px", f"{size_wh[0]} × {size_wh[1]} as it is stored"
    return f"the mask {path} is {actual} and its photograph {expected}: make it as large, without the EXIF rotation."


def save_mask(path: Path, used: NDArray[np.bool_]) -> None:
    """Write which pixels (H,W) are used as PNG, 0 and 255."""
    encoded, data = cv2.imencode(".png", used.astype(np.uint8) * USED)
    assert encoded
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(path, data.tobytes())


def pixel_weights(folder: Path | None, cameras: Cameras) -> tuple[NDArray[np.uint8], ...] | None:
    """Per camera the used share (H,W) of each of its pixels, 255 for all of it, from masks that
    `save_mask` wrote; None without any. Raises BadInput where a mask cannot be decoded."""
    if folder is None or not any((folder / mask_name(name)).is_file() for name in cameras.names):
        return None
    sizes = [(int(width), int(height)) for width, height in cameras.sizes_wh]
    return tuple(_load_reduced(folder / mask_name(name), size) for name, size in zip(cameras.names, sizes, strict=True))


def _load_reduced(path: Path, size_wh: tuple[int, int]) -> NDArray[np.uint8]:
    if not path.is_file():
        return np.full(size_wh[::-1], USED, np.uint8)
    image = decode_image(read_bounded(path, MAX_FILE_BYTES), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise BadInput(f"the mask {path} cannot be decoded: remove the folder that it lies in and run again.")
    return np.asarray(cv2.resize(image, size_wh, interpolation=cv2.INTER_AREA), np.uint8)


def used_pixels(weights: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Which pixels (H,W) are used by half or more, where a pixel counts or does not."""
    return 2 * weights.astype(np.int64) > USED
