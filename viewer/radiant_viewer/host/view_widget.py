"""`ViewWidget`: the widget of a view, painted by Qt alone, with the camera of what it shows.

    camera         where the view looks: moved by `Canvas.aim` and by the mouse
    shown camera   a copy, for which the picture of the model in the view was drawn: layers are
                   painted for it too, so that they lie where the model is

Once per frame. Needs the `desktop` extra.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pyvista as pv
from PySide6.QtCore import QTimer
from PySide6.QtGui import QResizeEvent
from pyvistaqt import QtInteractor
from vtkmodules.vtkCommonCore import vtkCommand

SAMPLES_AT_REST, SHARP_MS = 4, 350
"""Samples of a pixel in a view that has not moved for so long: the model in full comes before. Four
cost 55 ms of CPU a frame of 1280 × 800 px where OpenGL is drawn by the CPU, more than all else: a
moving view has one."""


class ViewWidget(QtInteractor):
    """A view that draws only when Qt paints it: pyvistaqt 0.13 draws for VTK and again for Qt."""

    _is_painting = False
    _kept_camera: pv.Camera | None = None
    _shown_camera: pv.Camera | None = None
    waits: Callable[[], bool] = staticmethod(lambda: False)
    """Whether a frame would be drawn in vain, since a picture of the model is on its way."""
    on_resize: Callable[[], None] = staticmethod(lambda: None)
    _painted_pose: tuple[object, ...] | None = None
    _rest_timer: QTimer | None = None

    def keep_camera(self) -> None:
        """Remember the camera: a picture of the model is requested for it."""
        self._kept_camera = _copy_to(self._kept_camera or pv.Camera(), self.camera)

    def show_kept_camera(self) -> None:
        """The picture has come: paint layers for its camera from now on."""
        assert self._kept_camera is not None, "a picture came that was not requested"
        self._shown_camera = _copy_to(self._shown_camera or pv.Camera(), self._kept_camera)

    def show_own_camera(self) -> None:
        """Paint layers for where the view looks: no picture of a model is shown."""
        self._shown_camera = None

    def come_to_rest(self) -> None:
        """Draw the next frame as one at rest, with all samples."""
        if self._rest_timer is not None:
            self._rest_timer.stop()
        self.render_window.SetMultiSamples(SAMPLES_AT_REST)

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Called by Qt."""
        super().resizeEvent(event)
        self.on_resize()

    def draw_once(self) -> None:
        """From the next paint on, let a frame that VTK's mouse styles request be painted by Qt."""
        self.iren.interactor.AddObserver(vtkCommand.RenderEvent, lambda *_: None if self._is_painting else self.update())

    def paintGL(self) -> None:
        """Called by Qt where pyvistaqt's widget is an OpenGL one; others draw as before."""
        interactor = self.iren.interactor
        self._is_painting = True
        if self.waits():
            # The last frame once more: pyvistaqt copies it and draws nothing while it is painting.
            self._in_paint = True
        else:
            self._choose_samples()
        interactor.EnableRenderOn()
        try:
            with self._drawn_for_shown_camera():
                super().paintGL()
        finally:
            interactor.EnableRenderOff()
            self._is_painting = self._in_paint = False

    @contextmanager
    def _drawn_for_shown_camera(self) -> Iterator[None]:
        if self._shown_camera is None:
            yield
            return
        self.renderer.SetActiveCamera(self._shown_camera)
        self.renderer.ResetCameraClippingRange()
        try:
            yield
        finally:
            self.renderer.SetActiveCamera(self.camera)

    def _choose_samples(self) -> None:
        camera = self.camera
        pose = (*camera.position, *camera.focal_point, *camera.up, camera.parallel_scale, camera.view_angle)
        if self._rest_timer is None:
            self._rest_timer = QTimer(self, singleShot=True, interval=SHARP_MS)
            self._rest_timer.timeout.connect(self.update)
        elif pose != self._painted_pose:
            self._rest_timer.start()
        self._painted_pose = pose
        self.render_window.SetMultiSamples(0 if self._rest_timer.isActive() else SAMPLES_AT_REST)


def _copy_to(copy: pv.Camera, camera: pv.Camera) -> pv.Camera:
    copy.DeepCopy(camera)
    # VTK's copy leaves its time of change as it was, and what is computed from it would stay.
    copy.Modified()
    return copy
