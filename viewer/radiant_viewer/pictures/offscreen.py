"""Layers as pictures without a window: maps from above, views in perspective. 0.1 to 1 s each.

Drawn at twice the size and averaged, so that edges are smooth and the same on every machine. The
map is orthographic: px = (x − x_min) / (x_max − x_min) · W, rows downwards from y_max. Titles,
legend, scale and labels are laid out in `page.py`.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import cv2
import numpy as np
import pyvista as pv

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_viewer.layers.drawing import SLOTS_PER_LAYER, add_layer
from radiant_viewer.layers.layer import Layer, framing_positions
from radiant_viewer.layers.point_detail import PointDetail
from radiant_viewer.pictures.images import Drawing, Image
from radiant_viewer.pictures.page import PageText, compose_page, drawing_size_wh
from radiant_viewer.pictures.view_pose import ViewPose

OVERSAMPLING = 2
MARGIN = 0.06
"""Empty share of the map on each side."""
MAX_SIDE_PX = 4096


def render_map(layers: Sequence[Layer], size_wh: tuple[int, int] = (1280, 900), text: PageText | None = None) -> Image:
    """Return a finished map (H,W,3) with title, axes, scale bar, legend and labels; BadInput
    without any geometry."""
    page = text or PageText()
    return compose_page(draw_map(layers, drawing_size_wh(size_wh, is_map=True)), layers, size_wh, page)


def render_view(layers: Sequence[Layer], size_wh: tuple[int, int] = (1280, 900), text: PageText | None = None) -> Image:
    """Return a finished view (H,W,3) in perspective; BadInput without anything to draw."""
    page = text or PageText()
    return compose_page(draw_view(layers, drawing_size_wh(size_wh, is_map=False)), layers, size_wh, page)


def draw_map(layers: Sequence[Layer], size_wh: tuple[int, int]) -> Drawing:
    """Draw layers from straight above; later layers cover earlier ones, whatever their heights."""
    _require_size(size_wh)
    positions = framing_positions(layers)[:, :2]
    extent = _fit_extent(positions.min(axis=0), positions.max(axis=0), size_wh)
    origin = np.array([(extent[0] + extent[1]) / 2, (extent[2] + extent[3]) / 2, 0.0])
    top = float(SLOTS_PER_LAYER * (len(layers) + 1))
    with offscreen_plotter(size_wh) as plotter:
        detail = PointDetail(plotter)
        for index, layer in enumerate(layers):
            add_layer(plotter, layer, origin, line_scale=OVERSAMPLING, flat_height=float(SLOTS_PER_LAYER * index), detail=detail)
        camera = plotter.camera
        camera.position, camera.focal_point, camera.up = (0.0, 0.0, top), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)
        camera.parallel_projection = True
        camera.parallel_scale = (extent[3] - extent[2]) / 2
        camera.clipping_range = (0.5, top + 1)
        image = averaged_screenshot(plotter)
    label_px, mark_px = (_map_px(places, extent, size_wh) for places in (label_places(layers), marked_places(layers)))
    return Drawing(image=image, label_px=label_px, mark_px=mark_px, extent=extent)


def draw_view(layers: Sequence[Layer], size_wh: tuple[int, int], direction_deg: tuple[float, float] = (205, 42)) -> Drawing:
    """Draw layers in perspective, all inside the picture, from (azimuth from north, elevation)."""
    _require_size(size_wh)
    positions = framing_positions(layers)
    origin = (positions.min(axis=0) + positions.max(axis=0)) / 2
    with offscreen_plotter(size_wh) as plotter:
        detail = PointDetail(plotter)
        for layer in layers:
            add_layer(plotter, layer, origin, line_scale=OVERSAMPLING, detail=detail)
        aim_camera(plotter, positions - origin, direction_deg)
        image = averaged_screenshot(plotter)
        label_px, mark_px = (_project(plotter, places - origin) * size_wh for places in (label_places(layers), marked_places(layers)))
    return Drawing(image=image, label_px=label_px, mark_px=mark_px, extent=None)


def aim_camera(plotter: pv.Plotter, positions: FloatArray, direction_deg: tuple[float, float] = (205, 42)) -> None:
    """Look from (azimuth from north, elevation) so that positions (K,3) just fit the picture."""
    camera = plotter.camera
    width, height = plotter.window_size
    pose = fitting_pose(positions, (width, height), float(camera.view_angle), direction_deg)
    camera.focal_point, camera.position, camera.up = tuple(pose.focal_point), tuple(pose.position), tuple(pose.up)
    plotter.renderer.reset_camera_clipping_range()


def fitting_pose(
    positions: FloatArray, size_wh: tuple[int, int], angle_deg: float, direction_deg: tuple[float, float] = (205, 42)
) -> ViewPose:
    """The view of this angle from (azimuth from north, elevation) into whose picture positions
    (K,3) just fit."""
    azimuth, elevation = np.radians(direction_deg)
    toward = np.array([np.sin(azimuth) * np.cos(elevation), np.cos(azimuth) * np.cos(elevation), np.sin(elevation)])
    across = np.array([-np.cos(azimuth), np.sin(azimuth), 0.0])
    width, height = size_wh
    tangent = np.tan(np.radians(angle_deg / 2)) * (1 - MARGIN)
    middle = (positions.min(axis=0) + positions.max(axis=0)) / 2
    distance, away = fit_distance(positions - middle, toward, ((across, tangent * width / height), (np.cross(toward, across), tangent)))
    return ViewPose(position=middle + away + distance * toward, focal_point=middle + away, up=np.array([0.0, 0, 1]), angle_deg=angle_deg)


def fit_distance(positions: FloatArray, toward: FloatArray, slopes: Sequence[tuple[FloatArray, float]]) -> tuple[float, FloatArray]:
    """Return the least distance with all positions (K,3) in view, and the target (3,) to look at.

    `toward` (3,) points at the viewer; `slopes` holds per image axis (3,) the tangent k of half its
    angle. A position with coordinates x along the axis and t towards the viewer is in view for |x −
    c| ≤ (D − t) k, so D = (max(x + t k) − min(x − t k)) / 2k and c = (max(x + t k) + min(x − t k))
    / 2; the larger D of the axes counts.
    """
    depths = positions @ toward
    distance, target = 1e-3, np.zeros(3)
    for axis, slope in slopes:
        outer, inner = (positions @ axis + depths * slope).max(), (positions @ axis - depths * slope).min()
        distance = max(distance, float(outer - inner) / (2 * slope))
        target += axis * float(outer + inner) / 2
    return distance, target


def _require_size(size_wh: tuple[int, int]) -> None:
    if not all(16 <= side <= MAX_SIDE_PX for side in size_wh):
        raise BadInput(f"a picture of {size_wh[0]} × {size_wh[1]} px was asked for, expected 16 to {MAX_SIDE_PX} px a side.")


@contextmanager
def offscreen_plotter(size_wh: tuple[int, int]) -> Iterator[pv.Plotter]:
    """A white plotter without a window, `OVERSAMPLING` times as large as the picture."""
    width, height = size_wh
    with egl_rendering():
        plotter = pv.Plotter(off_screen=True, window_size=[OVERSAMPLING * width, OVERSAMPLING * height])
    try:
        plotter.background_color = pv.Color("white")
        yield plotter
    finally:
        plotter.close()


@contextmanager
def egl_rendering() -> Iterator[None]:
    """Let VTK render by EGL: a new window reads this variable, and else tries an X server first."""
    name = "VTK_DEFAULT_OPENGL_WINDOW"
    before = os.environ.get(name)
    os.environ[name] = before or "vtkEGLRenderWindow"
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]


def averaged_screenshot(plotter: pv.Plotter) -> Image:
    """The picture of an `offscreen_plotter`, averaged to its size."""
    pixels = plotter.screenshot(return_img=True)
    assert pixels is not None
    size_wh = (pixels.shape[1] // OVERSAMPLING, pixels.shape[0] // OVERSAMPLING)
    return np.asarray(cv2.resize(np.ascontiguousarray(pixels), size_wh, interpolation=cv2.INTER_AREA), np.uint8)


def _fit_extent(low: FloatArray, high: FloatArray, size_wh: tuple[int, int]) -> tuple[float, float, float, float]:
    """Return the smallest extent with the picture's proportions around a box, with a margin."""
    center, spans = (low + high) / 2, np.maximum(high - low, 1e-9)
    per_px = float((spans / (np.array(size_wh) * (1 - 2 * MARGIN))).max())
    # A single point has no extent: show a square metre around it.
    half = np.array(size_wh) * (per_px if spans.max() > 1e-6 else 1 / min(size_wh)) / 2
    return (float(center[0] - half[0]), float(center[0] + half[0]), float(center[1] - half[1]), float(center[1] + half[1]))


def marked_places(layers: Sequence[Layer]) -> FloatArray:
    """Return the points (M,3) that labels should not cover."""
    return np.concatenate([np.zeros((0, 3)), *(layer.points for layer in layers if layer.point_rim)])


def _map_px(places: FloatArray, extent: tuple[float, float, float, float], size_wh: tuple[int, int]) -> FloatArray:
    x_min, x_max, y_min, y_max = extent
    return np.column_stack([(places[:, 0] - x_min) / (x_max - x_min), (y_max - places[:, 1]) / (y_max - y_min)]) * size_wh


def label_places(layers: Sequence[Layer]) -> FloatArray:
    """Return the places (L,3) of all labels."""
    return np.array([label.position for layer in layers for label in layer.labels], np.float64).reshape(-1, 3)


def _project(plotter: pv.Plotter, places: FloatArray) -> FloatArray:
    """Project places (L,3) to shares (L,2) of the picture from the top left; NaN if behind."""
    width, height = plotter.window_size
    matrix = plotter.camera.GetCompositeProjectionTransformMatrix(width / height, -1, 1)
    projection = np.array([[matrix.GetElement(row, column) for column in range(4)] for row in range(4)])
    clip = np.column_stack([places, np.ones(len(places))]) @ projection.T
    depth = np.where(clip[:, 3] > 0, clip[:, 3], np.nan)[:, None]
    return (clip[:, :2] / depth * (1, -1) + 1) / 2
