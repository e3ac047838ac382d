"""Photographs that show another's picture from its place, saved anew or turned. Once per scene.

A copy of a photograph that scores a model would be trained on what is scored, so copies go before
anything is split. Pictures are read only where two cameras stand in one place and look in one
direction.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from radiant_core.cameras import Cameras
from radiant_core.io.photos.copies import copies_warning, sort_by_worth
from radiant_core.io.photos.listing import load_thumbnail
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene

SAME_PLACE = 2e-3
"""Distance of two centres, in distances to what they see, under which they are one place."""
SAME_DIRECTION_RAD = 2e-3
SAME_LENS = 1e-2
"""Relative difference of focal lengths and principal points, in widths and heights of the picture:
a copy may be smaller."""
SAME_PICTURE = 4.0
"""Mean difference, in steps of 8 bits, of pictures at `THUMBNAIL_PX` under which they are one."""
THUMBNAIL_PX = 128

Picture = NDArray[np.uint8]


def find_repeats(cameras: Cameras, points: FloatArray, picture_of: Callable[[int], Picture]) -> dict[int, int]:
    """Repeat → the camera whose picture it shows from its place, as indices of C cameras above
    points (P,3). `picture_of` gives the picture (H,W,3) of a camera, of any size; it is called once
    for each camera that has another at its place."""
    centers, axes = cameras.centers, cameras.cam_from_world[:, :3, :3]
    lenses = cameras.Ks[:, :2] / cameras.sizes_wh[:, :, None]
    distance = float(np.median(KDTree(centers).query(points)[0])) if len(points) else 0.0
    rank = np.argsort(sort_by_worth(cameras.names))
    pairs = [sorted(pair, key=lambda index: rank[index]) for pair in KDTree(centers).query_pairs(SAME_PLACE * distance)]
    thumbnails: dict[int, NDArray[np.float32]] = {}
    repeated: dict[int, int] = {}
    for first, second in sorted(pairs, key=lambda pair: (rank[pair[0]], rank[pair[1]])):
        turn = np.linalg.norm(axes[first] - axes[second]) / np.sqrt(2)
        same_lens = np.allclose(lenses[first], lenses[second], rtol=SAME_LENS, atol=1e-9)
        if first in repeated or second in repeated or turn > SAME_DIRECTION_RAD or not same_lens:
            continue
        for index in {first, second} - thumbnails.keys():
            scale = min(1.0, THUMBNAIL_PX / int(cameras.sizes_wh[index].max()))
            thumbnails[index] = _reduce(picture_of(index), np.maximum(1, np.round(scale * cameras.sizes_wh[index])))
        if _difference(thumbnails[first], thumbnails[second]) < SAME_PICTURE:
            repeated[second] = first
    return repeated


def without_repeats(scene: SfmScene, images: Path) -> tuple[SfmScene, tuple[str, ...]]:
    """The scene without cameras that repeat another, whose photographs lie in `images`, and the
    warnings about them."""
    cameras, warnings = cameras_without_repeats(scene.cameras, scene.points, images)
    if not warnings:
        return scene, ()
    rows = np.flatnonzero(np.isin(scene.cameras.names, cameras.names))
    return scene.restricted_to(rows), warnings


def cameras_without_repeats(cameras: Cameras, points: FloatArray, images: Path) -> tuple[Cameras, tuple[str, ...]]:
    """As `without_repeats`, of cameras and the points that they see."""
    repeated = find_repeats(cameras, points, lambda index: load_thumbnail(images / cameras.names[index], THUMBNAIL_PX))
    rows = np.setdiff1d(np.arange(len(cameras)), list(repeated))
    named = {cameras.names[copy]: cameras.names[first] for copy, first in repeated.items()}
    return cameras.select(rows), copies_warning(named, len(cameras))


def _difference(first: NDArray[np.float32], second: NDArray[np.float32]) -> float:
    """Mean difference of two pictures at the size of the smaller."""
    size_wh = np.minimum(first.shape[1::-1], second.shape[1::-1])
    return float(np.abs(_reduce(first, size_wh) - _reduce(second, size_wh)).mean())


def _reduce(picture: NDArray[Any], size_wh: NDArray[Any]) -> NDArray[np.float32]:
    return np.asarray(cv2.resize(picture, (int(size_wh[0]), int(size_wh[1])), interpolation=cv2.INTER_AREA), np.float32)
