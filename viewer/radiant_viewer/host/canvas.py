"""`Canvas`: one view of the window, a map or 3D: layers as actors, projections, and clicks.

Coordinates of the world are float64; VTK sees them relative to `origin`. A click is a press and
release within 4 px. Needs the `desktop` extra.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import cast

import numpy as np
import pyvista as pv
from PySide6.QtCore import QEvent, QObject, QPointF, Qt, QTimer
from PySide6.QtGui import QMouseEvent
from PySide6.QtWidgets import QHBoxLayout, QLabel, QSizePolicy, QVBoxLayout, QWidget
from vtkmodules.vtkCommonCore import vtkCommand
from vtkmodules.vtkRenderingCore import vtkProp

from radiant_core.numerics import FloatArray, check_array
from radiant_viewer.host.navigator import Navigator
from radiant_viewer.host.scale_bar import ScaleBar
from radiant_viewer.host.view_widget import SAMPLES_AT_REST, ViewWidget
from radiant_viewer.layers.backdrop import Backdrop
from radiant_viewer.layers.depth_picture import Rgbd
from radiant_viewer.layers.drawing import SLOTS_PER_LAYER, add_layer, has_same_structure, update_layer
from radiant_viewer.layers.layer import CLOUD_SIZE, Layer
from radiant_viewer.layers.map_labels import add_map_labels
from radiant_viewer.layers.point_detail import PointDetail
from radiant_viewer.layers.themes import LIGHT, Theme, apply_theme
from radiant_viewer.pictures.images import Image
from radiant_viewer.pictures.offscreen import fitting_pose
from radiant_viewer.pictures.view_pose import ViewPose

CLICK_PX = 4
LABEL_SIZE = 11
CLOUD_POINT_PX, CLOUD_POINT_3D_PX = 2.6, 3.2
PICTURE_FILL = 0.3
"""Opacity of regions over an orthophoto."""
TOP_SLOT = 400
"""Slot of the map on which marks of selections and tools lie: above a hundred layers."""
MAP_EYE = float(SLOTS_PER_LAYER * (TOP_SLOT + 8))
"""Height of the map's eye over its layers, which heights only order."""
FIT_ANGLE_DEG = 30.0
PAUSE_S, MOST_BEFORE = 0.8, 50
"""Rest after which a new move begins; how many can be taken back."""
ClickTaker = Callable[["Canvas", tuple[int, int]], bool]
"""Takes the canvas and the pixel (x, y from the lower left); returns whether it used the click."""


class Canvas:
    """A plotter with a heading; a click goes to the first of `click_takers` that uses it."""

    def __init__(self, parent: QWidget, title: str, *, is_map: bool, origin: FloatArray, unit: str = "m") -> None:
        self.is_map, self.origin, self.theme = is_map, origin, LIGHT
        self.actors: dict[str, list[vtkProp]] = {}
        self._drawn_layers: dict[str, tuple[Theme, int, Layer]] = {}
        self.click_takers: list[ClickTaker] = []
        self.fill_opacity = 1.0
        self.frame = QWidget(parent)
        layout = QVBoxLayout(self.frame)
        layout.setContentsMargins(4, 2, 4, 4)
        layout.setSpacing(2)
        heading = QLabel(title)
        heading.setStyleSheet("font-weight: 600")
        top = QHBoxLayout()
        top.addWidget(heading)
        self.note = QLabel()
        """What the view says of itself, beside its title."""
        self.note.setProperty("soft", "true")
        # A long note must not widen the view.
        self.note.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        top.addWidget(self.note, stretch=1)
        layout.addLayout(top)
        self.plotter = ViewWidget(self.frame, auto_update=False, multi_samples=SAMPLES_AT_REST)
        # Else the first look at the camera, and the first layer, would each draw a frame.
        self.plotter.camera_set = True
        # VTK's own keys would end the view (q, e) or draw wires (w); the window has its own.
        self.plotter.reset_key_events()
        self.plotter.iren.interactor.RemoveObservers("CharEvent")
        self.plotter.setToolTip("")
        self.plotter.draw_once()
        self.detail = PointDetail(
            self.plotter,
            later=lambda seconds, call: QTimer.singleShot(int(1000 * seconds), self.frame, call),
            redraw=self.plotter.update,
        )
        self.backdrop = Backdrop(self.plotter)
        self.before_screenshot: Callable[[], None] = lambda: None
        self.show_message: Callable[[str], None] = lambda words: None
        self.ground_under: Callable[[FloatArray], float | None] = lambda place: None
        self._seen_before: deque[ViewPose] = deque(maxlen=MOST_BEFORE)
        self._aimed_s = -np.inf
        layout.addWidget(self.plotter, stretch=1)
        # By Qt: some of VTK's styles keep the release of a button to themselves.
        self._clicks = _ClickFilter(self.plotter, self._on_click)
        if not is_map:
            self.navigator = Navigator(self)
        else:
            self.scale_bar = ScaleBar(self.frame, unit)
            top.addWidget(self.scale_bar)
            self.plotter.renderer.AddObserver(vtkCommand.StartEvent, self._show_scale)
        self.set_theme(LIGHT)

    def set_theme(self, theme: Theme) -> None:
        """The background; layers are recoloured when they are drawn again."""
        self.theme = theme
        self.plotter.background_color = pv.Color(theme.view)

    def draw(self, layer: Layer, slot: int, *, visible: bool = True) -> None:
        """Draw a layer in place of the one of its name; on a map higher slots cover lower ones."""
        height = float(SLOTS_PER_LAYER * slot)
        flat_height = height if self.is_map else None
        themed, before = apply_theme(layer, self.theme), self._drawn_layers.get(layer.name)
        if (
            before is not None
            and before[:2] == (self.theme, slot)
            and has_same_structure(before[2], themed)
            and _same_labels(before[2], themed)
        ):
            actors = self.actors[layer.name][: -1 if layer.labels and self.is_map else None]
            update_layer(cast("list[pv.Actor]", actors), themed, self.origin, flat_height)
            self._drawn_layers[layer.name] = (self.theme, slot, themed)
            self.show(layer.name, visible)
            return
        self.remove(layer.name)
        # Points and lines are in pixels of the screen, however dense; VTK scales letters alone.
        scale = self.plotter.devicePixelRatioF()
        actors = add_layer(self.plotter, themed, self.origin, line_scale=scale, flat_height=flat_height, detail=self.detail)
        if layer.polygons and self.is_map:
            actors[0].prop.opacity = self.shown_fill_opacity
        self.actors[layer.name], self._drawn_layers[layer.name] = [*actors], (self.theme, slot, themed)
        if len(layer.points) >= CLOUD_SIZE and not layer.point_rim:
            for actor in actors[-1:]:
                # A view has a quarter of a picture's size: points as large would bury the rest.
                actor.prop.point_size = (CLOUD_POINT_PX if self.is_map else CLOUD_POINT_3D_PX) * scale
        if layer.labels and self.is_map:
            self.actors[layer.name].append(add_map_labels(self.plotter, layer.labels, self.origin, height, self.theme, LABEL_SIZE))
        self.show(layer.name, visible)

    def set_fill_opacity(self, opacity: float) -> None:
        """Let polygons of a map show (less than 1) or hide what lies below them."""
        self.fill_opacity = opacity
        self._fill()

    @property
    def shown_fill_opacity(self) -> float:
        """Of the map's polygons: over an orthophoto they always show what is below."""
        pictures = [name for name, (_, _, layer) in self._drawn_layers.items() if layer.picture is not None]
        over_picture = any(actor.GetVisibility() for name in pictures for actor in self.actors[name])
        return min(self.fill_opacity, PICTURE_FILL) if over_picture else self.fill_opacity

    def _fill(self) -> None:
        for name, (_, _, layer) in self._drawn_layers.items():
            if layer.polygons and self.is_map:
                cast("list[pv.Actor]", self.actors[name])[0].prop.opacity = self.shown_fill_opacity

    def remove(self, name: str) -> None:
        """Remove a layer, if it is drawn."""
        self._drawn_layers.pop(name, None)
        for actor in self.actors.pop(name, []):
            self.plotter.remove_actor(actor, render=False)

    def show(self, name: str, visible: bool) -> None:
        """Show or hide the actors of a layer."""
        for actor in self.actors.get(name, []):
            actor.SetVisibility(visible)
        if name in self._drawn_layers and self._drawn_layers[name][2].picture is not None:
            self._fill()

    def render(self) -> None:
        """Request a frame; several requests before Qt paints give one. A picture of the model that
        is on its way will request its own."""
        self.plotter.renderer.reset_camera_clipping_range()
        if not self.plotter.waits():
            self.plotter.update()

    def depth_at(self, pixel: tuple[float, float], reach: int = 0) -> float | None:
        """How far along the view the model under a pixel (x, y from the upper left) is, or at the
        nearest one up to `reach` pixels of the picture away: between Gaussians there are holes."""
        picture, (width, height) = self.backdrop.picture, self.size_wh
        if picture is None or not (0 <= pixel[0] < width and 0 <= pixel[1] < height):
            return None
        row, column = (int(share * side) for share, side in zip((pixel[1] / height, pixel[0] / width), picture.shape[:2], strict=True))
        low_row, low_column = max(0, row - reach), max(0, column - reach)
        near = picture[low_row : row + reach + 1, low_column : column + reach + 1, 3]
        rows, columns = np.nonzero(near > 0)
        if not len(rows):
            return None
        nearest = int(np.argmin(np.hypot(rows + low_row - row, columns + low_column - column)))
        return float(near[rows[nearest], columns[nearest]])

    def depth_ahead(self, share: float) -> float | None:
        """How far along the view the model is, but for this share of its pixels; None without
        any."""
        if (picture := self.backdrop.picture) is None:
            return None
        # A sixteenth of the pixels says as much.
        depths = picture[::4, ::4, 3]
        return float(np.quantile(depths[depths > 0], share)) if (depths > 0).any() else None

    def ground_below(self, place: FloatArray) -> float | None:
        """Height of the ground under a place (3,), if known."""
        return self.ground_under(place)

    def say(self, words: str) -> None:
        """Tell the user."""
        self.show_message(words)

    def go_back(self) -> None:
        """See what was seen before the last move."""
        if not self._seen_before:
            self.show_message("There is no view before this one")
            return
        pose, self._aimed_s = self._seen_before.pop(), time.monotonic()
        self.set_pose(pose)

    def watch_camera(self, moved: Callable[[], None]) -> None:
        """Call `moved` whenever the camera or the size of the view changes."""
        self.plotter.camera.AddObserver(vtkCommand.ModifiedEvent, lambda *_: moved())
        self.plotter.on_resize = moved

    def show_model(self, picture: Rgbd, *, is_coarse: bool) -> None:
        """Show a picture (H,W,4) of the model for the kept camera, and the layers as it sees
        them."""
        self.backdrop.show(picture, is_coarse=is_coarse)
        self.plotter.show_kept_camera()
        self.plotter.update()

    def show_layers_alone(self) -> None:
        """Show no model."""
        self.backdrop.hide()
        self.plotter.show_own_camera()
        self.plotter.update()

    def screenshot(self) -> Image:
        """Return what the view shows at rest, (H,W,3)."""
        self.before_screenshot()
        self.detail.refine()
        self.plotter.come_to_rest()
        # Now, whatever frame waits for Qt.
        self.plotter.renderer.reset_camera_clipping_range()
        self.plotter.render()
        pixels = self.plotter.screenshot(return_img=True)
        assert pixels is not None
        return np.asarray(pixels, np.uint8)

    @property
    def size_wh(self) -> tuple[int, int]:
        """Size of the picture, px."""
        width, height = self.plotter.window_size
        return int(width), int(height)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """West, south, east and north side of the map."""
        camera, (width, height) = self.plotter.camera, self.size_wh
        x, y = (float(camera.focal_point[axis] + self.origin[axis]) for axis in range(2))
        half = float(camera.parallel_scale)
        across = half * width / max(height, 1)
        return x - across, y - half, x + across, y + half

    @property
    def pose(self) -> ViewPose:
        """The camera of the view in the world."""
        camera = self.plotter.camera
        return ViewPose(
            position=np.array(camera.position) + self.origin,
            focal_point=np.array(camera.focal_point) + self.origin,
            up=np.array(camera.up),
            angle_deg=float(camera.view_angle),
        )

    def set_pose(self, pose: ViewPose) -> None:
        """Move the camera; a map keeps looking straight down, centred on the focal point."""
        if self.is_map:
            self.center_on(pose.focal_point[:2])
        else:
            self._aim(pose.position - self.origin, pose.focal_point - self.origin, pose.up, angle_deg=pose.angle_deg)

    def center_on(self, place: FloatArray, half_height: float | None = None) -> None:
        """Centre the map on `place` (2,), with `half_height` of the world above and below."""
        assert self.is_map, "a view in perspective has no middle on the ground"
        x, y = (float(value) for value in np.asarray(place) - self.origin[:2])
        self._aim(np.array([x, y, MAP_EYE]), np.array([x, y, 0.0]), np.array([0.0, 1, 0]), half_height=half_height)

    def fit(self, positions: FloatArray) -> None:
        """Fit positions (K,3) of the world into the view; a map looks straight down, north up."""
        if not self.is_map:
            self.set_pose(fitting_pose(positions, self.size_wh, FIT_ANGLE_DEG))
            return
        low, high = positions.min(axis=0), positions.max(axis=0)
        self.plotter.enable_parallel_projection()
        # A map is moved by dragging it.
        self.plotter.enable_custom_trackball_style(left="pan", shift_left="pan", control_left="pan", middle="pan", right="dolly")
        width, height = self.size_wh
        across, along = high[:2] - low[:2]
        self.center_on((low[:2] + high[:2]) / 2, 0.55 * float(max(along, across * height / max(width, 1), 1e-6)))

    def _aim(
        self,
        position: FloatArray,
        focal_point: FloatArray,
        up: FloatArray,
        *,
        angle_deg: float | None = None,
        half_height: float | None = None,
    ) -> None:
        """Aim the camera, in coordinates relative to `origin`: all that moves it but the mouse on
        the map comes here. What depends on it follows: the range of depths, the picture of the
        model (`watch_camera`), and the next frame."""
        camera, now_s = self.plotter.camera, time.monotonic()
        # What is done without a pause is one move, to be taken back as one.
        if not self.is_map and now_s - self._aimed_s > PAUSE_S:
            self._seen_before.append(self.pose)
        self._aimed_s = now_s
        camera.focal_point, camera.position, camera.up = tuple(focal_point), tuple(position), tuple(up)
        if angle_deg is not None:
            camera.view_angle = angle_deg
        if half_height is not None:
            camera.parallel_scale = half_height
        self.render()

    def pixels_of(self, positions: FloatArray) -> FloatArray:
        """Project positions (K,3) of the world to pixels (K,2) from the lower left; NaN behind the
        camera."""
        width, height = self.size_wh
        matrix = self.plotter.camera.GetCompositeProjectionTransformMatrix(width / max(height, 1), -1, 1)
        projection = np.array([[matrix.GetElement(row, column) for column in range(4)] for row in range(4)])
        local = check_array("positions", positions, (None, 3)) - self.origin
        if self.is_map:
            local[:, 2] = 0
        clip = np.column_stack([local, np.ones(len(local))]) @ projection.T
        depth = np.where(clip[:, 3] > 0, clip[:, 3], np.nan)[:, None]
        return (clip[:, :2] / depth + 1) / 2 * (width, height)

    def ground_place(self, pixel: tuple[int, int]) -> FloatArray:
        """Return the place (2,) of the world under a pixel of the map."""
        assert self.is_map, "a view in perspective has no one place under a pixel"
        width, height = self.size_wh
        camera = self.plotter.camera
        per_px = 2 * camera.parallel_scale / max(height, 1)
        offset = (np.array(pixel, np.float64) + 0.5 - (width / 2, height / 2)) * per_px
        return np.array(camera.focal_point[:2]) + offset + self.origin[:2]

    def _show_scale(self, *_: object) -> None:
        self.scale_bar.show_scale(2 * float(self.plotter.camera.parallel_scale) / max(self.plotter.height(), 1))

    def _on_click(self, x: float, y: float) -> None:
        scale = self.plotter.devicePixelRatioF()
        pixel = (int(x * scale), int(self.size_wh[1] - 1 - y * scale))
        any(taker(self, pixel) for taker in self.click_takers)


class _ClickFilter(QObject):
    """Calls `clicked` with x and y from the upper left for a press and release in one place."""

    def __init__(self, watched: QWidget, clicked: Callable[[float, float], None]) -> None:
        super().__init__(watched)
        self._clicked = clicked
        self._pressed: QPointF | None = None
        watched.installEventFilter(self)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Watch the events; none is consumed."""
        if isinstance(event, QMouseEvent) and event.button() == Qt.MouseButton.LeftButton:
            if event.type() == QEvent.Type.MouseButtonPress:
                self._pressed = event.position()
            elif event.type() == QEvent.Type.MouseButtonRelease and self._pressed is not None:
                moved, self._pressed = event.position() - self._pressed, None
                if moved.manhattanLength() <= CLICK_PX:
                    self._clicked(event.position().x(), event.position().y())
        return False


def _same_labels(first: Layer, second: Layer) -> bool:
    texts = [[(label.text.splitlines()[0], label.position.tolist()) for label in one.labels] for one in (first, second)]
    return texts[0] == texts[1]
