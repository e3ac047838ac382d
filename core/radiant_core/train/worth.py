"""Which photographs add nothing to a training: repeats and blurred ones. Once per run.

    sharpness of photograph v = exp(½ median over its sparse points p of
                                [log e(v,p) − median over the other u that see p of log e(u,p)])

e(v,p) is the mean squared brightness gradient around p: photographs are compared where they show
the same, so that one of a lawn does not count as blurred. 1 is as sharp as the others. A repeat was
taken from the place and in the direction of another, with hardly any difference.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from radiant_core.decisions import Decision
from radiant_core.numerics import FloatArray
from radiant_core.regimes import BLUR, REPEATS, SHARPNESS, require
from radiant_core.scene import SfmScene
from radiant_core.sfm.copies import find_repeats as find_repeated_pictures
from radiant_core.train.config import TrainConfig
from radiant_core.train.views import TrainingViews

WINDOW_PX = 15
MIN_GRADIENT = 1.0
"""Brightness steps per pixel that are noise: added to e, so that flat places compare as equal."""
MIN_COMMON_POINTS = 20
"""A photograph with fewer points that two others see too is not judged."""
MIN_SEEN_ELSEWHERE = 0.9
"""A blurred photograph stays unless this share of its places is seen by two that are kept."""
POINTS_OF_A_PLACE = 5
"""A place is one of its points and the nearest others, and is seen by as many as see any of them:
36 to 53 % of all points are found in two photographs alone, though more see the place."""

_ALL = "--set train.skip_images=none"


@dataclass(frozen=True, kw_only=True, eq=False)
class Worth:
    """Which of V views are kept (V,), and what was decided about the others."""

    keep_mask: NDArray[np.bool_]
    decisions: tuple[Decision, ...]


def images_worth(scene: SfmScene, views: TrainingViews) -> Worth:
    """The views without repeats and blurred ones; at least one is kept. `views.cameras` are the
    scene's in the same order."""
    repeated = find_repeats(scene, views)
    sharpness = relative_sharpness(scene, views)
    blurred = _find_dispensable(scene, sharpness, ~repeated)
    worst = float(np.nanmin(sharpness)) if np.isfinite(sharpness).any() else 1.0
    return Worth(keep_mask=~(repeated | blurred), decisions=(_repeats_decision(repeated), _blur_decision(blurred, worst)))


def worth_training(scene: SfmScene, views: TrainingViews, config: TrainConfig) -> tuple[SfmScene, TrainingViews, tuple[Decision, ...]]:
    """Scene and views without what `config.skip_images` leaves out, and the decisions; unchanged
    for "none"."""
    if config.skip_images == "none":
        return scene, views, ()
    worth = images_worth(scene, views)
    if worth.keep_mask.all():
        return scene, views, worth.decisions
    rows = np.flatnonzero(worth.keep_mask)
    return scene.restricted_to(rows), views.select(rows), worth.decisions


def relative_sharpness(scene: SfmScene, views: TrainingViews) -> FloatArray:
    """Sharpness (V,) of each view against those that see the same points; NaN if too few do."""
    rows, pixels = views.observed_pixels(scene)
    point, view = scene.observations[rows].T
    logs = np.empty(len(rows))
    by_view = np.split(np.argsort(view, kind="stable"), np.cumsum(np.bincount(view, minlength=len(views)))[:-1])
    for image, view_rows in zip(views.images, by_view, strict=True):
        if len(view_rows):
            logs[view_rows] = np.log(_gradient_energy(image)[pixels[view_rows, 1], pixels[view_rows, 0]] + MIN_GRADIENT**2)
    typical, num_seeing = _medians_of_others(point, logs)
    ratios, judged = logs - typical, num_seeing >= 3
    sharpness = np.full(len(views), np.nan)
    for index, view_rows in enumerate(by_view):
        view_ratios = ratios[view_rows[judged[view_rows]]]
        if len(view_ratios) >= MIN_COMMON_POINTS:
            sharpness[index] = np.exp(0.5 * np.median(view_ratios))
    return sharpness


def _gradient_energy(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Mean squared gradient (H,W) of the brightness in a window around each pixel."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    squared = np.zeros_like(grey)
    squared[:, :-1] += np.diff(grey, axis=1) ** 2
    squared[:-1] += np.diff(grey, axis=0) ** 2
    return np.asarray(cv2.blur(squared, (WINDOW_PX, WINDOW_PX)), np.float32)


def _medians_of_others(group: NDArray[np.int64], values: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
    """For each of T values the median of the others in its group, or itself; the group's size."""
    order = np.lexsort((values, group))
    ordered, counts = np.append(values[order], 0.0), np.bincount(group)[group[order]] if len(group) else np.zeros(0, np.int64)
    start = np.searchsorted(group[order], group[order])
    rank = np.arange(len(values)) - start
    # The middle of n − 1 values by rank; from its own rank on they are one place later.
    low, high = np.maximum(counts - 2, 0) // 2, (counts - 1) // 2
    middle = [ordered[start + place + ((place >= rank) & (counts > 1))] for place in (low, high)]
    medians, sizes = np.empty(len(values)), np.empty(len(values), np.int64)
    medians[order], sizes[order] = (middle[0] + middle[1]) / 2, counts
    return medians, sizes


def _find_dispensable(scene: SfmScene, sharpness: FloatArray, keep_mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which views (V,) are blurred and show only what others show too, the most blurred first."""
    point, view = np.unique(scene.observations, axis=0).T
    num_seeing = np.bincount(point[keep_mask[view]], minlength=len(scene.points))
    blurred = np.zeros(len(sharpness), bool)
    for index in np.argsort(sharpness):
        if not (keep_mask[index] and sharpness[index] < SHARPNESS):
            continue
        points = point[view == index]
        if (_views_of_places(scene.points[points], num_seeing[points]) >= 3).mean() >= MIN_SEEN_ELSEWHERE:
            blurred[index] = True
            num_seeing[points] -= 1
    return blurred


def _views_of_places(points: FloatArray, num_seeing: NDArray[np.int64]) -> NDArray[np.int64]:
    """The most views (K,) that see a point (K,3) or one of its nearest neighbours."""
    nearest = KDTree(points).query(points, k=min(POINTS_OF_A_PLACE, len(points)))[1]
    return np.asarray(num_seeing[nearest.reshape(len(points), -1)].max(axis=1))


def find_repeats(scene: SfmScene, views: TrainingViews) -> NDArray[np.bool_]:
    """Which views (V,) show the picture of an earlier one from its place."""
    repeated = np.zeros(len(views), bool)
    repeated[list(find_repeated_pictures(views.cameras, scene.points, lambda index: views.images[index]))] = True
    return repeated


def _repeats_decision(repeated: NDArray[np.bool_]) -> Decision:
    case = require(REPEATS)
    return Decision(
        stage="train",
        topic="repeated photographs",
        choice=f"{repeated.sum()} of {len(repeated)} photographs are left out",
        figure=float(repeated.sum()),
        unit="photographs that show another's picture from its place",
        reason=case.reason,
        row=case.row,
        otherwise=_ALL if repeated.any() else "",
        changes_nothing=not repeated.any(),
    )


def _blur_decision(blurred: NDArray[np.bool_], worst: float) -> Decision:
    case = require(BLUR)
    return Decision(
        stage="train",
        topic="blurred photographs",
        choice=f"{blurred.sum()} of {len(blurred)} photographs are left out",
        figure=100 * worst,
        unit="% of the others' sharpness at common points, in the least sharp one",
        reason=case.reason,
        row=case.row,
        otherwise=_ALL if blurred.any() else "",
        changes_nothing=not blurred.any(),
    )
