"""Coordinates and reference system of the place under the mouse, in the status bar. Needs the
`desktop` extra."""

from __future__ import annotations

from PySide6.QtCore import QEvent, QObject
from PySide6.QtGui import QMouseEvent
from PySide6.QtWidgets import QLabel, QStatusBar

from radiant_core.frames import Frame
from radiant_viewer.host.canvas import Canvas
from radiant_viewer.runs.places import place_text


class PlaceLabel(QObject):
    """Follows the mouse over a map."""

    def __init__(self, bar: QStatusBar, canvas: Canvas, frame: Frame | None) -> None:
        super().__init__(canvas.plotter)
        self._map, self._frame = canvas, frame
        self.label = QLabel()
        self.label.setProperty("soft", "true")
        self.label.setToolTip("The place under the mouse on the map; EPSG names the reference system of its metres")
        bar.addPermanentWidget(self.label)
        canvas.plotter.setMouseTracking(True)
        canvas.plotter.installEventFilter(self)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Show the place of a mouse that moves; none of its events is consumed."""
        if event.type() == QEvent.Type.MouseMove and isinstance(event, QMouseEvent):
            scale = self._map.plotter.devicePixelRatioF()
            x, y = event.position().x() * scale, event.position().y() * scale
            pixel = int(x), int(self._map.size_wh[1] - 1 - y)
            self.label.setText(place_text(self._map.ground_place(pixel), self._frame))
        elif event.type() == QEvent.Type.Leave:
            self.label.clear()
        return False
