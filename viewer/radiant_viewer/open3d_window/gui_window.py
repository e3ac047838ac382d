"""Open3D's window: the scene at the left, a box and a legend per layer at the right. Once per
window; a frame takes Open3D as long as its renderer needs."""

from __future__ import annotations

import signal
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.numerics import FloatArray
from radiant_viewer.layers.layer import Layer
from radiant_viewer.open3d_window.content import Content
from radiant_viewer.open3d_window.parts import MODEL, Part

PANEL_EM = 17
TICKS_AT_END = 5
HELP = "Left drag: turn.  Ctrl and left drag: move.\nWheel: nearer.  F: all.  T: from above."
FRONT_DEG = 45.0


def show_window(content: Content, size_wh: tuple[int, int], photograph: str | None) -> int:
    """Show the window until it is closed or the process is asked to end; returns the exit code."""
    from open3d.visualization import gui

    app: Any = gui.Application.instance
    app.initialize()
    window = _Window(app, content, size_wh, photograph)
    stopped: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda caught, _: stopped.append(caught))
    while app.run_one_tick() and not stopped:
        pass
    if stopped:
        window.window.close()
        # Open3D closes its window in its own ticks.
        for _ in range(TICKS_AT_END):
            app.run_one_tick()
    app.quit()
    return 128 + stopped[0] if stopped else 0


class _Window:
    """The widgets of one window."""

    def __init__(self, app: Any, content: Content, size_wh: tuple[int, int], photograph: str | None) -> None:
        from open3d.visualization import gui, rendering

        self._content, self._gui = content, gui
        self.window: Any = app.create_window(f"Radiant: {content.subject.path.resolve().name}", *size_wh)
        self._scene: Any = gui.SceneWidget()
        self._scene.scene = rendering.Open3DScene(self.window.renderer)
        self._scene.scene.set_background(np.ones(4))
        self._panel: Any = gui.ScrollableVert(4, gui.Margins(8, 8, 8, 8))
        self._labels: dict[str, list[Any]] = {}
        if (model := content.model()) is not None:
            assert content.splats is not None
            self._add(MODEL, [model], f"{len(content.splats):,} Gaussians", ())
        for layer in reversed(content.layers):
            self._add(layer.name, content.parts(layer), layer.name, tuple((entry.text, entry.color) for entry in layer.legend))
            self._show(layer.name, content.parts(layer), layer, layer.name not in content.hidden)
        self._panel.add_child(gui.Label(HELP))
        self._panel.add_child(gui.Label(content.subject.summary.replace(", ", "\n")))
        self.window.add_child(self._scene)
        self.window.add_child(self._panel)
        self.window.set_on_layout(self._lay_out)
        self.window.set_on_key(self._on_key)
        self._look(content.view(size_wh, photograph))

    def _add(self, name: str, parts: list[Part], title: str, legend: tuple[tuple[str, tuple[int, int, int]], ...]) -> None:
        gui = self._gui
        for part in parts:
            self._scene.scene.add_geometry(part.name, part.geometry, part.material)
        box: Any = gui.Checkbox(title)
        box.checked = name not in self._content.hidden
        layer = next((one for one in self._content.layers if one.name == name), None)
        box.set_on_checked(partial(self._show, name, parts, layer))
        self._panel.add_child(box)
        for text, color in legend:
            line: Any = gui.Label(f"    {text}")
            line.text_color = gui.Color(*(max(channel, 90) / 255 for channel in color))
            self._panel.add_child(line)

    def _show(self, name: str, parts: list[Part], layer: Layer | None, visible: bool) -> None:
        for part in parts:
            self._scene.scene.show_geometry(part.name, visible)
        for label in self._labels.pop(name, []):
            self._scene.remove_3d_label(label)
        if visible and layer is not None and layer.labels:
            self._labels[name] = [
                self._scene.add_3d_label(label.position - self._content.origin + (0, 0, self._content.lift), label.text)
                for label in layer.labels
            ]
        self._scene.force_redraw()

    def _lay_out(self, _: Any) -> None:
        room = self.window.content_rect
        width = min(PANEL_EM * self.window.theme.font_size, room.width // 2)
        self._scene.frame = self._gui.Rect(room.x, room.y, room.width - width, room.height)
        self._panel.frame = self._gui.Rect(room.get_right() - width, room.y, width, room.height)

    def _look(self, camera: Cameras) -> None:
        """See the scene as a camera does, its focal point on the ground of the scene."""
        pose = camera.cam_from_world[0]
        center = camera.centers[0] - self._content.origin
        distance = max(float(np.linalg.norm(center)), 1e-3)
        height = float(camera.sizes_wh[0, 1])
        angle_deg = float(2 * np.degrees(np.arctan(height / 2 / camera.Ks[0, 1, 1])))
        self._aim(angle_deg, center, center + distance * pose[2, :3], -pose[1, :3])

    def _aim(self, angle_deg: float, eye: FloatArray, target: FloatArray, up: FloatArray) -> None:
        import open3d as o3d

        reach = float(np.linalg.norm(eye - target))
        bounds = o3d.geometry.AxisAlignedBoundingBox(np.full(3, -reach), np.full(3, reach))
        self._scene.setup_camera(angle_deg, bounds, np.zeros(3))
        self._scene.look_at(target, eye, up)

    def _on_key(self, event: Any) -> bool:
        gui = self._gui
        camera = self._content.view((int(self._scene.frame.width), int(self._scene.frame.height)))
        actions: dict[Any, Callable[[], None]] = {
            gui.KeyName.F: lambda: self._look(camera),
            gui.KeyName.T: lambda: self._from_above(camera),
        }
        if event.type != gui.KeyEvent.DOWN or event.key not in actions:
            return False
        actions[event.key]()
        return True

    def _from_above(self, camera: Cameras) -> None:
        distance = float(np.linalg.norm(camera.centers[0] - self._content.origin))
        self._aim(FRONT_DEG, np.array([0.0, 0, distance]), np.zeros(3), np.array([0.0, 1, 0]))
