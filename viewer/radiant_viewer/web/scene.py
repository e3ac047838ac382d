"""`WebScene`: map and 3D view of the web page, rendered offscreen, without browser or server.

Both hold the same layers relative to one float64 origin. Frames are drawn when the page asks.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
import pyvista as pv
from vtkmodules.vtkCommonCore import vtkCommand
from vtkmodules.vtkRenderingCore import vtkProp

from radiant_core.numerics import FloatArray
from radiant_viewer.layers.drawing import SLOTS_PER_LAYER, add_layer
from radiant_viewer.layers.layer import Layer, framing_positions
from radiant_viewer.layers.map_labels import add_map_labels
from radiant_viewer.layers.point_detail import Later, PointDetail
from radiant_viewer.layers.themes import LIGHT, Theme, apply_theme
from radiant_viewer.pictures.images import Image
from radiant_viewer.pictures.offscreen import aim_camera, egl_rendering
from radiant_viewer.pictures.view_pose import ViewPose

TOP_SLOT = 400
"""Slot of the marks on the map: above a hundred layers."""
FIRST_SIZE_WH = (480, 400)
MAX_LABELS, LABEL_SIZE = 40, 13
SAMPLES = 4
"""Samples per pixel; eight take twice the time on a software rasterizer."""


class WebView:
    """The map or the 3D view."""

    def __init__(self, *, is_map: bool, origin: FloatArray, later: Later) -> None:
        self.is_map, self.origin = is_map, origin
        self.actors: dict[str, list[vtkProp]] = {}
        self._wanted: tuple[float, float] | None = None
        self._set_scale = 0.0
        with egl_rendering():
            self.plotter = pv.Plotter(off_screen=True, window_size=list(FIRST_SIZE_WH))
        window = self.plotter.render_window
        assert window is not None
        window.SetMultiSamples(SAMPLES)
        self.detail = PointDetail(self.plotter, later)
        interactor = self.plotter.iren
        assert interactor is not None
        if is_map:
            self.plotter.camera.parallel_projection = True
            interactor.enable_custom_trackball_style(left="pan", shift_left="pan", control_left="pan", middle="pan", right="dolly")
        else:
            interactor.enable_terrain_style(mouse_wheel_zooms=True, shift_pans=True)
        # Frames are rendered when the page requests them.
        window.GetInteractor().EnableRenderOff()
        self._size_wh = (float(FIRST_SIZE_WH[0]), float(FIRST_SIZE_WH[1]))
        if is_map:
            window.AddObserver(vtkCommand.WindowResizeEvent, lambda *_: self._refit())

    def draw(self, layer: Layer, slot: int, theme: Theme, *, visible: bool) -> None:
        """Draw a layer in place of the one of its name; on a map higher slots cover lower ones."""
        self.remove(layer.name)
        height = float(SLOTS_PER_LAYER * slot) if self.is_map else None
        actors: list[vtkProp] = [*add_layer(self.plotter, apply_theme(layer, theme), self.origin, flat_height=height, detail=self.detail)]
        if layer.labels and height is not None:
            actors.append(add_map_labels(self.plotter, layer.labels[:MAX_LABELS], self.origin, height, theme, LABEL_SIZE))
        self.actors[layer.name] = actors
        self.show(layer.name, visible)
        # Frames keep their clipping range: without this a new mark might be cut off.
        self.plotter.renderer.reset_camera_clipping_range()

    def remove(self, name: str) -> None:
        """Remove a layer, if it is drawn."""
        for actor in self.actors.pop(name, []):
            self.plotter.renderer.remove_actor(actor, render=False)

    def show(self, name: str, visible: bool) -> None:
        """Show or hide a layer."""
        for actor in self.actors.get(name, []):
            actor.SetVisibility(visible)

    def fit(self, positions: FloatArray) -> None:
        """Fit positions (K,3) of the world into the view; a map looks straight down, north up."""
        local = positions - self.origin
        camera = self.plotter.camera
        if not self.is_map:
            camera.view_angle = 30.0
            aim_camera(self.plotter, local)
            return
        low, high = local.min(axis=0), local.max(axis=0)
        self._look_down((low[:2] + high[:2]) / 2)
        spans = high - low
        self._want(0.54 * float(spans[0]), 0.54 * float(spans[1]))
        self.plotter.renderer.reset_camera_clipping_range()

    def picture(self) -> Image:
        """What it shows now, (H,W,3)."""
        pixels = self.plotter.screenshot(return_img=True)
        assert pixels is not None, "an array was asked for"
        return np.ascontiguousarray(pixels[..., :3])

    def _want(self, half_width: float, half_height: float) -> None:
        """Let the map show so much to either side of its middle, whatever the shape of its pane."""
        width, height = self.plotter.window_size
        self._wanted, self._size_wh = (half_width, half_height), (float(width), float(height))
        self.plotter.camera.parallel_scale = self._set_scale = max(half_height, half_width * height / max(width, 1), 1e-6)

    def _refit(self) -> None:
        """Keep in sight what was, where the pane has another shape now; what somebody has zoomed to
        since is what was in sight."""
        scale, (width, height) = self.plotter.camera.parallel_scale, self._size_wh
        if self._wanted is None or abs(scale - self._set_scale) > 1e-6 * scale:
            self._wanted = scale * width / max(height, 1.0), scale
        self._want(*self._wanted)

    def look(self, pose: ViewPose, reach: float) -> None:
        """Move to a pose of the world; a map shows `reach` on either side of the focal point."""
        camera = self.plotter.camera
        if self.is_map:
            self._look_down(pose.focal_point[:2] - self.origin[:2])
            self._want(reach, reach)
        else:
            camera.focal_point = tuple(pose.focal_point - self.origin)
            camera.position = tuple(pose.position - self.origin)
            camera.up, camera.view_angle = tuple(pose.up), pose.angle_deg
        self.plotter.renderer.reset_camera_clipping_range()

    def _look_down(self, middle: FloatArray) -> None:
        camera, (x, y) = self.plotter.camera, (float(value) for value in middle)
        camera.focal_point, camera.position, camera.up = (x, y, 0.0), (x, y, float(SLOTS_PER_LAYER * (TOP_SLOT + 8))), (0.0, 1.0, 0.0)


class WebScene:
    """Map and 3D view of the same layers; `later` as in `PointDetail`; framed (K,3): where the
    scene is."""

    def __init__(
        self, layers: Sequence[Layer], hidden: Collection[str], later: Later, theme: Theme = LIGHT, framed: FloatArray | None = None
    ) -> None:
        self.layers = list(layers)
        self.visible = {layer.name for layer in layers} - set(hidden)
        self.theme, self._framed = theme, framed
        self.mark: Layer | None = None
        positions = framing_positions(self.layers)
        self.origin: FloatArray = (positions.min(axis=0) + positions.max(axis=0)) / 2
        self.map, self.view = (WebView(is_map=is_map, origin=self.origin, later=later) for is_map in (True, False))
        self.set_theme(theme)
        self.fit()

    @property
    def views(self) -> tuple[WebView, WebView]:
        """Map, then 3D."""
        return self.map, self.view

    def set_theme(self, theme: Theme) -> None:
        """Draw all layers under a theme."""
        self.theme = theme
        for view in self.views:
            view.plotter.background_color = pv.Color(theme.view)
            for slot, layer in enumerate(self.layers):
                view.draw(layer, slot, theme, visible=layer.name in self.visible)
        self.set_mark(self.mark)

    def add_layer(self, layer: Layer, *, visible: bool = True) -> None:
        """Add a layer over the others."""
        self.layers.append(layer)
        if visible:
            self.visible.add(layer.name)
        for view in self.views:
            view.draw(layer, len(self.layers) - 1, self.theme, visible=visible)

    def set_visible(self, names: Collection[str]) -> None:
        """Show the layers of these names and hide all others."""
        self.visible = set(names)
        for view in self.views:
            for layer in self.layers:
                view.show(layer.name, layer.name in self.visible)

    def set_mark(self, mark: Layer | None) -> None:
        """Draw a mark over all layers in place of the previous one; it is in no list."""
        for view in self.views:
            if self.mark is not None:
                view.remove(self.mark.name)
            if mark is not None:
                view.draw(mark, TOP_SLOT, self.theme, visible=True)
        self.mark = mark

    def fit(self) -> None:
        """Fit the scene into both views, or all layers where nothing says where it is."""
        positions = framing_positions(self.layers) if self._framed is None else self._framed
        for view in self.views:
            view.fit(positions)

    def look(self, pose: ViewPose, reach: float) -> None:
        """Move both views to a pose."""
        for view in self.views:
            view.look(pose, reach)

    def close(self) -> None:
        """Free both views."""
        for view in self.views:
            view.plotter.close()
