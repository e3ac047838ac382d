"""Pictures of the model by our own rasterizer over white: below a map, or in perspective.

From above a pinhole `ALTITUDE` map widths away stands for the orthographic camera that the
rasterizer lacks: rays are off the vertical by at most 1 / (2 · `ALTITUDE`). Gaussians are moved to
the middle of the picture in float64 first. One render per picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.splats import Splats
from radiant_viewer.layers.layer import Layer
from radiant_viewer.pictures.images import Drawing, Image
from radiant_viewer.pictures.offscreen import draw_map, fit_distance

ALTITUDE = 100.0
CEILING = 40.0
"""What stands higher over the middle ground than roofs and trees is sky or haze and left out."""
DIRECTION_DEG = (205, 42)
"""Azimuth from north and elevation from which a whole model is seen."""
KEPT_WHITE_PX = 7.5
"""White within this distance of a marker belongs to the marker."""
NEAR_SHARE = 1e-3
_FINE = 4
"""OpenCV draws lines at 1/16 pixels: coordinates are given in 2⁻⁴."""


def draw_ground_map(layers: Sequence[Layer], splats: Splats, size_wh: tuple[int, int]) -> Drawing:
    """Draw the map of `layers` as `draw_map` does, with the model from straight above where nothing
    is drawn."""
    drawing = draw_map(layers, size_wh)
    assert drawing.extent is not None
    ground = _render_from_above(splats, drawing.extent, size_wh)
    free = (drawing.image == 255).all(axis=2).astype(np.uint8)
    for x, y in drawing.mark_px:
        if -KEPT_WHITE_PX < x < size_wh[0] + KEPT_WHITE_PX and -KEPT_WHITE_PX < y < size_wh[1] + KEPT_WHITE_PX:
            cv2.circle(free, (round(float(x)), round(float(y))), int(KEPT_WHITE_PX), 0, -1)
    return replace(drawing, image=np.where(free[..., None] == 1, ground, drawing.image))


def draw_splat_view(layers: Sequence[Layer], splats: Splats, camera: Cameras) -> Drawing:
    """Draw the model for one camera, with the segments and labels of `layers` in front; BadInput
    for another number of cameras."""
    if len(camera) != 1:
        raise BadInput(f"{len(camera)} cameras came, expected one: choose it with Cameras.named.")
    width, height = (int(side) for side in camera.sizes_wh[0])
    image = _render_over_white(splats, camera)
    for layer in layers:
        _draw_segments(image, layer, camera)
    places = np.array([label.position for layer in layers for label in layer.labels], np.float64).reshape(-1, 3)
    in_camera = _to_camera_frame(places, camera)
    pixels = (in_camera @ camera.Ks[0].T)[:, :2] / np.where(in_camera[:, 2:] > 0, in_camera[:, 2:], np.nan)
    return Drawing(image=image.reshape(height, width, 3), label_px=pixels, mark_px=np.zeros((0, 2)), extent=None)


def fit_camera(positions: FloatArray, size_wh: tuple[int, int]) -> Cameras:
    """Return a camera of 30° that looks down from the south-west and has all positions (K,3) just
    inside its picture."""
    azimuth, elevation = np.radians(DIRECTION_DEG)
    toward = np.array([np.sin(azimuth) * np.cos(elevation), np.cos(azimuth) * np.cos(elevation), np.sin(elevation)])
    right = np.array([-np.cos(azimuth), np.sin(azimuth), 0.0])
    up = np.cross(toward, right)
    focal_px = max(size_wh) / 2 / np.tan(np.radians(15.0))
    middle = (positions.min(axis=0) + positions.max(axis=0)) / 2
    slopes = [(axis, 0.97 * side / 2 / focal_px) for axis, side in ((right, size_wh[0]), (up, size_wh[1]))]
    distance, offset = fit_distance(positions - middle, toward, slopes)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, -up, -toward])
    pose[:3, 3] = -pose[:3, :3] @ (middle + offset + distance * toward)
    K = np.array([[[focal_px, 0, size_wh[0] / 2], [0, focal_px, size_wh[1] / 2], [0, 0, 1]]])
    return Cameras(names=("view",), Ks=K, cam_from_world=pose[None], sizes_wh=np.array([size_wh], np.int64))


def _render_from_above(splats: Splats, extent: tuple[float, float, float, float], size_wh: tuple[int, int]) -> Image:
    x_min, x_max, y_min, y_max = extent
    middle = np.array([(x_min + x_max) / 2, (y_min + y_max) / 2, 0.0])
    half = np.array([x_max - x_min, y_max - y_min]) / 2
    inside = np.asarray((np.abs(splats.means[:, :2] - middle[:2]) <= half).all(axis=1))
    # Sky and haze above the scene would hide the ground.
    middle_m = float(np.median(splats.means[inside, 2])) if inside.any() else 0.0
    low = splats.select(np.flatnonzero(splats.means[:, 2] < middle_m + CEILING))
    ground = float(np.median(low.means[:, 2])) if len(low) else 0.0
    altitude = ALTITUDE * 2 * float(half.max())
    pose = np.eye(4)
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0])
    pose[:3, 3] = pose[:3, :3] @ -np.array([*middle[:2], ground + altitude])
    focal_px = altitude * size_wh[0] / (x_max - x_min)
    K = np.array([[[focal_px, 0, size_wh[0] / 2], [0, focal_px, size_wh[1] / 2], [0, 0, 1]]])
    return _render_over_white(low, Cameras(names=("above",), Ks=K, cam_from_world=pose[None], sizes_wh=np.array([size_wh], np.int64)))


def _render_over_white(splats: Splats, camera: Cameras) -> Image:
    """Render (H,W,3) over white, in coordinates near the camera."""
    center = np.round(camera.centers[0])
    pose = camera.cam_from_world.copy()
    pose[:, :3, 3] += pose[:, :3, :3] @ center
    moved = replace(splats, means=(splats.means.astype(np.float64) - center).astype(np.float32))
    # It imports torch, two seconds that a window need not wait.
    from radiant_core.render.rendered_view import render_views

    (view,) = render_views(moved, replace(camera, cam_from_world=pose))
    return np.rint(255 * np.clip(view.image + 1 - view.alpha[..., None], 0, 1)).astype(np.uint8)


def _draw_segments(image: Image, layer: Layer, camera: Cameras) -> None:
    """Draw the lines of one layer, clipped where they pass behind the camera."""
    ends = _to_camera_frame(layer.segments.reshape(-1, 3), camera).reshape(-1, 2, 3)
    near = NEAR_SHARE * max(float(np.abs(ends[..., 2]).max(initial=0.0)), 1e-9)
    limit = 8 * max(image.shape)
    for pair, color in zip(ends, layer.segment_colors, strict=True):
        behind = pair[:, 2] < near
        if behind.all():
            continue
        if behind.any():
            pair[behind] = pair[0] + (near - pair[0, 2]) / (pair[1, 2] - pair[0, 2]) * (pair[1] - pair[0])
        pixels = pair @ camera.Ks[0].T
        pixels = np.clip(pixels[:, :2] / pixels[:, 2:] - 0.5, -limit, limit)
        fixed = np.rint(pixels * 2**_FINE).astype(np.int64).tolist()
        shade = tuple(int(channel) for channel in color)
        cv2.line(image, fixed[0], fixed[1], shade, max(1, round(layer.line_width_px)), cv2.LINE_AA, _FINE)


def _to_camera_frame(positions: FloatArray, camera: Cameras) -> FloatArray:
    pose = camera.cam_from_world[0]
    return positions @ pose[:3, :3].T + pose[:3, 3]
