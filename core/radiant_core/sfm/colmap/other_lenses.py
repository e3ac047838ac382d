"""Photographs of lenses that COLMAP has no model for (k₄, skew), as pinholes took them. Per scene.

The pinhole has the lens's focal length and principal point and the photograph's size: what falls
outside is cut, what the lens did not show is black, as COLMAP's undistorter leaves it. The pixels
are `warp`'s, by `Lens.img_from_cam`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path, PurePosixPath

import cv2
import numpy as np

from radiant_core.errors import BadInput
from radiant_core.io.photos.jpeg import kept_segments
from radiant_core.io.photos.listing import MAX_FILE_BYTES, decode_image
from radiant_core.io.photos.masks import find_masks, load_mask, mask_name, save_mask
from radiant_core.io.poses.lens import Lens
from radiant_core.io.poses.pose_file import straight_camera
from radiant_core.io.run_store import read_bounded
from radiant_core.sfm.colmap.calls import pycolmap
from radiant_core.sfm.colmap.undistort import JPEG_QUALITY
from radiant_core.sfm.colmap.warp import JPEG_SUFFIXES, warp
from radiant_core.sfm.config import Report, SfmProgress

_START = b"\xff\xd8"


def straighten(lenses: Mapping[str, Lens], photos: Path, to_folder: Path, report: Report) -> None:
    """Write the photographs, name → lens, of `photos` into `to_folder` without distortion. Raises
    BadInput where one cannot be decoded in the size of its lens."""
    report(SfmProgress(phase="undistorting", done=0, total=len(lenses)))
    for num_done, (name, lens) in enumerate(lenses.items(), 1):
        data = read_bounded(photos / name, MAX_FILE_BYTES)
        pixels = decode_image(data, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        if pixels is None or pixels.shape[1::-1] != lens.size_wh:
            raise BadInput(f"the photograph {photos / name} cannot be decoded in the size of its lens: fetch it again.")
        straight = warp(np.asarray(pixels, np.uint8), lens, _pinhole(lens))
        is_jpeg = name.lower().endswith(JPEG_SUFFIXES)
        _, encoded = cv2.imencode(PurePosixPath(name).suffix, straight, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY] if is_jpeg else [])
        written = encoded.tobytes()
        (to_folder / name).parent.mkdir(parents=True, exist_ok=True)
        (to_folder / name).write_bytes(_START + kept_segments(data) + written[len(_START) :] if is_jpeg else written)
        report(SfmProgress(phase="undistorting", done=num_done, total=len(lenses)))


def straighten_masks(lenses: Mapping[str, Lens], masks: Path, to_folder: Path) -> None:
    """The same for those photographs that have a mask; a pixel is used where all that it is made of
    is."""
    for name, path in find_masks(masks, list(lenses)).items():
        used = load_mask(path, lenses[name].size_wh)
        save_mask(to_folder / mask_name(name), warp(used.astype(np.uint8) * 255, lenses[name], _pinhole(lenses[name])) == 255)


def _pinhole(lens: Lens) -> pycolmap.Camera:
    camera = straight_camera(1, lens)
    return pycolmap.Camera(model=camera.model, width=lens.size_wh[0], height=lens.size_wh[1], params=list(camera.params))
