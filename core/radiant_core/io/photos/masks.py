"""Masks of photographs: which pixels count. For photograph a/b.jpg the file a/b.jpg.png (COLMAP) or
a/b.png (nerfstudio): 8-bit grey, as large as the photograph as it is stored, 0: ignored, anything
else: used. A photograph without a file is used whole, or as far as its own alpha channel says.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path, PurePosixPath

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.io.photos.listing import MAX_FILE_BYTES, decode_image, has_alpha, read_size_wh
from radiant_core.io.run_store import read_bounded, write_atomic

USED = 255


def mask_name(name: str) -> str:
    """Where Radiant keeps the mask of a photograph, inside the folder of masks."""
    return f"{name}.png"


def find_masks(folder: Path, names: Sequence[str]) -> dict[str, Path]:
    """Photograph → file of its mask where there is one. BadInput where none fits."""
    if not folder.is_dir():
        raise BadInput(f"the folder of masks {folder} does not exist: give a folder with one PNG per photograph, named photograph.jpg.png.")
    places = {name: (folder / mask_name(name), folder / PurePosixPath(name).with_suffix(".png")) for name in names}
    found = {name: next((path for path in paths if path.is_file()), None) for name, paths in places.items()}
    masks = {name: path for name, path in found.items() if path is not None}
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
    # A grey picture that was saved as RGB; a colour photograph is no mask.
    if image.ndim == 3 and image.shape[2] == 3 and (image == image[..., :1]).all():
        image = image[..., 0]
    if image.ndim != 2 or image.dtype != np.uint8:
        channels = 1 if image.ndim == 2 else image.shape[2]
        raise BadInput(f"the mask {path} has {channels} channel(s) of {image.dtype}, expected 8-bit grey: 0 to ignore, 255 to use.")
    if image.shape[::-1] != tuple(size_wh):
        raise BadInput(_other_size(path, (image.shape[1], image.shape[0]), size_wh))
    if not image.any():
        raise BadInput(f"the mask {path} leaves nothing of its photograph: 0 is ignored, 255 is used; or leave the photograph out.")
    return image > 0


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
    found, wanted = f"{found_wh[0]} × {found_wh[1]} px", f"{size_wh[0]} × {size_wh[1]} as it is stored"
    return f"the mask {path} is {found} and its photograph {wanted}: make it as large, without the EXIF rotation."


def save_mask(path: Path, used: NDArray[np.bool_]) -> None:
    """Write which pixels (H,W) are used as PNG, 0 and 255."""
    encoded, data = cv2.imencode(".png", used.astype(np.uint8) * USED)
    assert encoded
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(path, data.tobytes())


def pixel_weights(folder: Path | None, cameras: Cameras) -> tuple[NDArray[np.uint8], ...] | None:
    """Per camera the used share (H,W) of each pixel, 255 for all, from masks of `save_mask`; None
    without any. BadInput where a mask cannot be decoded."""
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
