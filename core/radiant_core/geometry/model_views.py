"""Rendered views of a model, and what a point in one shows in another. Per pair and round.

A point u of a hub view is followed into another view in two steps: the rendered depth predicts
where every pixel of the hub lies there, the other view is warped by that into the hub, and
Lucas–Kanade finds what is left between the two, forth and back. The rendered depth need only be
near: what counts is which rays meet, and `triangulate` intersects them. Measured on the town, depth
itself is off by 0.2 to 0.6 m, the intersection by 0.06 m (docs/experiments/frames.md). Sources:
Lucas and Kanade, IJCAI (1981); Hartley and Sturm, Triangulation (1997) for the least squares over
reprojection errors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.frames import Sim3
from radiant_core.numerics import FloatArray
from radiant_core.render.rendered_view import RenderedView, render_views
from radiant_core.splats import Splats

LONG_SIDE_PX = 400
MIN_ALPHA = 0.5
MAP_STEP_PX = 4
MAX_FLOW_PX = 20.0
MAX_RETURN_PX = 0.3
SIGMA_PX = 0.5
CONTRAST_SIGMA_PX = 8.0
WINDOW_PX = (15, 15)
NUM_ITERATIONS = 8
NUM_LEVELS = 2
MIN_Z, MAX_Z = 1e-6, 1e12
"""Depths (m) of a point that a camera holds."""
MAX_TANGENT = 1e6
"""Largest |x/z|, |y/z| of it: nearer to the camera's plane float64 loses the Jacobian."""
MIN_CURVATURE = 1e-13
"""Share of the trace of a point's normal matrix added to each axis: above the rounding of float64,
below what two rays fix."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelViews:
    """V cameras of at most 400 px with what the model shows there; grey (H,W) uint8 is without
    local brightness and contrast, so that exposures do not matter."""

    cameras: Cameras
    views: tuple[RenderedView, ...]
    grey: tuple[NDArray[np.uint8], ...]

    @staticmethod
    def of(splats: Splats, cameras: Cameras) -> ModelViews:
        """Render a model at all `cameras`."""
        small = cameras.scaled(LONG_SIDE_PX)
        views = tuple(render_views(splats, small))
        return ModelViews(cameras=small, views=views, grey=tuple(level_contrast(view) for view in views))

    def lift(self, index: int, pixels: FloatArray) -> tuple[FloatArray, FloatArray]:
        """World points (N,3) at the rendered depths (N,) of pixels (N,2) of one view."""
        depths = sample_bilinear(self.views[index].depth, pixels)
        K, pose = self.cameras.Ks[index], self.cameras.cam_from_world[index]
        in_camera = np.column_stack([(pixels - K[:2, 2]) / K[[0, 1], [0, 1]], np.ones(len(pixels))]) * depths[:, None]
        return (in_camera - pose[:3, 3]) @ pose[:3, :3], depths

    def project(self, index: int, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pixels (N,2) and depths (N,) of world points (N,3) in one view; pixels mean nothing where
        the depth is not positive."""
        K, pose = self.cameras.Ks[index], self.cameras.cam_from_world[index]
        in_camera = points @ pose[:3, :3].T + pose[:3, 3]
        depths = in_camera[:, 2]
        return in_camera[:, :2] / np.maximum(depths, MIN_Z)[:, None] * K[[0, 1], [0, 1]] + K[:2, 2], depths


def level_contrast(view: RenderedView) -> NDArray[np.uint8]:
    """Grey values (H,W) less their local mean, by their local standard deviation."""
    grey = cv2.cvtColor(view.image * np.float32(255), cv2.COLOR_RGB2GRAY)
    detail = grey - cv2.GaussianBlur(grey, (0, 0), CONTRAST_SIGMA_PX)
    deviation = np.sqrt(cv2.GaussianBlur(detail * detail, (0, 0), CONTRAST_SIGMA_PX))
    return np.clip(128 + 40 * detail / np.maximum(deviation, 2.0), 0, 255).astype(np.uint8)


def sample_bilinear(image: NDArray[Any], pixels: FloatArray) -> FloatArray:
    """Bilinear values (N,) at pixels (N,2), 0 outside."""
    if not len(pixels):
        return np.zeros(0)
    x, y = (np.ascontiguousarray(axis, np.float32) for axis in (pixels - 0.5).T)
    values = cv2.remap(image, x[None], y[None], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    return values[0].astype(np.float64)


def corners(views: ModelViews, index: int, count: int) -> FloatArray:
    """At most `count` well textured pixels (N,2) where the model is (Shi and Tomasi, CVPR 1994)."""
    mask = (views.views[index].alpha > MIN_ALPHA).astype(np.uint8)
    points = cv2.goodFeaturesToTrack(views.grey[index], count, 0.01, 6, mask=mask)
    return np.zeros((0, 2)) if points is None else points[:, 0].astype(np.float64) + 0.5


def hub_map(hub: ModelViews, index: int) -> tuple[FloatArray, tuple[int, int]]:
    """World points (G,3) of a coarse grid over one view, and that grid's (height, width)."""
    depth = hub.views[index].depth
    height, width = depth.shape
    rows, columns = max(2, height // MAP_STEP_PX), max(2, width // MAP_STEP_PX)
    x, y = np.meshgrid((np.arange(columns) + 0.5) * width / columns, (np.arange(rows) + 0.5) * height / rows)
    return hub.lift(index, np.column_stack([x.ravel(), y.ravel()]))[0], (rows, columns)


@dataclass(frozen=True, kw_only=True, eq=False)
class Hub:
    """A view whose points (N,2) px are followed, with a coarse grid of its world points (G,3)."""

    views: ModelViews
    index: int
    pixels: FloatArray
    grid: FloatArray
    grid_shape: tuple[int, int]


@dataclass(frozen=True, kw_only=True, eq=False)
class Rays:
    """O observations: camera index (O,), point index (O,), pixel (O,2)."""

    cameras: NDArray[np.int64]
    points: NDArray[np.int64]
    pixels: FloatArray


def follow(
    hub: Hub, other_views: ModelViews, index: int, other_from_hub: Sim3, max_depth_error: float, wanted: NDArray[np.bool_] | None = None
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Where the hub's points (N,2) lie in view `index` of `other_views` (N,2) px, and which (N,)
    were found there and back, of those `wanted` (N,) alone. A pixel is hidden where the other
    view's rendered depth differs by more than the share `max_depth_error`."""
    grey = hub.views.grey[hub.index]
    height, width = grey.shape
    there, depths = other_views.project(index, other_from_hub.apply(hub.grid))
    maps = [
        cv2.resize(np.ascontiguousarray(values.reshape(hub.grid_shape), np.float32), (width, height))
        for values in (there[:, 0] - 0.5, there[:, 1] - 0.5, depths)
    ]

    def warp(image: NDArray[Any]) -> NDArray[Any]:
        return cv2.remap(image, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)

    view = other_views.views[index]
    visible = (warp(view.alpha) > MIN_ALPHA) & (np.abs(warp(view.depth) - maps[2]) < max_depth_error * maps[2])
    followed = hub.pixels.copy()
    good = _at(visible, hub.pixels) if wanted is None else wanted & _at(visible, hub.pixels)
    if not good.any():
        return followed, good
    image = warp(other_views.grey[index])
    # Points are followed one by one: each that is out already would cost as much as the others.
    chosen = np.flatnonzero(good)
    start = (hub.pixels[chosen] - 0.5).astype(np.float32)[:, None]
    forth, is_tracked = _flow(grey, image, start)
    landed = forth[:, 0].astype(np.float64) + 0.5
    near = is_tracked & (np.linalg.norm(landed - hub.pixels[chosen], axis=1) < MAX_FLOW_PX) & _at(visible, landed)
    chosen, start, forth, landed = chosen[near], start[near], forth[near], landed[near]
    good = np.zeros(len(good), bool)
    if len(chosen):
        back, is_tracked = _flow(image, grey, forth)
        good[chosen] = is_tracked & (np.linalg.norm((back - start)[:, 0], axis=1) < MAX_RETURN_PX)
    followed[chosen] = np.column_stack([sample_bilinear(maps[0], landed), sample_bilinear(maps[1], landed)]) + 0.5
    return followed, good


def triangulate(cameras: Cameras, rays: Rays, start: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points (P,3) where O rays meet, by least squares of reprojection errors from `start` (P,3);
    their covariances (P,3,3) m² for 0.5 px of error and RMS errors (P,) px, both before the last
    step; infinite where the point then lay behind one of its cameras. Pixels must be finite."""
    points, num_points, point_rows = start.copy(), len(start), rays.points
    poses, Ks = cameras.cam_from_world[rays.cameras], cameras.Ks[rays.cameras]
    focal = Ks[:, [0, 1], [0, 1]]
    H, squares = np.zeros((num_points, 3, 3)), np.zeros(len(point_rows))
    for _ in range(NUM_ITERATIONS):
        in_camera = np.einsum("oij,oj->oi", poses[:, :3, :3], points[point_rows]) + poses[:, :3, 3]
        # A point that a step took behind a camera has no picture there: it no longer counts.
        ahead = (in_camera[:, 2] > MIN_Z) & (in_camera[:, 2] < MAX_Z)
        ahead &= np.abs(in_camera[:, :2]).max(axis=1) < MAX_TANGENT * np.where(ahead, in_camera[:, 2], 0)
        in_camera = np.where(ahead[:, None], in_camera, [0.0, 0.0, 1.0])
        z = in_camera[:, 2]
        residuals = rays.pixels - (in_camera[:, :2] / z[:, None] * focal + Ks[:, :2, 2])
        jacobian = np.zeros((len(point_rows), 2, 3))
        jacobian[:, 0, 0], jacobian[:, 1, 1] = focal.T / z
        jacobian[:, :, 2] = -focal * in_camera[:, :2] / (z * z)[:, None]
        jacobian = jacobian @ poses[:, :3, :3]
        squares = np.where(ahead, np.square(residuals).sum(axis=1), np.inf)
        weights = 1 / (1 + squares / (2 * SIGMA_PX) ** 2)
        H = np.zeros((num_points, 3, 3))
        gradient = np.zeros((num_points, 3))
        np.add.at(H, point_rows, np.einsum("o,oki,okj->oij", weights, jacobian, jacobian) / SIGMA_PX**2)
        np.add.at(gradient, point_rows, np.einsum("o,oki,ok->oi", weights, jacobian, residuals) / SIGMA_PX**2)
        # A lone ray, or parallel ones, leave a direction open: 1e-6/m² holds it, and the covariance
        # of 1000² m² says so; a share of the trace where float64 would round that away.
        H += (1e-6 + MIN_CURVATURE * np.trace(H, axis1=1, axis2=2))[:, None, None] * np.eye(3)
        points = points + np.linalg.solve(H, gradient[..., None])[..., 0]
    counts = np.maximum(1, np.bincount(point_rows, minlength=num_points))
    rms_px = np.sqrt(np.bincount(point_rows, squares, minlength=num_points) / counts)
    return points, np.asarray(np.linalg.inv(H), np.float64), rms_px


def _flow(first: NDArray[Any], second: NDArray[Any], start: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Positions (N,1,2) of points (N,1,2) in the other image, and which (N,) were found."""
    positions, status, _ = cv2.calcOpticalFlowPyrLK(
        first, second, start, start.copy(), winSize=WINDOW_PX, maxLevel=NUM_LEVELS, flags=cv2.OPTFLOW_USE_INITIAL_FLOW
    )
    return positions, status[:, 0] > 0


def _at(mask: NDArray[np.bool_], pixels: FloatArray) -> NDArray[np.bool_]:
    height, width = mask.shape
    x, y = np.floor(pixels).astype(np.int64).T
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    return inside & mask[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)]
