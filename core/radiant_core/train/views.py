"""`TrainingViews`: photographs on a device or synthetic views at an edge. V views."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.scene import SfmScene
from radiant_core.train.stored_images import Images, concatenate_images, select_images, shapes_of


@dataclass(frozen=True, kw_only=True, eq=False)
class TrainingViews:
    """V cameras with images (H,W,3) uint8 and weights (H,W) uint8 (255 is 1) or none, of any sizes.
    A weight is the confidence in a pixel of a synthetic view, or what a mask leaves of it; pixels
    of weight 0 are not compared. BadInput unless sizes agree."""

    cameras: Cameras
    images: Images
    weights: Images | None = None

    def __post_init__(self) -> None:
        if len(self.images) != len(self.cameras) or not len(self.cameras):
            raise BadInput(f"{len(self.images)} images for {len(self.cameras)} cameras: give one image per camera, at least one.")
        shapes = shapes_of(self.images)
        for index, (name, (width, height)) in enumerate(zip(self.cameras.names, self.cameras.sizes_wh, strict=True)):
            kind = self.images[index].dtype if isinstance(self.images, tuple) else np.dtype(np.uint8)
            if shapes[index] != (height, width, 3) or kind != np.uint8:
                raise BadInput(f"image {name!r} is {shapes[index]} {kind}, expected ({height}, {width}, 3) uint8.")
        if self.weights is not None and list(shapes_of(self.weights)) != [shape[:2] for shape in shapes]:
            raise BadInput("weights and images differ in size: give one weight per pixel.")

    def __len__(self) -> int:
        return len(self.cameras)

    def __repr__(self) -> str:
        return f"TrainingViews({self.cameras!r}{', weighted' if self.weights is not None else ''})"

    def observed_pixels(self, scene: SfmScene) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """`SfmScene.observed_pixels` of these views' scene, without pixels of weight below half."""
        rows, pixels = scene.observed_pixels(self.cameras)
        if self.weights is None:
            return rows, pixels
        counts = [2 * int(self.weights[view][y, x]) > 255 for view, (x, y) in zip(scene.observations[rows, 1], pixels, strict=True)]
        return rows[counts], pixels[counts]

    def select(self, indices: NDArray[np.integer] | list[int]) -> TrainingViews:
        """Some of the views, in the given order; the images are shared."""
        weights = None if self.weights is None else select_images(self.weights, indices)
        return TrainingViews(cameras=self.cameras.select(np.asarray(indices)), images=select_images(self.images, indices), weights=weights)

    def scaled(self, scale: float) -> TrainingViews:
        """The views at that share (0 to 1) of their size, pixels averaged."""
        longest = max(max(shape[:2]) for shape in shapes_of(self.images))
        cameras = self.cameras.scaled(max(1, round(scale * longest)))
        sizes = [(int(width), int(height)) for width, height in cameras.sizes_wh]
        weights = None if self.weights is None else tuple(map(_reduce, self.weights, sizes))
        return TrainingViews(cameras=cameras, images=tuple(map(_reduce, self.images, sizes)), weights=weights)


def _reduce(image: NDArray[np.uint8], size_wh: tuple[int, int]) -> NDArray[np.uint8]:
    return np.asarray(cv2.resize(image, size_wh, interpolation=cv2.INTER_AREA), np.uint8)


def concatenate_views(parts: list[TrainingViews]) -> TrainingViews:
    """All views of `parts` in order; either all of them have weights or none."""
    from radiant_core.cameras import concatenate_cameras

    weights = [part.weights for part in parts if part.weights is not None]
    return TrainingViews(
        cameras=concatenate_cameras([part.cameras for part in parts]),
        images=concatenate_images([part.images for part in parts]),
        weights=concatenate_images(weights) if len(weights) == len(parts) else None,
    )
