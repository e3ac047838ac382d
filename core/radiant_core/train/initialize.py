"""The first Gaussians: one per sparse point, as wide as its neighbours are far, and a sky (Kerbl
2023, Sec. 5.1). Once per model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.regimes import SKY, require
from radiant_core.scene import SfmScene
from radiant_core.splats import SH_BASES, SH_C0, Splats, concatenate_splats, morton_order
from radiant_core.train.config import TrainConfig
from radiant_core.train.dense.fuse import DensePoints
from radiant_core.train.fill_in import NO_POINTS, AddedPoints, fill_in_points
from radiant_core.train.views import TrainingViews

INITIAL_OPACITY = 0.1
NUM_SKY = 400
SKY_OPACITY = 0.9
"""The sky occludes nothing. Where no photograph shows it, it keeps this: a lower one looks dark."""
SKY_RGB = (0.75, 0.75, 0.75)
"""Colour of the sky where no photographs are given."""
MIN_CAMERA_SHARE = 1e-3
"""Points nearer to a camera than this share of the usual distance are no points."""
DENSE_OPACITY = 0.5
"""Dense points lie on surfaces; at 0.1 held-out photographs of the town begin at 9.5 dB in place of
13.3."""
FLATNESS = 0.3
"""A dense point's Gaussian is so much thinner along its normal than across it."""
REPLACED_SPACINGS = 1.5
"""A first Gaussian nearer than so many spacings to a dense point is that point's."""
PLANE_NEIGHBOURS = 8
"""Of a first Gaussian, in whose plane it lies."""


def initial_splats(
    points: FloatArray,
    colors: NDArray[np.uint8],
    cameras: Cameras,
    *,
    max_num_splats: int,
    sh_degree: int,
    sky_rgb: ArrayLike | None = SKY_RGB,
) -> Splats:
    """Gaussians from points (P,3) m and colours (P,3), and a sky of one colour above the horizon:
    at most `max_num_splats`, up to a quarter of them sky, none where `sky_rgb` is None. Duplicate
    points are merged, those at a camera's centre left out; too many are thinned out evenly along x,
    their sorted order. Raises BadInput with fewer than 4 different points."""
    points, first = np.unique(np.asarray(points, np.float64), axis=0, return_index=True)
    colors = np.asarray(colors)[first]
    away = _away_from_cameras(points, cameras)
    points, colors = points[away], colors[away]
    if len(points) < 4:
        raise BadInput(f"only {len(points)} different sparse points, expected at least 4: take more overlapping photographs.")
    sky = _sky_points(points, cameras, 0 if sky_rgb is None else min(NUM_SKY, max_num_splats // 4))
    rows = np.unique(np.linspace(0, len(points) - 1, max(4, min(len(points), max_num_splats - len(sky)))).astype(np.int64))
    points, colors = points[rows], colors[rows]
    spacing = _neighbour_distance(points)
    sky_radius = np.linalg.norm(sky - sky.mean(0), axis=1).max() if len(sky) else 0.0
    scales = np.concatenate([spacing, np.full(len(sky), 1.5 * sky_radius / np.sqrt(max(1, len(sky))))])
    rgb = np.concatenate([colors / 255.0, np.broadcast_to(SKY_RGB if sky_rgb is None else sky_rgb, (len(sky), 3))])
    opacities = np.repeat([INITIAL_OPACITY, SKY_OPACITY], [len(points), len(sky)])
    means = np.concatenate([points, sky]).astype(np.float32)
    count = len(means)
    return Splats(
        means=means,
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        log_scales=np.log(np.repeat(scales[:, None], 3, axis=1)).astype(np.float32),
        logit_opacities=np.log(opacities / (1 - opacities)).astype(np.float32),
        sh0=((rgb - 0.5) / SH_C0)[:, None].astype(np.float32),
        shN=np.zeros((count, SH_BASES[sh_degree] - 1, 3), np.float32),
    )


def _away_from_cameras(points: FloatArray, cameras: Cameras) -> NDArray[np.bool_]:
    """Which points (P,) lie at no camera's centre: a wrong match is triangulated there and would
    cover that camera's picture."""
    if not (len(points) and len(cameras)):
        return np.ones(len(points), bool)
    distances = KDTree(cameras.centers).query(points)[0]
    return distances > MIN_CAMERA_SHARE * float(np.median(distances))


def first_splats(
    scene: SfmScene, views: TrainingViews, config: TrainConfig, dense: DensePoints | None = None, filled: AddedPoints | None = None
) -> tuple[Splats, int]:
    """Return the Gaussians that training starts from: sparse points and, by `config`, fill-in
    points and a sky; dense points in place of those near to one.

    Args:
        scene: cameras and sparse points.
        views: the photographs; their cameras are those of the scene, in the same order.
        config: the settings of training.
        dense: points that photographs agree on, if they were matched.
        filled: what `fill_in_points` adds to these photographs, where that is known already.

    Returns:
        The Gaussians, and how many points were filled in: at most what the limit leaves or a
        quarter of it, whichever is more.
    """
    fill = NO_POINTS if not config.fill_in else fill_in_points(scene, views) if filled is None else filled
    fill = fill.thin(room_to_fill(config.max_num_splats, len(scene.points)))
    initial = initial_gaussians(scene.points, scene.colors, fill, views.cameras, config, sky_rgb_of(views))
    if dense is not None and len(dense) >= 4:
        initial = with_dense_points(initial, dense, config.max_num_splats)
    return initial, len(fill.points)


def room_to_fill(limit: int, num_points: int) -> int:
    """How many points may be filled in beside so many sparse ones."""
    return max(limit - num_points, limit // 4)


def initial_gaussians(
    points: FloatArray, colors: NDArray[np.uint8], fill: AddedPoints, cameras: Cameras, config: TrainConfig, sky_rgb: FloatArray
) -> Splats:
    """The Gaussians of sparse points (P,3) and of those filled in, thinned out to the limit, and a
    sky of one colour (3,), that of no photograph where it is NaN, by the settings of training."""
    limit = config.max_num_splats
    rows = np.linspace(0, len(points) - 1, min(len(points), max(1, limit - len(fill.points)))).astype(np.int64)
    sky_color = sky_rgb if np.isfinite(sky_rgb).all() else np.array(SKY_RGB)
    initial = initial_splats(
        np.concatenate([points[rows], fill.points]),
        np.concatenate([colors[rows], fill.colors]),
        cameras,
        max_num_splats=limit,
        sh_degree=config.sh_degree,
        sky_rgb=sky_color if config.sky else None,
    )
    # The sky, last and almost opaque, keeps what it has.
    on_ground = initial.logit_opacities < 0
    logit = np.float32(np.log(config.initial_opacity / (1 - config.initial_opacity)))
    logits = np.where(on_ground, logit, initial.logit_opacities)
    initial = replace(initial, antialiased=config.antialiased, logit_opacities=logits)
    return lie_flat(initial, int(on_ground.sum()), config.initial_thickness)


def with_dense_points(initial: Splats, dense: DensePoints, max_num_splats: int) -> Splats:
    """The Gaussians (N,) that lie away from the dense points (P,), P at least 4, and a flat one on
    each of these: at most so many, of which the dense ones are thinned out first."""
    spacing = _neighbour_distance(dense.points)
    distances, nearest = KDTree(dense.points).query(initial.means)
    sparse_rows = np.flatnonzero(distances > REPLACED_SPACINGS * spacing[nearest])
    count = min(len(dense), max_num_splats - len(sparse_rows))
    chosen = np.linspace(0, len(dense) - 1, max(0, count)).astype(np.int64)
    flat = np.log(spacing[chosen, None] * np.array([1, 1, FLATNESS]))
    seeds = Splats(
        means=dense.points[chosen].astype(np.float32),
        quats=_turns_to(dense.normals[chosen]).astype(np.float32),
        log_scales=flat.astype(np.float32),
        logit_opacities=np.full(len(chosen), np.log(DENSE_OPACITY / (1 - DENSE_OPACITY)), np.float32),
        sh0=((dense.colors[chosen] / 255.0 - 0.5) / SH_C0)[:, None].astype(np.float32),
        shN=np.zeros((len(chosen), initial.shN.shape[1], 3), np.float32),
    )
    joined = concatenate_splats([seeds, initial.select(sparse_rows)])
    return joined.select(morton_order(joined.means))


def _turns_to(normals: FloatArray) -> FloatArray:
    """Quaternions wxyz (N,4) that turn the z axis to unit normals (N,3)."""
    x, y, z = normals.T
    quats = np.stack([1 + z, -y, x, np.zeros(len(z))], axis=1)
    # Straight down every half turn about a horizontal axis does.
    quats[1 + z < 1e-6] = (0, 1, 0, 0)
    return quats / np.linalg.norm(quats, axis=1, keepdims=True)


def sky_share(cameras: Cameras) -> float:
    """Share above the horizon (z up) of the image that has most of it, estimated from a 9×9 grid of
    pixels per camera."""
    return float(_above_horizon(cameras)[1].mean(axis=1).max(initial=0.0))


def _above_horizon(cameras: Cameras) -> tuple[FloatArray, NDArray[np.bool_]]:
    """A 9×9 grid of pixels per camera (C,81,2) px, and whether each looks above the horizon."""
    steps = (np.arange(9) + 0.5) / 9
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    pixels = grid[None] * cameras.sizes_wh[:, None]
    rays = np.concatenate([pixels, np.ones((*pixels.shape[:2], 1))], axis=-1)
    in_camera = np.einsum("cij,cpj->cpi", np.linalg.inv(cameras.Ks), rays)
    return pixels, np.einsum("ci,cpi->cp", cameras.cam_from_world[:, :3, 2], in_camera) > 0


def sky_rgb_of(views: TrainingViews) -> FloatArray:
    """Median colour (3,) in 0..1 of the pixels above the horizon, of a 9×9 grid per photograph; NaN
    without any."""
    pixels, above = _above_horizon(views.cameras)
    samples = np.zeros((0, 3), np.uint8)
    for index, (image, grid, up) in enumerate(zip(views.images, pixels.astype(np.int64), above, strict=True)):
        columns, rows = grid[up].T
        counts = np.ones(len(rows), bool) if views.weights is None else views.weights[index][rows, columns] > 0
        samples = np.concatenate([samples, image[rows[counts], columns[counts]]])
    return np.median(samples, axis=0) / 255 if len(samples) else np.full(3, np.nan)


def _neighbour_distance(points: FloatArray) -> FloatArray:
    """Root mean square distance (P,) to the 3 nearest neighbours, at most 3 times the 90th
    percentile: lone points, often wrong, would cover the image, and a step took 8 times as long."""
    distances, _ = KDTree(points).query(points, k=4)
    spacing = np.sqrt((distances[:, 1:] ** 2).mean(axis=1))
    return np.clip(spacing, 1e-7, 3 * np.quantile(spacing, 0.9))


def _sky_points(points: FloatArray, cameras: Cameras, count: int) -> FloatArray:
    """Points (count,3) on a half sphere far around everything; none where hardly any image looks
    up."""
    if not require(SKY, {"share": sky_share(cameras)}).values["built"]:
        return np.zeros((0, 3))
    everything = np.concatenate([points, cameras.centers])
    low, high = np.quantile(everything, [0.02, 0.98], axis=0)
    radius = 4 * float(np.linalg.norm(high - low))
    # Fibonacci lattice: even area per point; from 3° below the horizon, where distant ground ends.
    index = np.arange(count) + 0.5
    z = np.sin(np.radians(-3)) + (1 - np.sin(np.radians(-3))) * index / count
    angle = np.pi * (1 + np.sqrt(5)) * index
    shell = np.stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z], axis=1)
    return (low + high) / 2 + radius * shell


def lie_flat(splats: Splats, count: int, thinnest: float) -> Splats:
    """The model with its first `count` Gaussians, isotropic ones, flat in the plane of their
    neighbours, as much shorter across it as these spread less there, at least `thinnest` (0 to 1)
    as thick as wide; as it is with too few for a plane."""
    if count <= PLANE_NEIGHBOURS or thinnest >= 1:
        return splats
    places = splats.means[:count].astype(np.float64)
    spreads, axes = _local_axes(places)
    ratio = np.sqrt(spreads[:, 0] / np.maximum(spreads[:, 1], 1e-300))
    # The axis across the plane is the first one; a right-handed frame.
    axes[:, :, 2] *= np.sign(np.linalg.det(axes))[:, None]
    quats, log_scales = splats.quats.copy(), splats.log_scales.copy()
    quats[:count] = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    log_scales[:count, 0] += np.log(np.clip(ratio, thinnest, 1.0)).astype(np.float32)
    return replace(splats, quats=quats, log_scales=log_scales)


def _local_axes(places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Variances (P,3), ascending, and axes (P,3,3) in columns, of every place's neighbours."""
    around = places[KDTree(places).query(places, k=PLANE_NEIGHBOURS)[1]]
    around = around - around.mean(axis=1, keepdims=True)
    variances, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))
    return np.maximum(variances, 0.0), axes
