"""Retraining by tiles, where all Gaussians at once exceed the memory of a machine: one tile after
the other is fitted among those around it, which stand still. Once per join.

    tiles      halves of equal counts across the longer horizontal side, halved again: 2^k
    its views  the views that show it, cropped to it and `MARGIN_PX` around it

A cropped view shows few Gaussians beside those of its tile, so that memory falls with the number of
tiles; each pixel is shown about as often as without them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radiant_core.aggregate.config import Join
from radiant_core.aggregate.retrain import Retrained, retrain, retraining_config
from radiant_core.cameras import Cameras
from radiant_core.geometry.coverage import reached_by
from radiant_core.splats import Splats, concatenate_splats
from radiant_core.train.config import TrainConfig
from radiant_core.train.extent import working_extent
from radiant_core.train.results import TrainProgress, TrainResult
from radiant_core.train.stored_images import Window, crop_images
from radiant_core.train.trainer import FitOptions, NoCheckpoints
from radiant_core.train.views import TrainingViews

MARGIN_PX = 16
"""SSIM compares windows of 11 px: an error at the rim of a crop reaches no Gaussian of the tile."""
MIN_SIDE_PX = 32
"""A view that shows less of a tile does not teach it."""
NUM_ASKED = 20_000
"""Gaussians of a tile that say where a view shows it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Tile:
    """Of N Gaussians those (N,) that are fitted; rows and windows of views that show them."""

    fitted: NDArray[np.bool_]
    rows: tuple[int, ...]
    windows: tuple[Window, ...]

    def cameras(self, cameras: Cameras) -> Cameras:
        """Those that show the tile, cropped."""
        return crop_cameras(cameras.select(np.array(self.rows, np.int64)), self.windows)

    def views(self, views: TrainingViews) -> TrainingViews:
        """Those that show the tile, cropped."""
        selected = views.select(list(self.rows))
        weights = None if selected.weights is None else crop_images(selected.weights, self.windows)
        return TrainingViews(cameras=self.cameras(views.cameras), images=crop_images(selected.images, self.windows), weights=weights)


def tile_labels(means: NDArray[np.floating], num_tiles: int) -> NDArray[np.int64]:
    """The tile (N,) of each of the centres (N,3) m; `num_tiles` is a power of two."""
    labels = np.zeros(len(means), np.int64)
    count = 1
    while count < num_tiles:
        for tile in range(count):
            rows = np.flatnonzero(labels == tile)
            if len(rows):
                axis = int(np.argmax(np.ptp(means[rows, :2], axis=0)))
                upper = np.argsort(means[rows, axis], kind="stable")[len(rows) // 2 :]
                labels[rows[upper]] += count
        count *= 2
    return labels


def tiles_of(means: NDArray[np.floating], cameras: Cameras, num_tiles: int) -> list[Tile]:
    """Tiles of Gaussians with centres (N,3) m, each with its windows in the views of `cameras`."""
    labels = tile_labels(means, num_tiles)
    tiles = []
    for tile in range(num_tiles):
        fitted = labels == tile
        windows = dict(_windows(means[fitted], cameras))
        tiles.append(Tile(fitted=fitted, rows=tuple(windows), windows=tuple(windows.values())))
    return tiles


def most_fitted(splats: Splats, cameras: Cameras, tiles: Sequence[Tile]) -> int:
    """The most Gaussians that any of the tiles takes into memory: its own and those around it."""
    return max((int(reached_by(splats, tile.cameras(cameras)).sum()) for tile in tiles if tile.rows), default=0)


def retrain_by_tiles(
    moving: Splats, views: TrainingViews, train: TrainConfig, join: Join, options: FitOptions, num_tiles: int
) -> Retrained:
    """As `retrain`, tile after tile; an interrupted one begins anew. Nothing is reached where no
    view shows `MIN_SIDE_PX` of any tile."""
    if num_tiles == 1:
        return retrain(moving, views, train, join, options)
    # The rates of centres are those of a training on all views.
    limit = retraining_config(train, join, moving, len(views)).max_extent_per_distance
    extent = working_extent(views.cameras, moving.select(reached_by(moving, views.cameras)), limit)
    tiles = tiles_of(moving.means, views.cameras, num_tiles)
    parts, reached = [moving.select(tile.fitted) for tile in tiles], np.zeros(len(moving), bool)
    nothing, num_fitted = moving.select(np.arange(0)), [0] * num_tiles
    results: list[TrainResult] = []
    for index, tile in enumerate(tiles):
        if not tile.rows:
            continue
        tile_views = tile.views(views)
        neighbours = [part for number, part in enumerate(parts) if number != index]
        around = concatenate_splats([part.select(reached_by(part, tile_views.cameras)) for part in neighbours])
        settings = replace(train, seed=train.seed + index)
        report = _report_after(len(results), len(tiles), options.report)
        tile_options = replace(options, checkpoints=NoCheckpoints(), report=report, extent=extent)
        retrained = retrain(parts[index], tile_views, settings, join, tile_options, frozen=around)
        reached[np.flatnonzero(tile.fitted)[retrained.reached]] = True
        parts[index] = concatenate_splats([retrained.splats, parts[index].select(~retrained.reached)])
        num_fitted[index] = len(retrained.splats)
        results.append(replace(retrained.trained, splats=nothing))
    if not results:
        return Retrained(trained=TrainResult(splats=nothing, num_steps=0, first_loss=0.0, last_loss=0.0, seconds=0.0), reached=reached)
    fitted = [part.select(np.arange(count)) for part, count in zip(parts, num_fitted, strict=True)]
    return Retrained(trained=replace(_sum_of(results), splats=concatenate_splats(fitted)), reached=reached)


def _report_after(num_done: int, num_tiles: int, report: Callable[[TrainProgress], None]) -> Callable[[TrainProgress], None]:
    """Progress over all tiles, taken to have as many steps as this one."""
    return lambda tile: report(replace(tile, step=num_done * tile.num_steps + tile.step, num_steps=num_tiles * tile.num_steps))


def _sum_of(results: Sequence[TrainResult]) -> TrainResult:
    return TrainResult(
        splats=results[0].splats,
        num_steps=sum(result.num_steps for result in results),
        first_loss=float(np.mean([result.first_loss for result in results])),
        last_loss=float(np.mean([result.last_loss for result in results])),
        seconds=sum(result.seconds for result in results),
        num_rolled_back=sum(result.num_rolled_back for result in results),
    )


def crop_cameras(cameras: Cameras, windows: Sequence[Window]) -> Cameras:
    """Cameras (C) that see only a window of their images."""
    Ks = cameras.Ks.copy()
    Ks[:, 0, 2] -= [left for _, _, left, _ in windows]
    Ks[:, 1, 2] -= [top for top, _, _, _ in windows]
    sizes_wh = np.array([(right - left, bottom - top) for top, bottom, left, right in windows], np.int64).reshape(-1, 2)
    return replace(cameras, Ks=Ks, sizes_wh=sizes_wh)


def _windows(means: NDArray[np.floating], cameras: Cameras) -> Iterator[tuple[int, Window]]:
    """Row and window of each camera that shows enough of the centres (N,3)."""
    some = np.unique(np.linspace(0, len(means) - 1, NUM_ASKED).astype(np.int64)) if len(means) else np.zeros(0, np.int64)
    places = means[some].T.astype(np.float64)
    for row, (K, pose, (width, height)) in enumerate(zip(cameras.Ks, cameras.cam_from_world, cameras.sizes_wh, strict=True)):
        x, y, depth = K @ (pose[:3, :3] @ places + pose[:3, 3:])
        with np.errstate(divide="ignore", invalid="ignore"):
            columns, lines = x / depth, y / depth
        inside = (depth > 0) & (columns >= 0) & (columns < width) & (lines >= 0) & (lines < height)
        if not inside.any():
            continue
        left, right = (int(end) for end in (columns[inside].min() - MARGIN_PX, columns[inside].max() + MARGIN_PX + 1))
        top, bottom = (int(end) for end in (lines[inside].min() - MARGIN_PX, lines[inside].max() + MARGIN_PX + 1))
        window = (max(0, top), min(int(height), bottom), max(0, left), min(int(width), right))
        if window[1] - window[0] >= MIN_SIDE_PX and window[3] - window[2] >= MIN_SIDE_PX:
            yield row, window
