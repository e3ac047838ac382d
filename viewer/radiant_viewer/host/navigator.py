"""`Navigator`: mouse and keys of the 3D view. Needs the `desktop` extra.

    left drag             orbit about what is under the pointer
    middle, Shift+left    pan it
    right drag            look around; with W A S D, Q and E held as well, fly; the wheel then sets
                          how fast
    wheel                 come nearer to what is under the pointer
    double click          look at it from half the distance

A flight covers a share of the distance to what is ahead per second, so that it slows down before
it, and stays over the ground unless Q sinks below it.

It listens as VTK's interactor style, so that a widget in the view, such as the crop box, gets the
mouse first.
"""

from __future__ import annotations

import time
from typing import Protocol

import numpy as np
from PySide6.QtCore import QEvent, QObject, Qt, QTimer
from PySide6.QtGui import QKeyEvent, QMouseEvent
from pyvistaqt import QtInteractor
from vtkmodules.vtkCommonCore import vtkCommand
from vtkmodules.vtkInteractionStyle import vtkInteractorStyleUser

from radiant_core.numerics import FloatArray
from radiant_viewer.pictures import view_motion
from radiant_viewer.pictures.view_pose import ViewPose

DEG_PER_VIEW, WHEEL_FACTOR = 200.0, 0.85
"""Turn for a drag across the whole view; distance left after one step of the wheel."""
FLIGHT_MS, FLIGHT_SHARE = 15, 0.6
"""Time between steps of a flight; share of the distance to what is ahead flown per second."""
LONGEST_STEP_S = 0.1
"""A flight that was held up does not make up for it by a leap."""
SPEEDS, SPEED_FACTOR = (0.1, 10.0), 1.25
"""Least and most times as fast as usual; one step of the wheel."""
CLEARANCE = 0.02
"""Least height over the ground that a flight keeps, as a share of its height when it began."""
NEAR_SHARE = 0.1
"""This share of what is in sight may be nearer than what counts as ahead."""
FLIGHT_KEYS = {
    Qt.Key.Key_D: (1, 0, 0), Qt.Key.Key_A: (-1, 0, 0), Qt.Key.Key_W: (0, 1, 0),
    Qt.Key.Key_S: (0, -1, 0), Qt.Key.Key_E: (0, 0, 1), Qt.Key.Key_Q: (0, 0, -1),
}  # fmt: skip
"""Steps right, forward and up."""


class Moved(Protocol):
    """The view whose camera is moved."""

    @property
    def plotter(self) -> QtInteractor:
        """Its widget."""
        ...

    @property
    def pose(self) -> ViewPose:
        """The camera in the world."""
        ...

    @property
    def size_wh(self) -> tuple[int, int]:
        """Size of the picture, px."""
        ...

    def set_pose(self, pose: ViewPose) -> None:
        """Move the camera."""
        ...

    def render(self) -> None:
        """Request a frame."""
        ...

    def depth_at(self, pixel: tuple[float, float]) -> float | None:
        """How far along the view what is under a pixel (x, y from upper left) lies, if known."""
        ...

    def depth_ahead(self, share: float) -> float | None:
        """How far along the view the model is, but for this share of its pixels; None without
        any."""
        ...

    def ground_below(self, place: FloatArray) -> float | None:
        """Height of the ground under a place (3,), if known."""
        ...

    def say(self, words: str) -> None:
        """Tell the user."""
        ...


class Navigator(QObject):
    """Moves the camera of `canvas`."""

    def __init__(self, canvas: Moved) -> None:
        super().__init__(canvas.plotter)
        self._canvas = canvas
        self._button = ""
        self._from, self._pivot = (0, 0), np.zeros(3)
        self._pressed_keys: dict[int, tuple[int, int, int]] = {}
        self._flight, self._flown_s = QTimer(self), 0.0
        self._speed, self._clearance = 1.0, 0.0
        self._flight.setInterval(FLIGHT_MS)
        self._flight.timeout.connect(self._fly_on)
        self._style = vtkInteractorStyleUser()
        for button, pressed, released in (
            ("Left", vtkCommand.LeftButtonPressEvent, vtkCommand.LeftButtonReleaseEvent),
            ("Middle", vtkCommand.MiddleButtonPressEvent, vtkCommand.MiddleButtonReleaseEvent),
            ("Right", vtkCommand.RightButtonPressEvent, vtkCommand.RightButtonReleaseEvent),
        ):
            self._style.AddObserver(pressed, lambda *_, button=button: self._press(button))
            self._style.AddObserver(released, lambda *_: self._release())
        self._style.AddObserver(vtkCommand.MouseMoveEvent, lambda *_: self._drag())
        self._style.AddObserver(vtkCommand.MouseWheelForwardEvent, lambda *_: self._zoom(WHEEL_FACTOR))
        self._style.AddObserver(vtkCommand.MouseWheelBackwardEvent, lambda *_: self._zoom(1 / WHEEL_FACTOR))
        canvas.plotter.iren.interactor.SetInteractorStyle(self._style)
        canvas.plotter.installEventFilter(self)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """While the right button is held, keys fly; else they are the window's."""
        if event.type() == QEvent.Type.FocusOut:
            self._release()
        if isinstance(event, QMouseEvent) and event.type() == QEvent.Type.MouseButtonDblClick:
            # VTK's interactor takes it for another press.
            scale = self._canvas.plotter.devicePixelRatioF()
            self._focus((int(event.position().x() * scale), int(event.position().y() * scale)))
            return True
        if not isinstance(event, QKeyEvent) or event.key() not in FLIGHT_KEYS:
            return False
        if event.type() == QEvent.Type.KeyRelease and not event.isAutoRepeat():
            self._pressed_keys.pop(event.key(), None)
        elif self._button == "Right" and event.type() in (QEvent.Type.ShortcutOverride, QEvent.Type.KeyPress):
            if not self._pressed_keys:
                self._flown_s = time.monotonic()
                self._clearance = CLEARANCE * max(self._over_ground(self._canvas.pose), 0.0)
                self._flight.start()
            self._pressed_keys[event.key()] = FLIGHT_KEYS[Qt.Key(event.key())]
            event.accept()
            return True
        return False

    def _at(self) -> tuple[int, int]:
        x, y = self._canvas.plotter.iren.interactor.GetEventPosition()
        return int(x), int(self._canvas.size_wh[1] - 1 - y)

    def _place(self, pixel: tuple[int, int]) -> FloatArray:
        """What is under a pixel, else what is there as far away as the focal point."""
        pose = self._canvas.pose
        return view_motion.place_at(pose, pixel, self._canvas.size_wh, self._canvas.depth_at(pixel) or pose.distance)

    def _press(self, button: str) -> None:
        shifted = self._canvas.plotter.iren.interactor.GetShiftKey()
        self._button = "Middle" if button == "Left" and shifted else button
        self._from = self._at()
        self._pivot = self._place(self._from)

    def _release(self) -> None:
        self._button = ""
        self._pressed_keys.clear()
        self._flight.stop()

    def _drag(self) -> None:
        if not self._button:
            return
        (x, y), before = self._at(), self._from
        right, up = x - before[0], before[1] - y
        self._from = (x, y)
        pose, height = self._canvas.pose, self._canvas.size_wh[1]
        per_px = DEG_PER_VIEW / height
        if self._button == "Left":
            self._go(view_motion.orbit(pose, per_px * right, per_px * up, self._pivot))
        elif self._button == "Middle":
            depth = float(pose.rotation[2] @ (self._pivot - pose.position))
            self._go(view_motion.pan(pose, right, up, height, max(depth, view_motion.NEAREST)))
        else:
            turn = pose.angle_deg / height
            self._go(view_motion.look(pose, turn * right, turn * up))

    def _zoom(self, factor: float) -> None:
        if self._button == "Right":
            change = SPEED_FACTOR if factor < 1 else 1 / SPEED_FACTOR
            self._speed = float(np.clip(self._speed * change, *SPEEDS))
            self._canvas.say(f"Flying {self._speed:.2g} times as fast as usual; W A S D, Q and E fly")
            return
        self._go(view_motion.zoom_to(self._canvas.pose, self._place(self._at()), factor))

    def _focus(self, pixel: tuple[int, int]) -> None:
        self._release()
        self._go(view_motion.focus(self._canvas.pose, self._place(pixel)))

    def _fly_on(self) -> None:
        now = time.monotonic()
        if not self._pressed_keys:
            self._flight.stop()
            return
        pose = self._canvas.pose
        ahead = self._canvas.depth_ahead(NEAR_SHARE) or pose.distance
        reach = FLIGHT_SHARE * self._speed * ahead * min(now - self._flown_s, LONGEST_STEP_S)
        self._flown_s = now
        right, forward, up = (reach * float(step) for step in np.sum([*self._pressed_keys.values()], axis=0))
        self._go(self._kept_over_ground(pose, view_motion.fly(pose, right, forward, up)))

    def _over_ground(self, pose: ViewPose) -> float:
        """Height of the eye over the ground; infinite where that is not known."""
        ground = self._canvas.ground_below(pose.position)
        return np.inf if ground is None else float(pose.position[2]) - ground

    def _kept_over_ground(self, before: ViewPose, after: ViewPose) -> ViewPose:
        """A step of a flight, lifted where it would go below the ground; not from below it, and not
        where Q is held."""
        low = self._clearance - self._over_ground(after)
        if low <= 0 or self._over_ground(before) < 0 or Qt.Key.Key_Q in self._pressed_keys or not np.isfinite(low):
            return after
        return view_motion.shift(after, np.array([0.0, 0.0, low]))

    def _go(self, pose: ViewPose) -> None:
        self._canvas.set_pose(pose)
        self._canvas.render()
