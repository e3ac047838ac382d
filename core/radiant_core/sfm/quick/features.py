"""SIFT features of one photograph by OpenCV, as COLMAP's database holds them. Once per photograph.

The same features as COLMAP's own, from twice the photograph's size down, in a quarter of the time:
OpenCV's scale space has vector instructions, VLFeat's does not (docs/experiments/sfm.md). Of those
found the largest are kept, as COLMAP does: they are found again from farther away. COLMAP counts
pixels from the corner of the first one, OpenCV from its middle.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.io.photos.listing import MAX_FILE_BYTES, decode_image, read_size_wh
from radiant_core.io.run_store import read_bounded
from radiant_core.sfm.quick.descriptors import NUM_BYTES, Descriptors, root_descriptors

CONTRAST = 0.02
"""Least contrast of a feature, as OpenCV counts it: over the three layers of an octave 0.0067, that
of COLMAP."""
EDGE = 10.0
LAYERS = 3
JPEG_SIGNATURE = b"\xff\xd8"
FOUND_PER_KEPT = 2
"""OpenCV describes this many of the strongest for each one kept: of all it finds, up to three times
as many, most are so small that they are dropped."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Features:
    """Keypoints (N,4) float32: x, y px from the corner, scale px, orientation rad; descriptors
    (N,128)."""

    keypoints: NDArray[np.float32]
    descriptors: Descriptors


def find_features(path: Path, max_side_px: int, most: int, mask: NDArray[np.uint8] | None = None) -> Features:
    """Up to `most` features of the photograph at `path`, reduced to a long side of `max_side_px`;
    none where `mask` (H,W), of the photograph's size, is 0. BadInput where it cannot be decoded."""
    grey, factor = _decode(path, max_side_px)
    # The last column of a picture at half size may stand for half a pixel: twice the width, not it.
    decoded_wh = factor * np.array(grey.shape[1::-1], np.float64)
    if max(grey.shape) > max_side_px:
        width, height = (max(1, round(side * max_side_px / max(grey.shape))) for side in grey.shape[1::-1])
        grey = np.asarray(cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    if mask is not None and mask.shape != grey.shape:
        mask = np.asarray(cv2.resize(mask, grey.shape[1::-1], interpolation=cv2.INTER_NEAREST), np.uint8)
    return _scaled(_detect(grey, most, mask), decoded_wh / grey.shape[1::-1])


def _decode(path: Path, max_side_px: int) -> tuple[NDArray[np.uint8], int]:
    """The photograph in grey and how many of its pixels one of those is wide: a JPEG that is to be
    reduced to less than half is decoded at half its size."""
    data = read_bounded(path, MAX_FILE_BYTES) if path.is_file() else b""
    halved = data.startswith(JPEG_SIGNATURE) and max(read_size_wh(data) or (0, 0)) >= 2 * max_side_px
    flags = cv2.IMREAD_REDUCED_GRAYSCALE_2 if halved else cv2.IMREAD_GRAYSCALE
    grey = decode_image(data, flags | cv2.IMREAD_IGNORE_ORIENTATION)
    if grey is None:
        raise BadInput(f"the photograph {path} is not whole or cannot be decoded: remove it or fetch it again.")
    return np.asarray(grey, np.uint8), 2 if halved else 1


def _detect(grey: NDArray[np.uint8], most: int, mask: NDArray[np.uint8] | None) -> Features:
    shape = LAYERS, CONTRAST, EDGE, 1.6, cv2.CV_32F, True
    sift = cv2.SIFT_create(FOUND_PER_KEPT * most, *shape)  # pyright: ignore
    points, histograms = sift.detectAndCompute(grey, mask)
    if not points:
        return Features(keypoints=np.zeros((0, 4), np.float32), descriptors=np.zeros((0, NUM_BYTES), np.uint8))
    sizes = np.array([point.size for point in points])
    # Equal ones, such as the two orientations of a feature, in the order found.
    largest = np.argsort(-sizes, kind="stable")[:most]
    rows = [(points[i].pt[0] + 0.5, points[i].pt[1] + 0.5, points[i].size / 2, np.radians(points[i].angle)) for i in largest.tolist()]
    return Features(keypoints=np.array(rows, np.float32), descriptors=root_descriptors(np.asarray(histograms, np.float32)[largest]))


def _scaled(features: Features, factors_xy: NDArray[np.float64]) -> Features:
    """The features of the photograph from those of its reduced picture."""
    scale = float(np.sqrt(np.prod(factors_xy)))
    factors = np.array([*factors_xy, scale, 1.0])
    return Features(keypoints=(features.keypoints * factors).astype(np.float32), descriptors=features.descriptors)
