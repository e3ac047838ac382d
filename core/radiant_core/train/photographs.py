"""Photographs as training views. Once per device."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.io.photos.listing import load_photograph
from radiant_core.io.photos.masks import pixel_weights
from radiant_core.train.views import TrainingViews


def load_images(folder: Path, cameras: Cameras) -> tuple[NDArray[np.uint8], ...]:
    """The photographs (H,W,3) of `cameras` by name, reduced to the cameras' sizes."""
    return tuple(
        (load_photograph(folder / name, (int(width), int(height))) * 255).round().astype(np.uint8)
        for name, (width, height) in zip(cameras.names, cameras.sizes_wh, strict=True)
    )


def load_training_views(images: Path, cameras: Cameras, masks: Path | None = None) -> TrainingViews:
    """The photographs of `cameras` by name, at the cameras' sizes, with what masks leave."""
    return TrainingViews(cameras=cameras, images=load_images(images, cameras), weights=pixel_weights(masks, cameras))
