"""The scale bar of the window's map, beside its heading. Needs the `desktop` extra."""

from __future__ import annotations

from PySide6.QtCore import QPointF, QSize, Qt
from PySide6.QtGui import QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import QSizePolicy, QWidget

from radiant_viewer.pictures.measure import length_text, scale_bar_length

LENGTH_PX, HEIGHT_PX, TEXT_PX = 110, 16, 70


class ScaleBar(QWidget):
    """A bar of 1, 2 or 5 times a power of ten of `unit`, at most `LENGTH_PX` long."""

    def __init__(self, parent: QWidget, unit: str) -> None:
        super().__init__(parent)
        self._unit, self._unit_per_px = unit, 0.0
        self.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Fixed)

    def show_scale(self, unit_per_px: float) -> None:
        """Draw for a map whose pixels of the widget span `unit_per_px` of the unit."""
        if unit_per_px != self._unit_per_px:
            self._unit_per_px = unit_per_px
            self.update()

    @property
    def text(self) -> str:
        """The text beside the bar, such as "20 m"."""
        return length_text(self.length, self._unit) if self._unit_per_px > 0 else ""

    @property
    def length(self) -> float:
        """Length of the bar in the unit; 0 before a map is drawn."""
        return scale_bar_length(LENGTH_PX * self._unit_per_px) if self._unit_per_px > 0 else 0.0

    def sizeHint(self) -> QSize:
        return QSize(LENGTH_PX + TEXT_PX, HEIGHT_PX)

    def paintEvent(self, event: QPaintEvent) -> None:
        """Draw the bar at the right and its length before it."""
        if not self._unit_per_px > 0:
            return
        painter = QPainter(self)
        painter.setPen(QPen(self.palette().windowText().color(), 1.5))
        right, left = self.width() - 2.0, self.width() - 2.0 - self.length / self._unit_per_px
        low, high = self.height() - 5.0, self.height() - 11.0
        painter.drawPolyline([QPointF(left, high), QPointF(left, low), QPointF(right, low), QPointF(right, high)])
        room = self.rect().adjusted(0, 0, int(left) - self.width() - 6, 0)
        painter.drawText(room, int(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter), self.text)
