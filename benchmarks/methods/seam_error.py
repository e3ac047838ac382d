"""How much worse a model is along the borders of a plan than elsewhere.

Masks once per scene, plan and image, sums once per render. A pixel belongs to a band when the
surface it sees, x = world_from_cam · (z K⁻¹ (u, v, 1)), lies within half a band of a border,
measured horizontally, and to the nearest of all borders; what lies farther is the interior. Depths
z are the generator's or the centralised model's, never the judged model's own: all methods are
judged by the same pixels. A roof or facade counts by its own place, not by the ground it hides. Out
are the sky and pixels whose place is not known to half of half a band: along the edge of what hides
something else, depth mixes both. Inverse depth is affine over any plane, so there its second
differences
    |q(u−1) − 2 q(u) + q(u+1)| z² ‖horizontal part of K⁻¹ (u, v, 1)‖,  q = 1 / z, and likewise for v
are how far the place is unsure.

The headline is (band − interior) of a method minus that of a reference, usually the centralised
model: what is hard to learn along a border for any method cancels out.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.methods.device_borders import Borders
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.evaluate.borders import EdgeBorders
from radiant_core.evaluate.ground_places import depth_or_nan, ground_places, horizontal_rays
from radiant_core.evaluate.image_error import psnr_db_of_mse
from radiant_core.evaluate.image_pair import Used
from radiant_core.numerics import FloatArray
from radiant_core.plan.plans import CloudPlan

MIN_PIXELS = 20_000
MIN_IMAGES = 10
INTERIOR, UNCOUNTED = -1, -2
UNSURE_SHARE = 0.5
"""A pixel is out where its place is unsure by this share of half a band."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SeamMask:
    """Pixels of one image: labels (H,W), the number of the border whose band it is, -1 in the
    interior, -2 where it does not count."""

    labels: NDArray[np.int16]

    @property
    def band(self) -> NDArray[np.bool_]:
        """(H,W) near any border."""
        return self.labels >= 0

    @property
    def interior(self) -> NDArray[np.bool_]:
        """(H,W) far from all of them."""
        return self.labels == INTERIOR

    def within(self, used: Used) -> SeamMask:
        """Without the pixels that are not `used` (H,W); all of it for None."""
        return self if used is None else replace(self, labels=np.where(used, self.labels, np.int16(UNCOUNTED)))


@dataclass(frozen=True, kw_only=True, eq=False)
class SeamMasks:
    """One mask per image, and the names of the two regions of every border that one sees."""

    borders: tuple[tuple[str, str], ...]
    masks: tuple[SeamMask, ...]

    def __len__(self) -> int:
        return len(self.masks)

    def __iter__(self) -> Iterator[SeamMask]:
        return iter(self.masks)

    def within(self, used: Sequence[Used]) -> SeamMasks:
        """Without the pixels that are not `used` of each image."""
        return replace(self, masks=tuple(mask.within(pixels) for mask, pixels in zip(self.masks, used, strict=True)))


@dataclass(frozen=True, kw_only=True)
class SeamError:
    """PSNR over all band and all interior pixels of several images; None where they are too few."""

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


def seam_masks(
    cameras: Cameras, depths_m: Sequence[NDArray[np.floating]], borders: CloudPlan | Sequence[Borders], half_band_m: float
) -> SeamMasks:
    """Masks of C images from depths (H,W) along their camera's z axis; 0, NaN or infinite means no
    ground.

    `borders` are those between the edges of a plan, or several kinds, of which the nearest counts:
    `[EdgeBorders(…), DeviceBorders(…)]`. Raises BadInput when a depth is not of its camera's size
    or `half_band_m` not positive.
    """
    if not 0 < half_band_m < np.inf:
        raise BadInput(f"half_band_m is {half_band_m}, expected a positive width of the band beside a border.")
    if len(depths_m) != len(cameras):
        raise BadInput(f"{len(depths_m)} depth images come with {len(cameras)} cameras: give one each.")
    kinds = [EdgeBorders(plan=borders)] if isinstance(borders, CloudPlan) else list(borders)
    numbers: dict[tuple[str, str], int] = {}
    masks = tuple(_seam_mask(cameras, index, depth_m, kinds, half_band_m, numbers) for index, depth_m in enumerate(depths_m))
    return SeamMasks(borders=tuple(numbers), masks=masks)


def region_width(plan_sites: FloatArray) -> float:
    """Half the width of the band beside a border: 1/20 of the least distance between two edges."""
    gaps = np.linalg.norm(plan_sites[:, None] - plan_sites, axis=2)
    return float(gaps[gaps > 0].min()) / 20 if (gaps > 0).any() else 1.0


def band_and_interior_psnr_db(
    renders: Iterable[NDArray[np.floating]], photographs: Iterable[NDArray[np.floating]], masks: Iterable[SeamMask]
) -> SeamError:
    """PSNR near borders and elsewhere, pooled over images (H,W,3) in 0..1, given one at a time.

    A part has a figure from 20,000 pixels in 10 images on. Raises BadInput when a render,
    photograph and mask differ in size.
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
    """(2,3): squared error, pixels and images of the band and of the interior, over images (H,W,3)
    in 0..1 that come one at a time."""
    band, interior = np.zeros(3), np.zeros(3)
    for render, photograph, mask in zip(renders, photographs, masks, strict=True):
        squared = squared_errors(render, photograph, mask)
        band += _sums(squared, mask.band)
        interior += _sums(squared, mask.interior)
    return np.stack([band, interior])


def squared_errors(render: NDArray[np.floating], photograph: NDArray[np.floating], mask: SeamMask) -> FloatArray:
    """Mean over channels (H,W) of the squared difference of two images; BadInput when they and the
    mask differ in size."""
    if not render.shape == photograph.shape == (*mask.labels.shape, 3):
        raise BadInput(f"render {render.shape}, photograph {photograph.shape} and mask {mask.labels.shape} differ in size.")
    squared = ((np.asarray(render, np.float64) - photograph) ** 2).mean(axis=2)
    if not np.isfinite(squared[mask.labels != UNCOUNTED]).all():
        raise BadInput("a render or photograph has values that are not finite where it is to be scored: check the model it came from.")
    return squared


def _seam_mask(
    cameras: Cameras,
    index: int,
    depth_m: NDArray[np.floating],
    kinds: Sequence[Borders],
    half_band_m: float,
    numbers: dict[tuple[str, str], int],
) -> SeamMask:
    """The mask of one image; borders that are new get their number in `numbers`."""
    width, height = cameras.sizes_wh[index]
    if depth_m.shape != (height, width):
        raise BadInput(f"the depth of {cameras.names[index]!r} has shape {depth_m.shape}, expected ({height}, {width}).")
    places, unsure_m = _places(cameras, index, depth_m)
    counted = np.isfinite(places).all(axis=2) & (unsure_m <= UNSURE_SHARE * half_band_m)
    labels = np.full((height, width), UNCOUNTED, np.int16)
    labels[counted] = INTERIOR
    distance_m = np.full(int(counted.sum()), half_band_m)
    counted_labels = np.full(len(distance_m), INTERIOR, np.int16)
    for kind in kinds:
        nearest = kind.nearest(places[counted])
        nearer = np.flatnonzero((nearest.distance_m <= distance_m) & (nearest.pair[:, 0] >= 0))
        distance_m[nearer] = nearest.distance_m[nearer]
        pairs, pair_indices = np.unique(nearest.pair[nearer], axis=0, return_inverse=True)
        names = [(kind.names[a], kind.names[b]) for a, b in pairs]
        counted_labels[nearer] = np.array([numbers.setdefault(name, len(numbers)) for name in names], np.int16)[pair_indices.ravel()]
    labels[counted] = counted_labels
    return SeamMask(labels=labels)


def _places(cameras: Cameras, index: int, depth_m: NDArray[np.floating]) -> tuple[FloatArray, FloatArray]:
    """Horizontal place (H,W,2) of what a pixel sees, NaN without depth, and its error (H,W) m."""
    height, width = depth_m.shape
    depth, rays = depth_or_nan(depth_m), horizontal_rays(cameras, index, depth_m.shape)
    places = ground_places(cameras, index, depth_m)
    bends = np.zeros((height, width))
    inverse = 1 / depth
    for axis in (0, 1):
        padded = np.pad(inverse, [(1, 1) if a == axis else (0, 0) for a in (0, 1)], constant_values=np.nan)
        before, after = (np.delete(padded, (0, 1) if end else (-2, -1), axis=axis) for end in (0, 1))
        # At the rim of the picture and beside the sky one side is missing: nothing is said there.
        bends = np.fmax(bends, np.abs(before - 2 * inverse + after))
    return places, bends * depth**2 * np.linalg.norm(rays, axis=2)


def _sums(squared: FloatArray, mask: NDArray[np.bool_]) -> FloatArray:
    """Sum of squared errors, number of pixels, and 1 when there are any."""
    return np.array([squared[mask].sum(), mask.sum(), mask.any()], np.float64)


def _pooled_psnr_db(sums: FloatArray) -> float | None:
    squared, num_pixels, num_images = sums
    return psnr_db_of_mse(squared / num_pixels) if num_pixels >= MIN_PIXELS and num_images >= MIN_IMAGES else None
