"""How much worse a model is along the inner borders of a plan than elsewhere. Runs once per held-out image.

A pixel belongs to the band when the ground under it, x = world_from_cam · (z K⁻¹ (u, v, 1)), lies within half a band of a
border between two regions. Regions are cells of a power diagram (sites P, weights w), so that the distance of x in cell i to
its border is
    min over j ≠ i of (‖x − Pj‖² − wj − ‖x − Pi‖² + wi) / (2‖Pi − Pj‖)
exactly, without a search through polygons: a half-plane that does not touch the cell is never the nearest.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.evaluate.image_error import psnr_db_of_mse
from radiant_core.numerics import FloatArray
from radiant_core.plan.plans import CloudPlan

MIN_PIXELS = 20_000
MIN_IMAGES = 10


@dataclass(frozen=True, kw_only=True, eq=False)
class SeamMask:
    """Pixels of one image: band (H,W) near an inner border, interior (H,W) the others; the sky, without depth, is in neither."""

    band: NDArray[np.bool_]
    interior: NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class SeamError:
    """PSNR over all band and all interior pixels of several images; None where they are too few to say."""

    seam_psnr_db: float | None
    interior_psnr_db: float | None
    num_band_pixels: int
    num_band_images: int
    """Images with at least one band pixel."""

    @property
    def reason(self) -> str | None:
        """Why the seam has no figure, or None when it has one."""
        if self.seam_psnr_db is not None:
            return None
        return (
            f"insufficient: {self.num_band_pixels} pixels in {self.num_band_images} images lie near a border,"
            f" at least {MIN_PIXELS} in {MIN_IMAGES} are needed"
        )


def border_distance_m(points_xy: FloatArray, plan: CloudPlan) -> FloatArray:
    """Distance (P,) of ground positions (P,2) to the border of the region they lie in; inf with one region."""
    sites = plan.sites
    powers = ((points_xy[:, None] - sites) ** 2).sum(axis=2) - plan.weights
    own = powers.argmin(axis=1)
    spacing = np.linalg.norm(sites[:, None] - sites, axis=2)
    gaps = np.full(powers.shape, np.inf)
    # Two regions at one site have no border between them: the heavier one owns everything.
    apart = spacing[own] > 0
    np.divide(powers - powers.min(axis=1, keepdims=True), 2 * spacing[own], out=gaps, where=apart)
    return gaps.min(axis=1)


def seam_masks(cameras: Cameras, depths_m: Sequence[NDArray[np.floating]], plan: CloudPlan, half_band_m: float) -> tuple[SeamMask, ...]:
    """Masks of C images from their depths, C arrays (H,W) along the camera's z axis; 0, NaN or infinite means no ground.

    Raises BadInput when a depth does not have its camera's size or `half_band_m` is not positive.
    """
    if not half_band_m > 0:
        raise BadInput(f"half_band_m is {half_band_m}, expected a positive width of the band beside a border.")
    if len(depths_m) != len(cameras):
        raise BadInput(f"{len(depths_m)} depth images come with {len(cameras)} cameras: give one each.")
    return tuple(_seam_mask(cameras, index, depth_m, plan, half_band_m) for index, depth_m in enumerate(depths_m))


def band_and_interior_psnr_db(
    renders: Iterable[NDArray[np.floating]], photographs: Iterable[NDArray[np.floating]], masks: Iterable[SeamMask]
) -> SeamError:
    """PSNR of the pixels near borders and of the others, pooled over images (H,W,3) in 0..1 that come one at a time.

    A part has a figure from 20,000 pixels in 10 images on. Raises BadInput when a render, photograph and mask differ in size.
    """
    return pooled_seam_error([seam_sums(renders, photographs, masks)])


def pooled_seam_error(sums: Iterable[FloatArray]) -> SeamError:
    """The figures of several `seam_sums`, which machines that keep their photographs can send."""
    band, interior = np.sum([np.zeros((2, 3)), *sums], axis=0)
    return SeamError(
        seam_psnr_db=_pooled_psnr_db(band),
        interior_psnr_db=_pooled_psnr_db(interior),
        num_band_pixels=int(band[1]),
        num_band_images=int(band[2]),
    )


def seam_sums(
    renders: Iterable[NDArray[np.floating]], photographs: Iterable[NDArray[np.floating]], masks: Iterable[SeamMask]
) -> FloatArray:
    """(2,3): squared error, pixels and images of the band and of the interior, over images (H,W,3) in 0..1 that come one at a time."""
    band, interior = np.zeros(3), np.zeros(3)
    for render, photograph, mask in zip(renders, photographs, masks, strict=True):
        if not render.shape == photograph.shape == (*mask.band.shape, 3):
            raise BadInput(f"render {render.shape}, photograph {photograph.shape} and mask {mask.band.shape} differ in size.")
        squared = ((np.asarray(render, np.float64) - photograph) ** 2).mean(axis=2)
        band += _sums(squared, mask.band)
        interior += _sums(squared, mask.interior)
    return np.stack([band, interior])


def _seam_mask(cameras: Cameras, index: int, depth_m: NDArray[np.floating], plan: CloudPlan, half_band_m: float) -> SeamMask:
    width, height = cameras.sizes_wh[index]
    if depth_m.shape != (height, width):
        raise BadInput(f"the depth of {cameras.names[index]!r} has shape {depth_m.shape}, expected ({height}, {width}).")
    seen = np.isfinite(depth_m) & (depth_m > 0)
    rows, columns = np.nonzero(seen)
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], axis=1)
    in_camera = pixels @ np.linalg.inv(cameras.Ks[index]).T * depth_m[seen][:, None]
    in_world = (in_camera - cameras.cam_from_world[index, :3, 3]) @ cameras.cam_from_world[index, :3, :3]
    band = np.zeros((height, width), bool)
    band[rows, columns] = border_distance_m(in_world[:, :2], plan) <= half_band_m
    return SeamMask(band=band, interior=seen & ~band)


def _sums(squared: FloatArray, mask: NDArray[np.bool_]) -> FloatArray:
    """Sum of squared errors, number of pixels, and 1 when there are any."""
    return np.array([squared[mask].sum(), mask.sum(), mask.any()], np.float64)


def _pooled_psnr_db(sums: FloatArray) -> float | None:
    squared, num_pixels, num_images = sums
    return psnr_db_of_mse(squared / num_pixels) if num_pixels >= MIN_PIXELS and num_images >= MIN_IMAGES else None
