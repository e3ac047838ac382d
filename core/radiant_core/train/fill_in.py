"""Points where structure from motion found none, as on woods, water and lawns. Once per model.

Each training image is cut into cells; a cell below the horizon in which no sparse point is seen
gets one on the ray through its middle, in the cell's mean colour, by one of two rules for all:

    height   where the ray comes down to the height of the nearest observed points: ground, roofs
    depth    as far away as these: walls of a room; only in cells near one of them

Observed points are asked first, each by those at least half a cell from it: where the second errs
clearly less, |log(depth / its depth)| in the median, it places all. The first also knows the far
ground of an oblique view. Without these points such places start empty, and a short
training does not fill them: on an aerial set the woods stayed black.

A point that another photograph sees through, since what it shows there lies farther away, is left
out: before an object that cameras look at from all sides it would be haze. Where most points are of
another colour than the photographs show in their place, they lie where nothing is (`contradicted`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from radiant_core.cameras import Cameras
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene
from radiant_core.train.views import TrainingViews

CELLS_ACROSS = 20
"""Cells along the long side of an image."""
MIN_SPACING_CELLS = 0.7
"""A new point nearer than this many cells to a point that is already there is left out."""
NEIGHBOURS = 4
FARTHEST = 10.0
"""A filled-in point is at most this many times as far as the observed ones beside it."""
SEEN_THROUGH = 0.85
"""A point nearer to a camera than this share of the nearest of `WITNESSES` points that the camera
sees within `WITNESS_CELLS` cells of it would hide them: the camera sees through it."""
WITNESSES, WITNESS_CELLS = 3, 0.5
MOST_ASKED, FEWEST_LOOKS = 1_000, 3
"""So many points, evenly chosen, are compared with photographs, those that this many show."""
CONTRADICTED = 0.5
"""A point differs that is farther from what photographs show in its place, in the median of them,
than this share of how far two places of the photographs are apart, in the median of pairs."""
NUM_PAIRS = 20_000
ASKED_PER_IMAGE, FEWEST_ASKED = 40, 30
"""Observed points of an image that both rules are tried on; with fewer in all, `height` counts."""
APART_CELLS = 0.5
"""How far from each of these the points are that tell its depth, as from a cell to be filled."""
CLEARLY = 0.75
"""At most this share of the error of `height`. Flights have 1.0 to 1.6, orbits 0.8, turntables 0.6,
rooms and façades 0.1 to 0.2."""
DEPTH_REACH_CELLS = 1.5
"""`depth` leaves out cells farther from the nearest observed point: it is 4 to 5 % off within this,
23 % from three cells on (room of 30), where points would be haze before walls and under floors."""
CONSIDERED = 64
"""So many of the nearest are searched for such points."""
Rule = Literal["height", "depth"]


@dataclass(frozen=True, kw_only=True, eq=False)
class AddedPoints:
    """points (F,3), colors (F,3) uint8, and the share of those placed that a photograph sees
    through and that were left out."""

    points: FloatArray
    colors: NDArray[np.uint8]
    seen_through_share: float = 0.0
    rule: Rule = "height"
    errors: Mapping[Rule, float] = field(default_factory=dict[Rule, float])
    """Of each rule at points that are observed; none where too few are."""

    @property
    def placed(self) -> str:
        """Where they are, in words."""
        other: Rule = "depth" if self.rule == "height" else "height"
        if not self.errors:
            return f"at the {self.rule} of the points beside them"
        mine, others = (f"{100 * self.errors[rule]:.1f} %" for rule in (self.rule, other))
        return f"at the {self.rule} of the points beside them ({mine} off at observed points; at their {other} {others})"

    def thin(self, max_num_points: int) -> AddedPoints:
        """At most so many, evenly over the order in which they were found."""
        count = len(self.points)
        rows = np.unique(np.linspace(0, count - 1, min(count, max(0, max_num_points))).astype(np.int64))
        return replace(self, points=self.points[rows], colors=self.colors[rows])


NO_POINTS = AddedPoints(points=np.zeros((0, 3)), colors=np.zeros((0, 3), np.uint8))


def fill_in_points(scene: SfmScene, views: TrainingViews) -> AddedPoints:
    """One point per empty image cell, apart from the scene's and from those of images before,
    that no image sees through. `views.cameras` are the scene's in the same order, at any
    resolution."""
    # The scene's points, of which there may be many, are sorted once; of those added there are few.
    tree, points, colors_of_points = KDTree(scene.points), np.zeros((0, 3)), np.zeros((0, 3), np.uint8)
    seen_by = scene.points_of_cameras()
    errors = _errors_of_rules(scene, seen_by, views.cameras)
    rule: Rule = "depth" if errors and errors["depth"] < CLEARLY * errors["height"] else "height"
    for index in range(len(views)):
        cells = _cells(views.images[index], None if views.weights is None else views.weights[index])
        placed = _place(views.cameras, index, scene.points[seen_by[index]], cells, rule)
        if placed is None:
            continue
        new, spacing, empty = placed
        empty &= cells.counts
        new, spacing, new_colors = new[empty], spacing[empty], cells.colors[empty]
        if len(new):
            distances = np.minimum(tree.query(new)[0], KDTree(points).query(new)[0])
            apart = distances > MIN_SPACING_CELLS * spacing
            points = np.concatenate([points, new[apart]])
            colors_of_points = np.concatenate([colors_of_points, new_colors[apart]])
    stays = ~_are_seen_through(scene, seen_by, views.cameras, points)
    share = 1 - float(stays.mean()) if len(stays) else 0.0
    return AddedPoints(points=points[stays], colors=colors_of_points[stays], seen_through_share=share, rule=rule, errors=errors)


def _errors_of_rules(scene: SfmScene, seen_by: list[NDArray[np.int64]], cameras: Cameras) -> Mapping[Rule, float]:
    """The median error of either rule at observed points below the horizon, |log| of the ratio of
    depths; empty where too few can be asked. Once per model: V queries of 40 points."""
    rng = np.random.default_rng(0)
    errors: dict[Rule, list[FloatArray]] = {"height": [], "depth": []}
    for index in range(len(cameras)):
        points = scene.points[seen_by[index]]
        pixels, depths = _project(cameras, index, points)
        points, pixels, depths = points[depths > 0], pixels[depths > 0], depths[depths > 0]
        if len(points) <= NEIGHBOURS:
            continue
        asked: NDArray[np.int64] = rng.permutation(len(points))[:ASKED_PER_IMAGE]
        rays = _rays(cameras, index, pixels[asked])
        answer = KDTree(pixels).query(pixels[asked], k=min(len(points), CONSIDERED))
        distances, nearest = np.asarray(answer[0]), np.asarray(answer[1])
        apart = distances > APART_CELLS * cameras.sizes_wh[index].max() / CELLS_ACROSS
        usable = (apart.sum(axis=1) >= NEIGHBOURS) & (rays[:, 2] < 0)
        # The nearest that are far enough apart come first, in their order.
        order = np.argsort(~apart[usable], axis=1, kind="stable")[:, :NEIGHBOURS]
        beside = np.take_along_axis(nearest[usable], order, axis=1)
        weights = _weights(np.take_along_axis(distances[usable], order, axis=1))
        true = depths[asked][usable]
        by_depth = (weights * depths[beside]).sum(axis=1)
        by_height = _depths_at_height(rays[usable], cameras.centers[index], by_depth, weights, points[beside])
        errors["height"].append(np.abs(np.log(by_height / true)))
        errors["depth"].append(np.abs(np.log(by_depth / true)))
    if sum(len(part) for part in errors["height"]) < FEWEST_ASKED:
        return {}
    return {rule: float(np.median(np.concatenate(parts))) for rule, parts in errors.items()}


def _rays(cameras: Cameras, index: int, pixels: NDArray[np.floating]) -> FloatArray:
    """Directions (F,3) in the world through pixels (F,2), of depth 1."""
    return (np.concatenate([pixels, np.ones((len(pixels), 1))], axis=1) @ np.linalg.inv(cameras.Ks[index]).T) @ cameras.cam_from_world[
        index, :3, :3
    ]


def _weights(distances: FloatArray) -> FloatArray:
    """Shares (F,K) of neighbours at such distances."""
    weights = 1 / np.maximum(distances, 1e-6)
    return weights / weights.sum(axis=1, keepdims=True)


def _are_seen_through(scene: SfmScene, seen_by: list[NDArray[np.int64]], cameras: Cameras, points: FloatArray) -> NDArray[np.bool_]:
    """Which points (F,) would hide what a camera sees behind them. Once per model: V queries of F
    points among those that a camera sees."""
    seen_through = np.zeros(len(points), bool)
    for index in range(len(cameras)):
        witnesses, witness_depths = _project(cameras, index, scene.points[seen_by[index]])
        pixels, depths = _project(cameras, index, points)
        rows = np.flatnonzero((depths > 0) & ((pixels >= 0) & (pixels < cameras.sizes_wh[index])).all(axis=1))
        if (witness_depths > 0).sum() < WITNESSES or not len(rows):
            continue
        witnesses, witness_depths = witnesses[witness_depths > 0], witness_depths[witness_depths > 0]
        distances, nearest = KDTree(witnesses).query(pixels[rows], k=WITNESSES)
        near_witnesses = distances[:, -1] < WITNESS_CELLS * cameras.sizes_wh[index].max() / CELLS_ACROSS
        seen_through[rows] |= near_witnesses & (depths[rows] < SEEN_THROUGH * witness_depths[nearest].min(axis=1))
    return seen_through


def _project(cameras: Cameras, index: int, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Pixels (P,2) and depths (P,) of points in a camera; pixels behind it mean nothing."""
    pose = cameras.cam_from_world[index]
    in_camera = points @ pose[:3, :3].T + pose[:3, 3]
    depths = in_camera[:, 2]
    pixels = (in_camera @ cameras.Ks[index].T)[:, :2] / np.where(depths > 0, depths, 1.0)[:, None]
    return pixels, depths


def contradicted_share(added: AddedPoints, views: TrainingViews) -> float:
    """Share of the points whose colour is not what other photographs show there, hidden or not; 0
    where too few show any. Once per training: a mean over cells of each photograph."""
    sample = added.thin(MOST_ASKED)
    cameras, colors = views.cameras, sample.colors.astype(np.float64)
    apart, places = np.full((len(sample.points), len(views)), np.nan), []
    for index in range(len(views)):
        cell_px = max(1, int(cameras.sizes_wh[index].max() / CELLS_ACROSS))
        smooth = cv2.blur(np.asarray(views.images[index], np.float32), (cell_px, cell_px))
        places.append(smooth[cell_px // 2 :: cell_px, cell_px // 2 :: cell_px].reshape(-1, 3))
        pixels, depths = _project(cameras, index, sample.points)
        in_image = (depths > 0) & ((pixels >= 0) & (pixels < cameras.sizes_wh[index])).all(axis=1)
        if views.weights is not None:
            column, row = pixels[in_image].astype(np.int64).T
            in_image[in_image] = np.asarray(views.weights[index])[row, column] > 0
        column, row = pixels[in_image].astype(np.int64).T
        apart[in_image, index] = np.abs(smooth[row, column] - colors[in_image]).mean(axis=1)
    comparable = np.isfinite(apart).sum(axis=1) >= FEWEST_LOOKS
    if not comparable.any():
        return 0.0
    all_places = np.concatenate(places)
    first, second = np.random.default_rng(0).integers(0, len(all_places), (2, NUM_PAIRS))
    usual = float(np.median(np.abs(all_places[first] - all_places[second]).mean(axis=1)))
    return float((np.nanmedian(apart[comparable], axis=1) > CONTRADICTED * usual).mean())


@dataclass(frozen=True, kw_only=True, eq=False)
class _Cells:
    """Middles (F,2) px and mean colours (F,3) of the cells of one image, and which count (F,): half
    or more of their pixels do."""

    middles: NDArray[np.floating]
    colors: NDArray[np.uint8]
    counts: NDArray[np.bool_]


def _cells(image: NDArray[np.uint8], weights: NDArray[np.uint8] | None = None) -> _Cells:
    height, width = image.shape[:2]
    cell_px = max(width, height) / CELLS_ACROSS
    columns, rows = (min(side, max(1, round(side / cell_px))) for side in (width, height))
    column, row = np.meshgrid(np.arange(columns), np.arange(rows))
    middles = (np.stack([column.ravel(), row.ravel()], axis=1) + 0.5) * np.array([width / columns, height / rows])
    if weights is None:
        colors = _block_means(image.astype(np.float64), columns, rows)
        counts = np.ones(len(middles), bool)
    else:
        shares = weights[..., None] / 255
        used = _block_means(shares, columns, rows)
        colors = _block_means(image * shares, columns, rows) / np.maximum(used, 1e-3)
        counts = used.ravel() >= 0.5
    return _Cells(middles=middles, colors=colors.round().clip(0, 255).astype(np.uint8).reshape(-1, 3), counts=counts)


def _block_means(image: FloatArray, columns: int, rows: int) -> FloatArray:
    """Means (rows, columns, channels) of a grid of blocks of an image (H,W,channels)."""
    height, width = image.shape[:2]
    row_starts = (np.arange(rows) * height // rows).astype(np.int64)
    column_starts = (np.arange(columns) * width // columns).astype(np.int64)
    sums = np.add.reduceat(np.add.reduceat(image, row_starts, axis=0), column_starts, axis=1)
    counts = np.outer(np.diff([*row_starts, height]), np.diff([*column_starts, width]))
    return sums / counts[..., None]


def _place(
    cameras: Cameras, index: int, seen_points: FloatArray, cells: _Cells, rule: Rule
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]] | None:
    """Points (F,3) of the cells, spacings (F,) in world units, and which are below the horizon
    without an observed point but within the rule's reach of one (F,); None when too few points are
    seen to tell a depth."""
    pose, K = cameras.cam_from_world[index], cameras.Ks[index]
    in_camera = seen_points @ pose[:3, :3].T + pose[:3, 3]
    visible, in_camera = seen_points[in_camera[:, 2] > 0], in_camera[in_camera[:, 2] > 0]
    if len(in_camera) < NEIGHBOURS:
        return None
    pixels = (in_camera @ K.T)[:, :2] / in_camera[:, 2:]
    distances, nearest = KDTree(pixels).query(cells.middles, k=NEIGHBOURS)
    weights, rays = _weights(distances), _rays(cameras, index, cells.middles)
    depths = (weights * in_camera[nearest, 2]).sum(axis=1)
    if rule == "height":
        depths = _depths_at_height(rays, cameras.centers[index], depths, weights, visible[nearest])
    points = cameras.centers[index] + rays * depths[:, None]
    cell_px = cameras.sizes_wh[index].max() / CELLS_ACROSS
    empty = (distances[:, 0] > 0.5 * cell_px) & (rays[:, 2] < 0)
    if rule == "depth":
        empty &= distances[:, 0] < DEPTH_REACH_CELLS * cell_px
    return points, depths * cell_px / K[0, 0], empty


def _depths_at_height(rays: FloatArray, center: FloatArray, nearby: FloatArray, weights: FloatArray, neighbours: FloatArray) -> FloatArray:
    """Depths (F,) at which the rays (F,3) come down to the mean height of their neighbours (F,K,3);
    `nearby`, their mean depth, where they are no lower than the camera. At most `FARTHEST` times
    that: towards the horizon a ray comes down nowhere. The mean depth alone would hang the far
    ground of an oblique view in mid-air."""
    drops = (weights * neighbours[..., 2]).sum(axis=1) - center[2]
    downwards = (drops < 0) & (rays[:, 2] < 0)
    depths = np.divide(drops, rays[:, 2], out=nearby.copy(), where=downwards)
    return np.minimum(depths, FARTHEST * nearby)
