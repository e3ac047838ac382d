"""Where the chunks of a model with levels of detail end: regions, and halved cells in each. Once
per export.

A Gaussian belongs to the region that claims its place, or to the far field: sky and horizon, which
are drawn whole from everywhere. Cells are halved at fixed planes, at 0, then at ±R/2, ±R/4 …
for each axis in turn, R a power of two: a plane that parts nothing is passed over, so that R does
not matter, and what changes in one place moves no border in another.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array
from radiant_core.plan.regions.claims import claims_of_polygons
from radiant_core.splats import Splats

FAR = -1
"""The number of the far field among regions."""
REACH = 1.5
"""A region reaches so many diagonals of its box from its middle; farther is the far field."""
INNER_PERCENT = 5.0
"""Of a model without a plan: what lies in the middle of each axis but for so much at either end is
its box."""
SMALLEST_CELL = 2.0**-20
"""Of the whole: Gaussians nearer together are not parted."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LodRegion:
    """Land of its own chunks: polygon (V,2) m, empty where it is all land; the middle (3,) m, and
    how far from it its Gaussians lie."""

    polygon: FloatArray
    middle: FloatArray
    reach_m: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "polygon", check_array("polygon", self.polygon, (None, 2)))
        object.__setattr__(self, "middle", check_array("middle", self.middle, (3,)))
        if not self.reach_m > 0:
            raise BadInput(f"a region reaches {self.reach_m} m, expected a positive distance.")


@dataclass(frozen=True, kw_only=True, eq=False)
class Cell:
    """A cell of the tree: its Gaussians (K,), and the two halves unless it is a leaf."""

    rows: NDArray[np.int64]
    halves: tuple[Cell, ...] = ()

    def leaves(self) -> Iterator[Cell]:
        """The leaves, in the order of the tree."""
        if not self.halves:
            yield self
        for half in self.halves:
            yield from half.leaves()


def region_of_polygon(polygon: FloatArray, height_m: float) -> LodRegion:
    """The region of a polygon (V,2) m that cameras look at from `height_m`."""
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    reach_m = REACH * float(np.linalg.norm(high - low))
    return LodRegion(polygon=polygon, middle=np.array([*(low + high) / 2, height_m]), reach_m=max(reach_m, np.finfo(float).tiny))


def whole_region(means: NDArray[np.floating]) -> LodRegion:
    """The one region of a model without a plan, about the middle of its Gaussians (N,3) m."""
    if not len(means):
        raise BadInput("the model has no Gaussians: there is nothing to divide into levels of detail.")
    exact = np.asarray(means, np.float64)
    low, high = np.percentile(exact, [INNER_PERCENT, 100 - INNER_PERCENT], axis=0)
    reach_m = REACH * float(np.linalg.norm(high - low))
    # A few Gaussians in one place have no extent: then nothing is far.
    return LodRegion(polygon=np.zeros((0, 2)), middle=np.median(exact, axis=0), reach_m=reach_m or np.inf)


def regions_of_splats(splats: Splats, regions: Sequence[LodRegion]) -> NDArray[np.int64]:
    """The region (N,) of each of N Gaussians, `FAR` beyond its reach; where polygons overlap the
    last one has it."""
    if not regions:
        raise BadInput("no regions were given to divide a model by: pass one at least.")
    means = splats.means.astype(np.float64)
    # Claims are of the first polygon, and one that is added later takes land over.
    claims = claims_of_polygons([region.polygon for region in reversed(regions)])
    number = np.zeros(len(splats), np.int64) if claims is None else len(regions) - 1 - claims(means[:, :2])
    middles, reaches = np.stack([region.middle for region in regions]), np.array([region.reach_m for region in regions])
    away = np.linalg.norm(means - middles[number], axis=1)
    return np.where(away <= reaches[number], number, FAR)


def divide(means: FloatArray, rows: NDArray[np.int64], ends: Callable[[NDArray[np.int64]], bool]) -> Cell:
    """The tree of halved cells over rows (K,) of means (N,3), in which cells are leaves where
    `ends` says so, or all is in one place."""
    reach = float(np.abs(means[rows]).max(initial=0.0))
    size = 2.0 ** np.ceil(np.log2(reach)) if reach > 0 else 1.0
    return _divide(means, rows, ends, np.full(3, -size), 2 * size * np.ones(3), 0)


def _divide(
    means: FloatArray, rows: NDArray[np.int64], ends: Callable[[NDArray[np.int64]], bool], low: FloatArray, sides: FloatArray, axis: int
) -> Cell:
    smallest = SMALLEST_CELL * float(sides.max())
    while not ends(rows) and sides.max() > smallest:
        half = sides.copy()
        half[axis] /= 2
        plane = low[axis] + half[axis]
        above = means[rows, axis] >= plane
        upper = low.copy()
        upper[axis] = plane
        following = (axis + 1) % 3
        if above.any() and not above.all():
            lower_half = _divide(means, rows[~above], ends, low, half, following)
            return Cell(rows=rows, halves=(lower_half, _divide(means, rows[above], ends, upper, half, following)))
        low, sides, axis = (upper if above.any() else low), half, following
    return Cell(rows=rows)


def ellipsoid_box(means: FloatArray, covariance: FloatArray, deviations: float) -> FloatArray:
    """The box (2,3) about the ellipsoids at so many standard deviations of Gaussians with means
    (N,3) and covariances (N,3,3)."""
    half = deviations * np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    return np.stack([(means - half).min(axis=0), (means + half).max(axis=0)])
