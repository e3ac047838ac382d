"""Rays of photographs in a field's unit coordinates, and the colours that they should have.

    direction = R^T K⁻¹ (x + ½, y + ½, 1), of length 1        origin = camera's centre

A step draws its rays evenly from all pixels that count. Once per step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from benchmarks.fields.bounds import FieldBounds
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.train.views import TrainingViews

MIN_WEIGHT = 128
"""A pixel whose weight is below half is not drawn."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Rays:
    """R rays in unit coordinates."""

    origins: Tensor
    """(R,3)."""
    directions: Tensor
    """(R,3), of length 1."""
    near: Tensor
    """(R,)."""
    far: Tensor
    """(R,)."""
    views: Tensor
    """(R,) int64: which camera each is of."""

    def __len__(self) -> int:
        return len(self.origins)

    def select(self, rows: Tensor | slice) -> Rays:
        """Some of the rays, by index, mask or range."""
        return Rays(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})

    def to(self, device: torch.device) -> Rays:
        """The same rays on that device."""
        return Rays(**{field.name: getattr(self, field.name).to(device) for field in fields(self)})


def rays_of(cameras: Cameras, bounds: FieldBounds, views: NDArray[np.int64], pixels: NDArray[np.int64]) -> Rays:
    """Rays through the middles of `pixels` (R,2), column and row, of cameras at `views` (R,)."""
    centers = bounds.unit(cameras.centers)[views]
    Ks, rotations = cameras.Ks[views], cameras.cam_from_world[views, :3, :3]
    in_camera = np.column_stack(
        [
            (pixels[:, 0] + 0.5 - Ks[:, 0, 2]) / Ks[:, 0, 0],
            (pixels[:, 1] + 0.5 - Ks[:, 1, 2]) / Ks[:, 1, 1],
            np.ones(len(pixels)),
        ]
    )
    directions = np.einsum("rji,rj->ri", rotations, in_camera)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins, along = torch.from_numpy(centers), torch.from_numpy(directions)
    near, far = bounds.span(origins, along)
    return Rays(origins=origins.float(), directions=along.float(), near=near.float(), far=far.float(), views=torch.from_numpy(views))


def rays_of_image(cameras: Cameras, bounds: FieldBounds, view: int) -> Rays:
    """All rays of one camera, row by row."""
    width, height = (int(side) for side in cameras.sizes_wh[view])
    rows, columns = np.divmod(np.arange(height * width), width)
    return rays_of(cameras, bounds, np.full(height * width, view), np.column_stack([columns, rows]))


@dataclass(frozen=True, kw_only=True, eq=False)
class PixelRays:
    """The pixels of photographs to fit, as rays on demand: Q pixels of V views."""

    cameras: Cameras
    bounds: FieldBounds
    pixels: NDArray[np.int32]
    """(Q,3) view, column and row."""
    colors: NDArray[np.uint8]
    """(Q,3)."""

    def __post_init__(self) -> None:
        if not len(self.pixels):
            raise BadInput("a field was given no pixel to learn from: give photographs that their masks do not cover.")

    def __len__(self) -> int:
        return len(self.pixels)

    @staticmethod
    def of(views: TrainingViews, bounds: FieldBounds) -> PixelRays:
        """All pixels of the views that count."""
        counting = [_counting_pixels(views, view) for view in range(len(views))]
        return PixelRays(
            cameras=views.cameras,
            bounds=bounds,
            pixels=np.concatenate([pixels for pixels, _ in counting]),
            colors=np.concatenate([colors for _, colors in counting]),
        )

    def batch(self, rows: NDArray[np.int64]) -> tuple[Rays, Tensor]:
        """Rays and colours (R,3) in 0..1 of the pixels at `rows` (R,)."""
        chosen = self.pixels[rows].astype(np.int64)
        rays = rays_of(self.cameras, self.bounds, chosen[:, 0], chosen[:, 1:])
        return rays, torch.from_numpy(self.colors[rows].astype(np.float32) / 255)

    def select(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> PixelRays:
        """Some of the pixels, by mask (Q,) or index. BadInput where none is left."""
        return PixelRays(cameras=self.cameras, bounds=self.bounds, pixels=self.pixels[rows], colors=self.colors[rows])

    def of_views(self, views: Sequence[int] | NDArray[np.int64]) -> PixelRays:
        """The pixels of some of the views. BadInput where none is left."""
        return self.select(np.isin(self.pixels[:, 0], np.asarray(views)))


def _counting_pixels(views: TrainingViews, view: int) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
    image = np.asarray(views.images[view])
    counts = np.ones(image.shape[:2], bool) if views.weights is None else np.asarray(views.weights[view]) >= MIN_WEIGHT
    rows, columns = np.nonzero(counts)
    return np.column_stack([np.full(len(rows), view), columns, rows]).astype(np.int32), image[rows, columns]
