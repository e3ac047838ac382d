"""Photographs as training views. Once per device."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.io.photos.listing import load_photograph_bytes
from radiant_core.io.photos.masks import pixel_weights
from radiant_core.train.views import TrainingViews


def load_images(folder: Path, cameras: Cameras) -> tuple[NDArray[np.uint8], ...]:
    """Read photographs by the names of their cameras.

    Args:
        folder: the folder of the photographs.
        cameras: their names and sizes.

    Returns:
        A photograph (H,W,3) in 8 bits per camera, reduced to the camera's size.

    Raises:
        BadInput: a photograph is missing or damaged.
    """
    return tuple(
        load_photograph_bytes(folder / name, (int(width), int(height)))
        for name, (width, height) in zip(cameras.names, cameras.sizes_wh, strict=True)
    )


def load_training_views(images: Path, cameras: Cameras, masks: Path | None = None) -> TrainingViews:
    """The photographs of `cameras` by name, reduced to their sizes, with what masks leave."""
    return TrainingViews(cameras=cameras, images=load_images(images, cameras), weights=pixel_weights(masks, cameras))
