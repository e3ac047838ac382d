"""What images will see of each border, and how much worse the joined model is likely to be there.

    support of a side = own images that see a spot of its half of the band, on average over
                        spots that any image sees
    coverage          = support / the same average over the rest of that region

"Own" are the images of that side's devices: only they train what the scene keeps of that half.
Overlaps are shares of an image's footprint that the best neighbour sees as well, along the flight
(forward) and beside it (side), the median over images that see the band. The weaker side's support
decides the risk. Over 23 borders of four runs of the sample town its rank correlation with the
measured loss is −0.25, that of coverage +0.45, the wrong way: coverage is reported and not used
(docs/experiments/borders.md). Once per plan; spots and images are sampled.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree  # pyright: ignore[reportMissingTypeStubs]

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.plan.borders.borders import Border, shared_borders
from radiant_core.plan.borders.buffers import EdgeBuffer
from radiant_core.plan.borders.footprints import MAX_CORNERS, Footprints, Views, common_areas_m2, sort_from_west
from radiant_core.plan.plans import CloudPlan

Risk = Literal["low", "medium", "high"]
"""How likely the border will show."""
SPOTS_ALONG, SPOTS_ACROSS = 16, (0.25, 0.75)
INTERIOR_SPOTS = 64
OVERLAP_IMAGES = 2000
"""Images whose overlaps are measured, over all borders, 4 to 24 for each."""
NEIGHBOURS = 32
_BLOCK = 16_384


@dataclass(frozen=True, kw_only=True)
class RiskModel:
    """Thresholds of the weaker side's support, in images per spot. Measured loss beyond a model of
    all images: 2.4 dB on average below the first, 1.2 dB between them, 1.4 dB above (7, 11 and 5
    borders): only `high` tells borders apart."""

    high_below: float = 3.25
    medium_below: float = 5.0

    def __post_init__(self) -> None:
        if not 0 <= self.high_below <= self.medium_below < np.inf:
            raise BadInput(f"thresholds of support are {self.high_below} and {self.medium_below}, expected rising numbers of images.")

    def risk(self, support: float) -> Risk:
        """The risk where the weaker side has this support."""
        return "high" if support < self.high_below else "medium" if support < self.medium_below else "low"


@dataclass(frozen=True, kw_only=True, eq=False)
class BorderForecast:
    """One border, its sides in the order of `edge_ids`; ends (2,2) m, half_band_m as in seams."""

    edge_ids: tuple[str, str]
    ends: FloatArray
    half_band_m: float
    num_images: tuple[int, int]
    """Images of each side's edge that see any spot of the band."""
    support: tuple[float, float]
    """Own images per spot of each side's half of the band."""
    interior_support: tuple[float, float]
    """The same over the rest of each region."""
    forward_overlap: float | None
    """None where no image that sees the band has a neighbour along (or beside) its flight."""
    side_overlap: float | None
    risk: Risk

    @property
    def coverage(self) -> float:
        """Support over that of the interior, of the worse side."""
        return min(_share(here, there) for here, there in zip(self.support, self.interior_support, strict=True))


def forecast_borders(
    plan: CloudPlan,
    views: Views,
    footprints: Footprints,
    *,
    half_band_m: float | None = None,
    buffers: Sequence[EdgeBuffer] = (),
) -> tuple[BorderForecast, ...]:
    """A forecast for every border of a plan whose P cameras have these views and footprints;
    half_band_m: half the width of the band, by default `band_of`. An edge's `buffers` count as its
    own images. Raises BadInput when their numbers differ or the band has no width."""
    if not len(plan.edge_of_camera) == len(views) == len(footprints):
        raise BadInput(f"the plan is of {len(plan.edge_of_camera)} cameras, there are {len(views)} views and {len(footprints)} footprints.")
    half_band_m = band_of(plan) if half_band_m is None else half_band_m
    if not (np.isfinite(half_band_m) and half_band_m > 0):
        raise BadInput(f"half_band_m is {half_band_m}, expected a positive width of the band beside a border.")
    borders = shared_borders(plan)
    buffer_images = {plan.edge_ids.index(buffer.edge_id): buffer.camera_indices for buffer in buffers}
    visibility = _Visibility(footprints, plan.edge_of_camera, buffer_images)
    interiors = [_interior_support(plan, visibility, edge, borders, half_band_m) for edge in range(len(plan.edge_ids))]
    tree: Any = KDTree(views.positions) if borders else None
    forecasts: list[BorderForecast] = []
    for border in borders:
        spots = _band_spots(border, half_band_m)
        supports, images = _supports(visibility, spots, (border.first, border.second))
        sampled = images[_evenly(len(images), int(np.clip(OVERLAP_IMAGES // len(borders), 4, 24)))]
        forward, side = _overlaps(views, footprints, tree, sampled)
        interior = (interiors[border.first], interiors[border.second])
        forecasts.append(
            BorderForecast(
                edge_ids=(plan.edge_ids[border.first], plan.edge_ids[border.second]),
                ends=border.ends,
                half_band_m=half_band_m,
                num_images=(int(visibility.taken_by(images, border.first).sum()), int(visibility.taken_by(images, border.second).sum())),
                support=supports,
                interior_support=interior,
                forward_overlap=forward,
                side_overlap=side,
                risk=RiskModel().risk(min(supports)),
            )
        )
    return tuple(forecasts)


def band_of(plan: CloudPlan) -> float:
    """Half the width of the band beside a border: a twentieth of the smallest distance between two
    edges, 1 m where there is none."""
    sites: FloatArray = np.unique(plan.sites, axis=0)
    if len(sites) < 2:
        return 1.0
    tree: Any = KDTree(sites)
    distances: FloatArray = tree.query(sites, k=2)[0]
    return float(distances[:, 1].min()) / 20


class _Visibility:
    """Which images see a spot: footprints sorted from west to east, so that few are tested."""

    def __init__(self, footprints: Footprints, edge_of_image: NDArray[np.int64], buffer_images: Mapping[int, NDArray[np.int64]]) -> None:
        self.footprints, self.edge_of_image, self.buffer_images = footprints, edge_of_image, buffer_images
        self.order, self.lows, self.highs = sort_from_west(footprints)
        self.widest_m = float((self.highs[:, 0] - self.lows[:, 0]).max(initial=0.0))

    def __call__(self, spots: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Images (K,) near the spots (S,2), and whether each sees each (K,S)."""
        low, high = spots.min(axis=0), spots.max(axis=0)
        near = slice(*np.searchsorted(self.lows[:, 0], [low[0] - self.widest_m, high[0]], side="right"))
        met = (self.highs[near] >= low).all(axis=1) & (self.lows[near] <= high).all(axis=1)
        images = np.sort(self.order[near][met])
        parts = [self._sees(images[start : start + _BLOCK], spots) for start in range(0, len(images), _BLOCK)]
        return images, np.concatenate([np.zeros((0, len(spots)), bool), *parts])

    def taken_by(self, images: NDArray[np.int64], edge: int) -> NDArray[np.bool_]:
        """Which of the images (K,) the devices of an edge take."""
        planned = self.edge_of_image[images] == edge
        return np.logical_or(planned, np.isin(images, self.buffer_images[edge])) if edge in self.buffer_images else planned

    def _sees(self, images: NDArray[np.int64], spots: FloatArray) -> NDArray[np.bool_]:
        corners = self.footprints.polygons[images] - spots[0]
        sides = np.roll(corners, -1, axis=1) - corners
        local = spots - spots[0]
        inside = np.ones((len(images), len(spots)), bool)
        for corner in range(MAX_CORNERS):
            x, y = corners[:, corner, 0, None], corners[:, corner, 1, None]
            across, along = sides[:, corner, 0, None], sides[:, corner, 1, None]
            inside &= across * (local[:, 1] - y) - along * (local[:, 0] - x) >= 0
        return inside


def _band_spots(border: Border, half_band_m: float) -> FloatArray:
    """Spots (2S,2): S in the first side's half of the band, S in the second's."""
    shares = (np.arange(SPOTS_ALONG) + 0.5) / SPOTS_ALONG
    along = border.ends[0] + shares[:, None] * (border.ends[1] - border.ends[0])
    offsets = [sign * across * half_band_m * border.toward_first for sign in (1, -1) for across in SPOTS_ACROSS]
    return np.concatenate([along + offset for offset in offsets])


def _supports(visibility: _Visibility, spots: FloatArray, edges: tuple[int, int]) -> tuple[tuple[float, float], NDArray[np.int64]]:
    """Own images per spot of each half, and the images of both edges that see any spot."""
    images, sees = visibility(spots)
    used: NDArray[np.bool_] = np.any(sees, axis=0)
    half = len(spots) // 2
    halves = (slice(half), slice(half, None))
    supports = [
        _mean(_numbers(sees, visibility.taken_by(images, edge))[part][used[part]]) for edge, part in zip(edges, halves, strict=True)
    ]
    by_either = visibility.taken_by(images, edges[0]) | visibility.taken_by(images, edges[1])
    return (supports[0], supports[1]), images[np.any(sees, axis=1) & by_either]


def _interior_support(plan: CloudPlan, visibility: _Visibility, edge: int, borders: Sequence[Border], half_band_m: float) -> float:
    """Own images per spot of a region outside its bands, where its own images look; 0 without."""
    rows = np.flatnonzero((plan.edge_of_camera == edge) & (visibility.footprints.areas_m2 > 0))
    middles = visibility.footprints.polygons[rows].mean(axis=1)
    distances = [border.distances_m(middles) for border in borders if edge in (border.first, border.second)]
    outside = np.min(distances, axis=0) > half_band_m if distances else np.ones(len(rows), bool)
    spots = middles[outside] if outside.any() else middles
    spots = spots[_evenly(len(spots), INTERIOR_SPOTS)]
    if not len(spots):
        return 0.0
    images, sees = visibility(spots)
    return _mean(_numbers(sees, visibility.taken_by(images, edge)))


def _overlaps(views: Views, footprints: Footprints, tree: Any, images: NDArray[np.int64]) -> tuple[float | None, float | None]:
    """Median over images of the share that the best neighbour along, or beside, sees as well."""
    best: tuple[list[float], list[float]] = ([], [])
    if not len(images):
        return None, None
    near: NDArray[np.int64] = tree.query(views.positions[images], k=range(1, min(NEIGHBOURS, len(views)) + 1))[1]
    rays = views.corner_rays[images]
    tops = (rays[:, 0] + rays[:, 1] - rays[:, 2] - rays[:, 3])[:, :2]
    for image, others, top in zip(images.tolist(), near, tops, strict=True):
        steps = views.positions[others] - views.positions[image]
        moved = np.linalg.norm(steps, axis=1) > 0
        along = np.abs(steps @ top) >= np.abs(steps @ np.array([top[1], -top[0]]))
        polygon = _without_repeats(footprints.polygons[image])
        shares = common_areas_m2(footprints.polygons[others], polygon) / footprints.areas_m2[image]
        for kind, mask in enumerate((moved & along, moved & ~along)):
            if mask.any():
                best[kind].append(float(shares[mask].max()))
    forward, side = (float(np.median(values)) if values else None for values in best)
    return forward, side


def _without_repeats(polygon: FloatArray) -> FloatArray:
    return polygon[(polygon != np.roll(polygon, 1, axis=0)).any(axis=1)]


def _share(here: float, there: float) -> float:
    return here / there if there > 0 else 0.0


def _numbers(sees: NDArray[np.bool_], is_own: NDArray[np.bool_]) -> NDArray[np.int64]:
    """How many of the own images (K,) see each spot (S,)."""
    return np.asarray(np.count_nonzero(sees & is_own[:, None], axis=0), np.int64)


def _mean(values: NDArray[np.int64]) -> float:
    return float(values.mean()) if len(values) else 0.0


def _evenly(count: int, at_most: int) -> NDArray[np.int64]:
    """At most `at_most` indices below `count`, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(count, at_most)).round().astype(np.int64)) if count else np.zeros(0, np.int64)
