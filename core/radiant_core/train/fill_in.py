"""Points where structure from motion found none, and an apron around what was photographed. Once per model.

Fill-in: each training image is cut into cells; a cell below the horizon in which no sparse point is seen gets one, in the cell's mean
colour. Without it woods, water and lawns start empty, and a short training cannot reach there: on an aerial set they stayed black.
Apron: coarse cells half an image beyond each image's sides continue its edge colours over ground that no training image sees, so
that a view from a little further out meets a blur and not a black hole.
Both lie on the ray through the cell's middle, at the depth interpolated from the nearest observed points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from radiant_core.cameras import Cameras
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene
from radiant_core.train.views import TrainingViews

FILL_CELLS_ACROSS, APRON_CELLS_ACROSS = 20, 10
"""Cells along the long side of an image."""
APRON_MARGIN = 0.5
"""How far the apron reaches beyond an image, in image sides."""
MIN_SPACING_CELLS = 0.7
"""A new point nearer than this many cells to a point that is already there is left out."""
NEIGHBOURS = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class AddedPoints:
    """points (F,3), colors (F,3) uint8."""

    points: FloatArray
    colors: NDArray[np.uint8]

    def thinned(self, max_num_points: int) -> AddedPoints:
        """At most so many, evenly over the order in which they were found."""
        count = len(self.points)
        kept = np.unique(np.linspace(0, count - 1, min(count, max(0, max_num_points))).astype(np.int64))
        return AddedPoints(points=self.points[kept], colors=self.colors[kept])


def fill_in_points(scene: SfmScene, views: TrainingViews) -> AddedPoints:
    """One point per image cell without a sparse point; `views.cameras` are the scene's in the same order, at any resolution."""
    return _added(scene, views, FILL_CELLS_ACROSS, 0.0)


def apron_points(scene: SfmScene, views: TrainingViews) -> AddedPoints:
    """Coarse points beside the images, where no training camera looks."""
    apron = _added(scene, views, APRON_CELLS_ACROSS, APRON_MARGIN)
    unseen = ~views.cameras.any_sees(apron.points)
    return AddedPoints(points=apron.points[unseen], colors=apron.colors[unseen])


def _added(scene: SfmScene, views: TrainingViews, cells_across: int, margin: float) -> AddedPoints:
    """New points of all images, each apart from the scene's and from those of the images before."""
    known, first_new = scene.points, len(scene.points)
    colors = [np.zeros((0, 3), np.uint8)]
    for index in range(len(views)):
        cells = _cells(views, index, cells_across, margin)
        seen = scene.points[scene.observations[scene.observations[:, 1] == index, 0]]
        placed = _place(views.cameras, index, seen, cells, cells_across)
        if placed is None:
            continue
        points, spacing, empty = placed
        points, spacing, new_colors = points[empty], spacing[empty], cells.colors[empty]
        if len(points):
            apart = KDTree(known).query(points)[0] > MIN_SPACING_CELLS * spacing
            known = np.concatenate([known, points[apart]])
            colors.append(new_colors[apart])
    return AddedPoints(points=known[first_new:], colors=np.concatenate(colors))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Cells:
    """Middles (F,2) px and mean colours (F,3) of cells inside or, with a margin, only outside of one image."""

    middles: NDArray[np.floating]
    colors: NDArray[np.uint8]


def _cells(views: TrainingViews, index: int, cells_across: int, margin: float) -> _Cells:
    image = views.images[index]
    height, width = image.shape[:2]
    cell_px = max(width, height) / cells_across
    columns, rows = max(1, round(width / cell_px)), max(1, round(height / cell_px))
    beyond_x, beyond_y = round(margin * columns), round(margin * rows)
    column, row = np.meshgrid(np.arange(-beyond_x, columns + beyond_x), np.arange(-beyond_y, rows + beyond_y))
    outside = (column < 0) | (column >= columns) | (row < 0) | (row >= rows)
    column, row = (axis[outside] if margin else axis.ravel() for axis in (column, row))
    middles = (np.stack([column, row], axis=1) + 0.5) * np.array([width / columns, height / rows])
    means = _block_means(image, columns, rows)
    return _Cells(middles=middles, colors=means[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)])


def _block_means(image: NDArray[np.uint8], columns: int, rows: int) -> NDArray[np.uint8]:
    """Mean colours (rows, columns, 3) of a grid of blocks."""
    height, width = image.shape[:2]
    row_starts = (np.arange(rows) * height // rows).astype(np.int64)
    column_starts = (np.arange(columns) * width // columns).astype(np.int64)
    sums = np.add.reduceat(np.add.reduceat(image.astype(np.int64), row_starts, axis=0), column_starts, axis=1)
    counts = np.outer(np.diff([*row_starts, height]), np.diff([*column_starts, width]))
    return (sums / counts[..., None]).round().astype(np.uint8)


def _place(
    cameras: Cameras, index: int, seen: FloatArray, cells: _Cells, cells_across: int
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]] | None:
    """Points (F,3) of the cells, their spacing (F,) in world units, and which lie below the horizon without an observed point in
    them (F,); None when the image sees too few points to tell a depth."""
    pose, K = cameras.cam_from_world[index], cameras.Ks[index]
    in_camera = seen @ pose[:3, :3].T + pose[:3, 3]
    in_camera = in_camera[in_camera[:, 2] > 0]
    if len(in_camera) < NEIGHBOURS:
        return None
    pixels = (in_camera @ K.T)[:, :2] / in_camera[:, 2:]
    distances, nearest = KDTree(pixels).query(cells.middles, k=NEIGHBOURS)
    weights = 1 / np.maximum(distances, 1e-6)
    depths = (weights * in_camera[nearest, 2]).sum(axis=1) / weights.sum(axis=1)
    rays = np.concatenate([cells.middles, np.ones((len(cells.middles), 1))], axis=1) @ np.linalg.inv(K).T
    points = (rays * depths[:, None] - pose[:3, 3]) @ pose[:3, :3]
    cell_px = cameras.sizes_wh[index].max() / cells_across
    empty = (distances[:, 0] > 0.5 * cell_px) & (rays @ pose[:3, 2] < 0)
    return points, depths * cell_px / K[0, 0], empty
