"""Lasso and brush in the 3D view: Gaussians chosen by areas of the screen. Needs the `desktop`
extra.

    drag                add what lies in the area
    Ctrl or Alt, drag   take it away again
    right, middle, wheel  move the view as always

By default only what is seen counts: up to the depth of the picture under the area (`Front`). The
strokes are places of the view, not Gaussians, so that they can be kept as a rule.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QEvent, QObject, QPointF, Qt, Signal
from PySide6.QtGui import QColor, QMouseEvent, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import QWidget

from radiant_core.errors import BadInput
from radiant_core.geometry.selection import MAX_CELLS, Front, Stroke, bounds_of, chosen_by
from radiant_core.numerics import FloatArray
from radiant_viewer.host.canvas import Canvas

Mode = Literal["", "lasso", "brush"]
STEP_PX = 3.0
"""Places of a path are this far apart on the screen."""
USUAL_RADIUS_PX = 24
ADDS, TAKES = QColor(255, 140, 0), QColor(60, 170, 255)


class SelectTool(QObject):
    """`strokes` of the selection so far, and the Gaussians that are `chosen`; `changed` after
    each."""

    changed = Signal()

    def __init__(self, canvas: Canvas, means: Callable[[], NDArray[np.float32]]) -> None:
        super().__init__(canvas.plotter)
        self._canvas, self._means = canvas, means
        self.mode: Mode = ""
        self.radius_px, self.is_through = USUAL_RADIUS_PX, False
        self.strokes: tuple[Stroke, ...] = ()
        self._undone: tuple[Stroke, ...] = ()
        self.chosen: NDArray[np.bool_] = np.zeros(0, bool)
        self._path: list[tuple[float, float]] = []
        self._takes_away = False
        self._overlay = _Overlay(canvas.plotter, self)
        canvas.plotter.installEventFilter(self)

    def set_mode(self, mode: Mode) -> None:
        """Take the drags of the left button from now on, or leave them to the view."""
        self.mode = mode
        self._path = []
        self._canvas.plotter.setCursor(Qt.CursorShape.CrossCursor if mode else Qt.CursorShape.ArrowCursor)
        self._overlay.update()

    def clear(self) -> None:
        """Choose nothing."""
        self._set((), ())

    @property
    def has_undone(self) -> bool:
        """Whether a stroke that was taken back can be made again."""
        return bool(self._undone)

    def undo(self) -> None:
        """Take the last stroke back."""
        if self.strokes:
            self._set(self.strokes[:-1], (*self._undone, self.strokes[-1]))

    def redo(self) -> None:
        """Make the stroke again that was taken back last."""
        if self._undone:
            self._set((*self.strokes, self._undone[-1]), self._undone[:-1])

    def add(self, path_px: FloatArray, *, takes_away: bool = False) -> None:
        """A stroke along a path (P,2) px from the upper left of the view; BadInput where it spans
        nothing."""
        size_wh = self._canvas.size_wh
        camera = self._canvas.pose.camera(size_wh)
        K = camera.Ks[0]
        path = (np.asarray(path_px, np.float64) - K[:2, 2]) / K[[0, 1], [0, 1]]
        radius = float(self._scale * self.radius_px / K[0, 0]) if self.mode == "brush" else 0.0
        if not radius and len(path) < 3:
            raise BadInput("the lasso spans nothing: drag around what is to be chosen.")
        stroke = Stroke(
            cam_from_world=tuple(camera.cam_from_world[0, :3].ravel().tolist()),
            path=tuple((float(u), float(v)) for u, v in path),
            radius=radius,
            takes_away=takes_away,
            front=None if self.is_through else self._front(bounds_of(path, radius), K),
        )
        inside = stroke.chosen(self._means())
        self.chosen = self.chosen if len(self.chosen) == len(inside) else np.zeros(len(inside), bool)
        self.chosen = self.chosen & ~inside if takes_away else self.chosen | inside
        self.strokes, self._undone = (*self.strokes, stroke), ()
        self.changed.emit()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Called by Qt."""
        if event.type() == QEvent.Type.Resize:
            self._overlay.setGeometry(self._canvas.plotter.rect())
        if not self.mode or not isinstance(event, QMouseEvent):
            return False
        kind, is_left = event.type(), event.button() == Qt.MouseButton.LeftButton
        if kind == QEvent.Type.MouseButtonPress and is_left:
            away = Qt.KeyboardModifier.ControlModifier | Qt.KeyboardModifier.AltModifier
            self._takes_away, self._path = bool(event.modifiers() & away), [event.position().toTuple()]
        elif kind == QEvent.Type.MouseMove and self._path:
            self._extend(event.position())
        elif kind == QEvent.Type.MouseButtonRelease and is_left and self._path:
            path, self._path = self._scale * np.array(self._path), []
            self._overlay.update()
            if self.mode == "brush" or len(path) > 2:
                self.add(path, takes_away=self._takes_away)
            return True
        elif kind == QEvent.Type.MouseMove:
            self._overlay.move_to(event.position())
            return False
        else:
            return kind == QEvent.Type.MouseButtonDblClick and is_left
        self._overlay.move_to(event.position())
        return True

    def _extend(self, at: QPointF) -> None:
        if np.hypot(at.x() - self._path[-1][0], at.y() - self._path[-1][1]) >= STEP_PX:
            self._path.append((at.x(), at.y()))

    def _set(self, strokes: tuple[Stroke, ...], undone: tuple[Stroke, ...]) -> None:
        self.strokes, self._undone = strokes, undone
        self.chosen = chosen_by(strokes, self._means())
        self.changed.emit()

    @property
    def _scale(self) -> float:
        return float(self._canvas.plotter.devicePixelRatioF())

    def _front(self, bounds: tuple[float, float, float, float], K: FloatArray) -> Front | None:
        """What the picture shows in an area of the view; None where there is no picture."""
        picture = self._canvas.backdrop.picture
        if picture is None:
            return None
        height, width = picture.shape[:2]
        shares = np.array([width, height]) / np.array(self._canvas.size_wh)
        corners = (np.array(bounds).reshape(2, 2) * K[[0, 1], [0, 1]] + K[:2, 2]) * shares
        low = np.clip(np.floor(corners[0]), 0, (width - 1, height - 1)).astype(int)
        high = np.clip(np.ceil(corners[1]), low + 1, (width, height)).astype(int)
        depths = picture[low[1] : high[1], low[0] : high[0], 3]
        rows, columns = (np.unique(np.linspace(0, side, min(side, MAX_CELLS) + 1).astype(int)[:-1]) for side in depths.shape)
        # The farthest of a cell: a surface is chosen up to its rim.
        cells = np.maximum.reduceat(np.maximum.reduceat(depths, rows, axis=0), columns, axis=1)
        box = ((np.stack([low, high]) / shares) - K[:2, 2]) / K[[0, 1], [0, 1]]
        return Front(
            box=(float(box[0, 0]), float(box[0, 1]), float(box[1, 0]), float(box[1, 1])),
            rows=len(rows),
            columns=len(columns),
            depths=tuple(np.round(cells.ravel().astype(np.float64), 4).tolist()),
        )


class _Overlay(QWidget):
    """The line that is being drawn, and the brush under the pointer, over the view."""

    def __init__(self, parent: QWidget, tool: SelectTool) -> None:
        super().__init__(parent)
        self._tool, self._at = tool, QPointF(-1e3, -1e3)
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self.setAttribute(Qt.WidgetAttribute.WA_NoSystemBackground)
        self.setGeometry(parent.rect())
        parent.setMouseTracking(True)
        self.show()

    def move_to(self, at: QPointF) -> None:
        """The pointer is there now."""
        self._at = at
        self.update()

    def paintEvent(self, event: QPaintEvent) -> None:
        """Called by Qt."""
        tool = self._tool
        if not tool.mode:
            return
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        color = TAKES if tool._takes_away else ADDS
        points = [QPointF(*place) for place in tool._path]
        if tool.mode == "brush":
            wide = QColor(color)
            wide.setAlpha(90)
            if points:
                pen = QPen(wide, 2 * tool.radius_px)
                pen.setCapStyle(Qt.PenCapStyle.RoundCap)
                pen.setJoinStyle(Qt.PenJoinStyle.RoundJoin)
                painter.setPen(pen)
                painter.drawPolyline([*points, points[-1]])
            painter.setPen(QPen(color, 1.5))
            painter.drawEllipse(self._at, tool.radius_px, tool.radius_px)
        elif len(points) > 1:
            painter.setPen(QPen(color, 2))
            painter.drawPolyline(points)
            painter.setPen(QPen(color, 1, Qt.PenStyle.DashLine))
            painter.drawLine(points[-1], points[0])
