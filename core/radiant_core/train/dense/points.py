"""Dense points of a scene: every photograph is matched against its partners, and what three of them
agree on is kept. Once per training.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene
from radiant_core.train.dense.depth_planes import DepthPlanes, SparseDepths, match_planes, pixel_matrix
from radiant_core.train.dense.fuse import DensePoints, agreed_points, concatenate_points, thinned
from radiant_core.train.dense.sources import choose_sources
from radiant_core.train.stored_images import shapes_of
from radiant_core.train.views import TrainingViews

LONG_SIDE_PX = 576
"""Photographs are matched at this size or below."""
NUM_SOURCES = 4
NUM_CHECKED = 8
"""Agreement is looked for in so many photographs."""


def dense_points(scene: SfmScene, views: TrainingViews, *, most: int, seed: int = 0, num_threads: int = 1) -> DensePoints:
    """At most so many points of the scene that at least three photographs agree on.

    Args:
        scene: cameras and sparse points.
        views: the photographs of these cameras in their order.
        most: upper limit of points.
        seed: of the random search.
        num_threads: how many share the rows; the result does not depend on it.

    Returns:
        The points; none where fewer than three photographs overlap.
    """
    views = smaller_views(views)
    partners = choose_sources(scene, NUM_CHECKED)
    maps = depth_maps(scene, views, partners, seed=seed, num_threads=num_threads)
    parts = []
    for index in range(len(views)):
        points = agreed_points(maps, views.cameras, index, partners[index], views.images[index])
        if views.weights is not None and len(points):
            points = points.select(_counts(views.weights[index], points, views, index))
        parts.append(points)
    return thinned(concatenate_points(parts), most)


def smaller_views(views: TrainingViews) -> TrainingViews:
    """The views at the size of matching."""
    longest = int(views.cameras.sizes_wh.max())
    return views if longest <= LONG_SIDE_PX else views.scaled(LONG_SIDE_PX / longest)


def depth_maps(
    scene: SfmScene,
    views: TrainingViews,
    partners: list[NDArray[np.int64]],
    *,
    seed: int,
    num_threads: int,
    report: Callable[[int], None] = lambda num_done: None,
) -> list[DepthPlanes | None]:
    """Planes of each photograph; None where it has no partner or too few sparse points. `report`
    hears how many photographs are done."""
    shapes = shapes_of(views.images)
    sparse = sparse_depths(scene, views)
    maps: list[DepthPlanes | None] = []
    for index in range(len(views)):
        report(index)
        indices = [index, *map(int, partners[index][:NUM_SOURCES])]
        if len(indices) < 2 or min(min(shapes[i][:2]) for i in indices) < 2:
            maps.append(None)
            continue
        images = [np.asarray(cv2.cvtColor(views.images[i], cv2.COLOR_RGB2GRAY), np.uint8) for i in indices]
        maps.append(match_planes(images, views.cameras, indices, sparse[index], seed=seed + 7919 * index, num_threads=num_threads))
    return maps


def sparse_depths(scene: SfmScene, views: TrainingViews) -> list[SparseDepths]:
    """Pixels and inverse depths of the sparse points that each photograph observes."""
    rows, _ = scene.observed_pixels(views.cameras)
    point, view = scene.observations[rows].T
    return [_sparse_of(scene.points[point[view == index]], views, index) for index in range(len(views))]


def _sparse_of(points: FloatArray, views: TrainingViews, index: int) -> SparseDepths:
    K, pose = pixel_matrix(views.cameras, index), views.cameras.cam_from_world[index]
    in_camera = points @ pose[:3, :3].T + pose[:3, 3]
    pixels = in_camera[:, :2] / in_camera[:, 2:] * np.diag(K)[:2] + K[:2, 2]
    return SparseDepths(pixels=pixels, inverse_depths=1 / in_camera[:, 2])


def _counts(weights: NDArray[np.uint8], points: DensePoints, views: TrainingViews, index: int) -> NDArray[np.bool_]:
    K, pose = pixel_matrix(views.cameras, index), views.cameras.cam_from_world[index]
    in_camera = points.points @ pose[:3, :3].T + pose[:3, 3]
    pixels = np.rint(in_camera[:, :2] / in_camera[:, 2:] * np.diag(K)[:2] + K[:2, 2]).astype(np.int64)
    x, y = pixels.clip(0, views.cameras.sizes_wh[index] - 1).T
    return 2 * weights[y, x].astype(np.int64) > 255
