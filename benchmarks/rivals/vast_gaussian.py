"""VastGaussian (Lin 2024): cells of equal camera counts, trained with all that sees them, cropped.

    cells:  m groups of equal counts by x, each n by y; rectangles end halfway to the next group
    select: widen by 20 % per side, take cameras and points inside              → position
            + cameras of whose image the cell's airspace covers at least 25 %   → visibility
            + all points that any camera of the cell observes                   → coverage
    merge:  of each cell's model what lies in its own rectangle, outer cells to infinity

Once per scene; training is the caller's. What differs from the publication, and why:
- Its ground plane comes from a Manhattan alignment; our scenes are z up already.
- The airspace ends at the 1st and 99th percentile of the heights of the cell's points: up to the
  highest one, a single wrong match would make every camera see every cell.
- The trainer's canonical light (a gain per photograph and channel and a vignetting, where the
  caller's `train` turns it on) stands in for its appearance network (a CNN from the render and an
  image's vector to a multiplier per pixel). Either is thrown away after training.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from benchmarks.rivals.box_coverage import box_coverage
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats, concatenate_splats

TrainCell = Callable[[SfmScene, int], Splats]
"""Trains a model of a scene with a seed."""


@dataclass(frozen=True, kw_only=True)
class VastGaussianConfig:
    """How cells are widened and filled; the defaults are the published ones."""

    widen: float = 0.2
    """Share of its length by which each side of a cell moves out before it takes cameras."""
    min_coverage: float = 0.25
    """A camera of whose image the cell's airspace covers at least this share is added."""
    height_quantile: float = 0.01
    """The airspace reaches from this quantile of the heights of its points to the opposite one."""
    min_points: int = 100
    """A cell with fewer points takes its heights from all points of the scene."""

    def __post_init__(self) -> None:
        if not (0 <= self.widen < np.inf and 0 < self.min_coverage <= 1 and 0 <= self.height_quantile < 0.5 and self.min_points >= 1):
            raise BadInput(f"VastGaussian was given {self}: expected widen ≥ 0, 0 < coverage ≤ 1, 0 ≤ quantile < 0.5, min_points ≥ 1.")


@dataclass(frozen=True, kw_only=True, eq=False)
class VastCell:
    """One cell of the m × n. Indices are those of the scene, sorted."""

    column: int
    row: int
    bounds: FloatArray
    """(2,2) m: low xy, high xy, as far as cameras stand."""
    is_outer: NDArray[np.bool_]
    """(2,2) whether that side has no neighbour."""
    own_cameras: NDArray[np.int64]
    """(K,) the cameras of its group; each camera of the scene is in one group."""
    cameras: NDArray[np.int64]
    """(L,) all cameras that it is trained with."""
    points: NDArray[np.int64]
    """(Q,) the points that its model starts from."""

    @property
    def region(self) -> FloatArray:
        """(2,2) m: low xy, high xy of what the cell owns, infinite where it has no neighbour."""
        return np.where(self.is_outer, [[-np.inf], [np.inf]], self.bounds)

    def owns(self, means: NDArray[np.floating]) -> NDArray[np.bool_]:
        """Whether each of the places (N,2) or (N,3) m is the cell's: low ≤ xy < high."""
        low, high = self.region
        xy = np.asarray(means, np.float64)[:, :2]
        return ((xy >= low) & (xy < high)).all(axis=1)


@dataclass(frozen=True, kw_only=True, eq=False)
class VastGaussianResult:
    """The joined model with its cells and what was trained in each."""

    splats: Splats
    cells: tuple[VastCell, ...]
    models: tuple[Splats, ...]
    """One per cell, before they are cropped."""


def vast_gaussian(
    scene: SfmScene, m: int, n: int, train: TrainCell, *, seed: int, config: VastGaussianConfig = VastGaussianConfig()
) -> VastGaussianResult:
    """Divide `scene` (z up) into m × n cells, train each by `train(scene, seed)`, join them."""
    cells = vast_cells(scene, m, n, config)
    models = tuple(train(scene_of_cell(scene, cell), seed) for cell in cells)
    return VastGaussianResult(splats=crop_cells(models, cells), cells=cells, models=models)


def vast_cells(scene: SfmScene, m: int, n: int, config: VastGaussianConfig = VastGaussianConfig()) -> tuple[VastCell, ...]:
    """The m × n cells of a scene (z up), column by column, with cameras and points selected.

    BadInput where a group would stay without camera and for a scene without points.
    """
    if m < 1 or n < 1 or len(scene.cameras) < m * n:
        raise BadInput(f"{m} × {n} cells for {len(scene.cameras)} cameras: give at least one column and row, and a camera per cell.")
    if not len(scene.points):
        raise BadInput("the scene has no points, so its cells have no height: reconstruct it first.")
    xy = scene.cameras.centers[:, :2]
    columns, x_edges = _equal_groups(np.arange(len(xy)), xy[:, 0], m)
    cells = []
    for column, members in enumerate(columns):
        rows, y_edges = _equal_groups(members, xy[members, 1], n)
        for row, cell_rows in enumerate(rows):
            bounds = np.array([[x_edges[column], y_edges[row]], [x_edges[column + 1], y_edges[row + 1]]])
            cameras, points = _select_for_cell(scene, cell_rows, bounds, config)
            cells.append(
                VastCell(
                    column=column,
                    row=row,
                    bounds=check_array("bounds", bounds, (2, 2)),
                    is_outer=np.array([[column == 0, row == 0], [column == m - 1, row == n - 1]]),
                    own_cameras=np.sort(cell_rows),
                    cameras=cameras,
                    points=points,
                )
            )
    return tuple(cells)


def scene_of_cell(scene: SfmScene, cell: VastCell) -> SfmScene:
    """The cameras, points and observations that a cell is trained with."""
    new_point, new_camera = np.full(len(scene.points), -1), np.full(len(scene.cameras), -1)
    new_point[cell.points] = np.arange(len(cell.points))
    new_camera[cell.cameras] = np.arange(len(cell.cameras))
    observations = np.stack([new_point[scene.observations[:, 0]], new_camera[scene.observations[:, 1]]], axis=1)
    return SfmScene(
        cameras=scene.cameras.select(cell.cameras),
        points=scene.points[cell.points],
        colors=scene.colors[cell.points],
        observations=observations[(observations >= 0).all(axis=1)],
        frame=scene.frame,
    )


def crop_cells(models: Sequence[Splats], cells: Sequence[VastCell]) -> Splats:
    """Of each model what its cell owns, in one. BadInput where a model is missing or empty."""
    if len(models) != len(cells) or not models:
        raise BadInput(f"{len(models)} models for {len(cells)} cells: give one model per cell, at least one.")
    for model, cell in zip(models, cells, strict=True):
        if not len(model):
            raise BadInput(f"the model of cell {cell.column}, {cell.row} has no Gaussians: train it before the cells are joined.")
    return concatenate_splats([model.select(cell.owns(model.means)) for model, cell in zip(models, cells, strict=True)])


def _equal_groups(members: NDArray[np.int64], places: FloatArray, count: int) -> tuple[list[NDArray[np.int64]], FloatArray]:
    """`members` (K,) in `count` equal groups by `places` (K,), and their edges (count + 1,)."""
    order = np.argsort(places, kind="stable")
    groups = np.array_split(order, count)
    inner = [(places[left[-1]] + places[right[0]]) / 2 for left, right in pairwise(groups)]
    return [members[group] for group in groups], np.array([places.min(), *inner, places.max()])


def _select_for_cell(
    scene: SfmScene, cell_rows: NDArray[np.int64], bounds: FloatArray, config: VastGaussianConfig
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cameras and points of the cell with `bounds` (2,2), by position, visibility and coverage."""
    margin = config.widen * (bounds[1] - bounds[0])
    low, high = bounds[0] - margin, bounds[1] + margin
    chosen = _inside(scene.cameras.centers, low, high)
    chosen[cell_rows] = True
    chosen |= box_coverage(scene.cameras, *_airspace(scene, bounds, config)) >= config.min_coverage
    cameras = np.flatnonzero(chosen)
    return cameras, np.union1d(np.flatnonzero(_inside(scene.points, low, high)), scene.seen_by(cameras))


def _airspace(scene: SfmScene, bounds: FloatArray, config: VastGaussianConfig) -> FloatArray:
    """Low and high corner (2,3) m of the box over a cell."""
    heights = scene.points[_inside(scene.points, *bounds), 2]
    if len(heights) < config.min_points:
        heights = scene.points[:, 2]
    return np.column_stack([bounds, np.quantile(heights, [config.height_quantile, 1 - config.height_quantile])])


def _inside(places: FloatArray, low: FloatArray, high: FloatArray) -> NDArray[np.bool_]:
    """Mask (K,) of the places (K,2 or more) whose xy lie in the closed rectangle."""
    return np.asarray(((places[:, :2] >= low) & (places[:, :2] <= high)).all(axis=1), bool)
