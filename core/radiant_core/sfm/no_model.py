"""Why photographs came to no model, in one sentence. Once, where structure from motion found none.

Asked in this order: are they one picture, do they show anything, do they overlap, are they from
more than one place.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.io.photos.listing import Photograph, load_thumbnail
from radiant_core.sfm.colmap.calls import pycolmap
from radiant_core.sfm.colmap.epipolar import MIN_MATCHES
from radiant_core.sfm.copies import SAME_PICTURE

COMPARED_PX = 64
MAX_COMPARED = 400
"""Each is compared with every picture that differs from those before: at most 80,000 times."""
FEW_FEATURES = 100
"""Photographs with fewer show sky, water or fog, or are out of focus."""


def no_model(photographs: Sequence[Photograph], folder: Path, read_from: Path, database: Path) -> BadInput:
    """The error for photographs that no model came of; `read_from` holds their pictures and
    `database` their features and matches."""
    number = len(photographs)
    pictures = _different_pictures([read_from / photo.name for photo in photographs[:MAX_COMPARED]])
    if number <= MAX_COMPARED and pictures < min(3, number):
        return BadInput(
            f"the {number} photographs in {folder} are the same picture saved again ({pictures} different of {number}): "
            "give photographs of one place from several places."
        )
    features, verified = _counts(database)
    poor = sum(count < FEW_FEATURES for count in features)
    if features and poor > number / 2:
        return BadInput(
            f"{poor} of the {number} photographs in {folder} show too little: fewer than {FEW_FEATURES} points stand out in each, "
            "as in sky, water, fog or a picture of little contrast. Give others."
        )
    if verified >= number - 1 and number > 2:
        return BadInput(
            f"the {number} photographs in {folder} overlap ({verified} pairs do), but no two of them fix a place: they are taken from one "
            "place, or their tags say wrong focal lengths. Take photographs from several places, with one lens."
        )
    return BadInput(
        f"the {number} photographs in {folder} do not overlap enough for structure "
        "from motion: take photographs of one place in which neighbours share more than half of their view."
    )


def _different_pictures(paths: Sequence[Path]) -> int:
    different: list[NDArray[np.float32]] = []
    for path in paths:
        picture = _small(load_thumbnail(path, COMPARED_PX))
        if all(np.abs(picture - earlier).mean() >= SAME_PICTURE for earlier in different):
            different.append(picture)
    return len(different)


def _small(picture: NDArray[np.uint8]) -> NDArray[np.float32]:
    return np.asarray(cv2.resize(picture, (COMPARED_PX, COMPARED_PX), interpolation=cv2.INTER_AREA), np.float32)


def _counts(database: Path) -> tuple[list[int], int]:
    """Features of each photograph, and the number of pairs whose matches fit one geometry."""
    if not database.is_file():
        return [], 0
    with pycolmap.Database.open(database) as store:
        features = [
            len(store.read_keypoints(image.image_id)) if store.exists_keypoints(image.image_id) else 0 for image in store.read_all_images()
        ]
        verified = sum(len(geometry.inlier_matches) >= MIN_MATCHES for geometry in store.read_two_view_geometries()[1])
    return features, verified
