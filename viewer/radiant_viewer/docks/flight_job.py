"""Writes a film frame by frame through Qt's event loop, and composes its frames. Needs
the `desktop` extra."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pyvista as pv
from PySide6.QtCore import QObject, QTimer, Signal

from radiant_core.errors import RadiantError
from radiant_core.numerics import FloatArray
from radiant_viewer.layers.backdrop import Backdrop
from radiant_viewer.layers.drawing import add_layer
from radiant_viewer.layers.layer import Layer
from radiant_viewer.layers.themes import Theme, apply_theme
from radiant_viewer.pictures.images import Image
from radiant_viewer.pictures.movie import MovieWriter
from radiant_viewer.pictures.view_pose import ViewPose
from radiant_viewer.splats.splat_process import Frame, Part, SplatProcess

FrameDrawn = Callable[[Image], None]
Failed = Callable[[str], None]


class SceneFrames:
    """Frames of layers in 3D, drawn offscreen; with a model among them by depth, from our renderer
    in a process of its own."""

    def __init__(self, layers: Sequence[Layer], size_wh: tuple[int, int], origin: FloatArray, theme: Theme) -> None:
        self._origin, self._size_wh, self._theme = origin, size_wh, theme
        # Not by EGL: between frames Qt makes its own context the current one, unknown to VTK.
        self._plotter = pv.Plotter(off_screen=True, window_size=list(size_wh))
        self._plotter.background_color = pv.Color(theme.view)
        self._backdrop = Backdrop(self._plotter)
        for layer in layers:
            add_layer(self._plotter, apply_theme(layer, theme), origin)
        self._process: SplatProcess | None = None
        self._part = Part()
        self._on_frame: FrameDrawn = lambda image: None

    def add_model(self, parent: QObject, ply_path: Path, part: Part) -> None:
        """Show a part of the model of a file."""
        self._part = part
        self._process = SplatProcess(parent, ply_path)

    def begin(self, ready: Callable[[], None], on_frame: FrameDrawn, failed: Failed) -> None:
        """Call `ready` once `ask` may be called, `on_frame` per frame, `failed` with a sentence."""
        self._on_frame = on_frame
        if self._process is None:
            QTimer.singleShot(0, ready)
            return
        self._process.ready.connect(ready)
        self._process.frame_drawn.connect(self._on_model)
        self._process.failed.connect(failed)

    def ask(self, pose: ViewPose) -> None:
        """Draw one frame."""
        camera = self._plotter.camera
        camera.position, camera.focal_point = tuple(pose.position - self._origin), tuple(pose.focal_point - self._origin)
        camera.up, camera.view_angle = tuple(pose.up), pose.angle_deg
        self._plotter.renderer.reset_camera_clipping_range()
        if self._process is not None:
            self._process.ask(0, pose.camera(self._size_wh), self._theme.view, self._part)
            return
        # Through the event loop, so that a long flight does not nest one call in another.
        QTimer.singleShot(0, self._draw)

    def end(self) -> None:
        """Free its resources."""
        self._on_frame = lambda image: None
        if self._process is not None:
            self._process.end()
        self._plotter.close()

    def _on_model(self, frame: Frame) -> None:
        self._backdrop.show(frame.picture)
        self._draw()

    def _draw(self) -> None:
        if self._plotter.render_window is None:
            return
        # Without it, every screenshot would show the first frame.
        self._plotter.render()
        pixels = self._plotter.screenshot(return_img=True)
        assert pixels is not None
        self._on_frame(np.asarray(pixels, np.uint8))


class FlightJob(QObject):
    """Writes a frame per pose; emits `ended` once, with what was written or why nothing was."""

    progressed = Signal(int)
    ended = Signal(str)

    def __init__(self, parent: QObject, poses: Sequence[ViewPose], writer: MovieWriter, frames: SceneFrames) -> None:
        super().__init__(parent)
        self._poses, self._writer, self._frames = poses, writer, frames
        self._next = 0
        self._is_over = False

    def begin(self) -> None:
        """Request the first frame."""
        self._frames.begin(self._ask, self._on_drawn, self._on_failed)

    def give_up(self) -> None:
        """Cancel the film and delete its file."""
        self._on_failed("given up")

    def _ask(self) -> None:
        if not self._is_over:
            self._frames.ask(self._poses[self._next])

    def _on_drawn(self, image: Image) -> None:
        if self._is_over:
            return
        try:
            self._writer.add(image)
            self._next += 1
            self.progressed.emit(self._next)
            if self._next < len(self._poses):
                self._ask()
                return
            self._writer.finish()
        except (RadiantError, OSError) as error:
            self._on_failed(str(error))
            return
        self._end(f"Saved {self._next} frames to {self._writer.path}")

    def _on_failed(self, reason: str) -> None:
        if not self._is_over:
            self._writer.discard()
            self._end(f"No film was written: {reason}")

    def _end(self, message: str) -> None:
        self._is_over = True
        self._frames.end()
        self.ended.emit(message)
