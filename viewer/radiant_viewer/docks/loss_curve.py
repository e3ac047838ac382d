"""The loss of the trainings of a run at work, painted by Qt. Needs the `desktop` extra."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import QPointF, QRectF, QSize, Qt
from PySide6.QtGui import QColor, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import QSizePolicy, QWidget

from radiant_viewer.layers.palette import CURVE_COLORS
from radiant_viewer.runs.run_feeds import LossCurve

SIZE_WH = (260, 110)
LEFT_PX, BELOW_PX, TOP_PX = 54, 16, 6
MAX_CURVES = 6
"""Curves of the stages that began last: more cannot be told apart, nor black on dark."""


class LossWidget(QWidget):
    """The latest stages' loss over their share done, on a logarithmic scale; nothing before two
    figures of one came."""

    def __init__(self) -> None:
        super().__init__()
        self._curves: tuple[LossCurve, ...] = ()
        self.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Expanding)
        self.hide()

    def show_curves(self, curves: tuple[LossCurve, ...]) -> None:
        """Paint these, the last one strongest."""
        latest = curves[-MAX_CURVES:]
        if latest == self._curves:
            return
        self._curves = latest
        self.setVisible(bool(latest))
        self.setToolTip("Loss over the share done: " + ", ".join(f"{curve.stage} {curve.points[-1][1]:.4f}" for curve in latest))
        self.update()

    def sizeHint(self) -> QSize:
        """Called by Qt."""
        return QSize(*SIZE_WH)

    def minimumSizeHint(self) -> QSize:
        """Called by Qt."""
        return QSize(SIZE_WH[0], SIZE_WH[1] // 2)

    def paintEvent(self, event: QPaintEvent) -> None:
        """Called by Qt."""
        if not self._curves:
            return
        losses = np.array([loss for curve in self._curves for _, loss in curve.points])
        high = float(losses.max(initial=1e-6))
        low = min(float(losses[losses > 0].min(initial=high)), 0.9 * high)
        painter, text = QPainter(self), self.palette().windowText().color()
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        field = QRectF(LEFT_PX, TOP_PX, self.width() - LEFT_PX - 6, self.height() - TOP_PX - BELOW_PX)
        painter.setPen(QPen(QColor(128, 128, 128), 1))
        painter.drawLine(field.bottomLeft(), field.topLeft())
        painter.drawLine(field.bottomLeft(), field.bottomRight())
        painter.setPen(text)
        alignment = int(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
        for value, y in ((high, field.top()), (low, field.bottom())):
            painter.drawText(QRectF(0, y - 8, LEFT_PX - 4, 16), alignment, f"{value:.3g}")
        last = self._curves[-1]
        below = QRectF(field.left(), field.bottom() + 1, field.width(), BELOW_PX)
        words = painter.fontMetrics().elidedText(f"loss of {last.stage}", Qt.TextElideMode.ElideMiddle, int(below.width()))
        painter.drawText(below, int(Qt.AlignmentFlag.AlignHCenter), words)
        per_log = field.height() / float(np.log(high / low))
        for number, curve in enumerate(self._curves):
            red, green, blue = (int(level) for level in CURVE_COLORS[number % MAX_CURVES])
            painter.setPen(QPen(QColor(red, green, blue), 2.2 if curve is last else 1.0))
            places = [(share, float(np.log(high / max(loss, low)))) for share, loss in curve.points]
            painter.drawPolyline([QPointF(field.left() + share * field.width(), field.top() + per_log * depth) for share, depth in places])
