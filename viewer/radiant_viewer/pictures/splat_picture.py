"""Pictures of the model by our own rasterizer over white: below a map, or in perspective.

From above a pinhole `ALTITUDE` map widths away stands for the orthographic camera that the
rasterizer lacks: rays are off the vertical by at most 1 / (2 · `ALTITUDE`). Gaussians are moved to
the middle of the picture in float64 first. One render per picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.render.reach import Reach
from radiant_core.splats import Splats
from radiant_viewer.layers.backdrop import Backdrop
from radiant_viewer.layers.depth_picture import OPAQUE
from radiant_viewer.layers.drawing import add_layer
from radiant_viewer.layers.layer import Layer
from radiant_viewer.pictures.images import Drawing, Image
from radiant_viewer.pictures.offscreen import (
    OVERSAMPLING,
    averaged_screenshot,
    draw_map,
    fit_distance,
    label_places,
    marked_places,
    offscreen_plotter,
)

if TYPE_CHECKING:
    from radiant_core.render.rendered_view import RenderedView

ALTITUDE = 100.0
CEILING = 40.0
"""What stands higher over the middle ground than roofs and trees is sky or haze and left out."""
DIRECTION_DEG = (205, 42)
"""Azimuth from north and elevation from which a whole model is seen."""
KEPT_WHITE_PX = 7.5
"""White within this distance of a marker belongs to the marker."""
NEAR_SHARE = 1e-3


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
    """Draw the model for one camera with `layers` before and behind it, by depth; BadInput for
    another number of cameras."""
    if len(camera) != 1:
        raise BadInput(f"{len(camera)} cameras came, expected one: choose it with Cameras.named.")
    width, height = (int(side) for side in camera.sizes_wh[0])
    picture = render_rgbd(splats, camera)
    origin = np.round(camera.centers[0])
    places, marks = label_places(layers), marked_places(layers)
    vertices = [np.zeros((0, 3))]
    vertices += [part for layer in layers for part in (layer.points, layer.segments.reshape(-1, 3), *layer.polygons)]
    depths = _to_camera_frame(np.concatenate(vertices), camera)[:, 2]
    far = 1.1 * max(float(depths.max(initial=0.0)), float(picture[..., 3].max(initial=0.0)), 1e-3)
    with offscreen_plotter((width, height)) as plotter:
        Backdrop(plotter).show(picture)
        for layer in layers:
            add_layer(plotter, layer, origin, line_scale=OVERSAMPLING)
        aim_as(plotter.camera, camera, origin, NEAR_SHARE * far, far)
        image = averaged_screenshot(plotter)
    return Drawing(image=image, label_px=_pixels(places, camera), mark_px=_pixels(marks, camera), extent=None)


def render_rgbd(splats: Splats, camera: Cameras) -> NDArray[np.float32]:
    """Render colour over white and depth (H,W,4), as a `Backdrop` takes it."""
    view = _render_near(splats, camera)
    over = np.clip(view.image + 1 - view.alpha[..., None], 0, 1)
    return np.dstack([over, np.where(view.alpha >= OPAQUE, view.depth, 0)]).astype(np.float32)


def draw_over_nothing(splats: Splats, camera: Cameras) -> NDArray[np.uint8]:
    """Draw the model for one camera as RGBA (H,W,4), transparent where there is none, for a page of any colour."""
    view = _render_near(splats, camera)
    # Colour is drawn over black, so it holds alpha already.
    color = view.image / np.maximum(view.alpha, 1 / 255)[..., None]
    return np.rint(255 * np.clip(np.dstack([color, view.alpha]), 0, 1)).astype(np.uint8)


def aim_as(vtk: pv.Camera, camera: Cameras, origin: FloatArray, near: float, far: float) -> None:
    """Let VTK's camera, in coordinates relative to `origin`, see what a pinhole camera sees."""
    rotation, (width, height), K = camera.cam_from_world[0, :3, :3], camera.sizes_wh[0], camera.Ks[0]
    position = camera.centers[0] - origin
    vtk.position, vtk.focal_point, vtk.up = tuple(position), tuple(position + rotation[2]), tuple(-rotation[1])
    vtk.clipping_range = (near, far)
    matrix = np.zeros((4, 4))
    matrix[0, 0], matrix[0, 2] = 2 * K[0, 0] / width, (width - 2 * K[0, 2]) / width
    matrix[1, 1], matrix[1, 2] = 2 * K[1, 1] / height, (2 * K[1, 2] - height) / height
    matrix[2, 2:] = -(far + near) / (far - near), -2 * far * near / (far - near)
    matrix[3, 2] = -1
    vtk.SetExplicitProjectionTransformMatrix(pv.vtkmatrix_from_array(matrix))
    vtk.UseExplicitProjectionTransformMatrixOn()


def _pixels(places: FloatArray, camera: Cameras) -> FloatArray:
    """Project places (K,3) to pixels (K,2), NaN behind the camera."""
    in_camera = _to_camera_frame(places, camera)
    return (in_camera @ camera.Ks[0].T)[:, :2] / np.where(in_camera[:, 2:] > 0, in_camera[:, 2:], np.nan)


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


@dataclass(frozen=True, kw_only=True)
class Ground:
    """Of a model seen from above: the height of its ground, and what is higher is sky or haze."""

    height: float
    ceiling: float

    @staticmethod
    def of(splats: Splats, inside: NDArray[np.bool_] | None = None) -> Ground:
        """Of the Gaussians inside a map, else of those around the model's middle."""
        heights = splats.means[:, 2]
        if inside is None:
            flat = splats.means[:, :2]
            low, high = np.quantile(flat, [0.1, 0.9], axis=0)
            inside = np.asarray(((flat >= low) & (flat <= high)).all(axis=1))
        ceiling = (float(np.median(heights[inside])) if inside.any() else 0.0) + CEILING
        below = heights[heights < ceiling]
        return Ground(height=float(np.median(below)) if len(below) else 0.0, ceiling=ceiling)


def camera_above(extent: tuple[float, float, float, float], size_wh: tuple[int, int], ground: float) -> Cameras:
    """Return the camera far above the middle of (x_min, x_max, y_min, y_max), north up, whose
    picture is that extent at the height `ground`."""
    x_min, x_max, y_min, y_max = extent
    altitude = ALTITUDE * max(x_max - x_min, y_max - y_min)
    pose = np.eye(4)
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0])
    pose[:3, 3] = pose[:3, :3] @ -np.array([(x_min + x_max) / 2, (y_min + y_max) / 2, ground + altitude])
    focal_px = altitude * size_wh[0] / (x_max - x_min)
    K = np.array([[[focal_px, 0, size_wh[0] / 2], [0, focal_px, size_wh[1] / 2], [0, 0, 1]]])
    return Cameras(names=("above",), Ks=K, cam_from_world=pose[None], sizes_wh=np.array([size_wh], np.int64))


def _render_from_above(splats: Splats, extent: tuple[float, float, float, float], size_wh: tuple[int, int]) -> Image:
    x_min, x_max, y_min, y_max = extent
    flat = splats.means[:, :2]
    ground = Ground.of(splats, np.asarray(((flat >= (x_min, y_min)) & (flat <= (x_max, y_max))).all(axis=1)))
    # Sky and haze above the scene would hide the ground.
    low = splats.select(np.flatnonzero(splats.means[:, 2] < ground.ceiling))
    return render_over_white(low, camera_above(extent, size_wh, ground.height))


def render_over_white(splats: Splats, camera: Cameras) -> Image:
    """Render (H,W,3) over white."""
    view = _render_near(splats, camera)
    return np.rint(255 * np.clip(view.image + 1 - view.alpha[..., None], 0, 1)).astype(np.uint8)


def _render_near(splats: Splats, camera: Cameras) -> RenderedView:
    """Render in coordinates near the camera, without what lies far before the scene."""
    near_m = Reach.of(splats).near_m(camera) if len(splats) else None
    center = np.round(camera.centers[0])
    pose = camera.cam_from_world.copy()
    pose[:, :3, 3] += pose[:, :3, :3] @ center
    moved = replace(splats, means=(splats.means.astype(np.float64) - center).astype(np.float32))
    # It imports torch, two seconds that a window need not wait.
    from radiant_core.render.rendered_view import render_views

    return next(render_views(moved, replace(camera, cam_from_world=pose), near_m=near_m))


def _to_camera_frame(positions: FloatArray, camera: Cameras) -> FloatArray:
    pose = camera.cam_from_world[0]
    return positions @ pose[:3, :3].T + pose[:3, 3]
