"""A picture scaled to its widget, or two with a movable wipe. Needs the `desktop` extra."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import QPoint, QRect, QSize, Qt, Signal
from PySide6.QtGui import QColor, QImage, QMouseEvent, QPainter, QPaintEvent, QPen, QPixmap
from PySide6.QtWidgets import QSizePolicy, QWidget

from radiant_viewer.pictures.images import Image

MIN_WH = (160, 110)


class PictureLabel(QWidget):
    """Shows `left` up to the wipe and `right` beyond it, `left` alone, or else `message`."""

    wiped = Signal(float)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setMinimumSize(*MIN_WH)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self._left: QPixmap | None = None
        self._right: QPixmap | None = None
        self._names = ("", "")
        self.share = 0.5
        self.message = ""

    def sizeHint(self) -> QSize:
        return QSize(360, 270)

    def show_picture(self, left: Image | None, right: Image | None = None, names: tuple[str, str] = ("", ""), message: str = "") -> None:
        """Replace what is shown; pictures (H,W,3)."""
        self._left, self._right = (None if image is None else pixmap_of(image) for image in (left, right))
        self._names, self.message = names, message
        self.update()

    def set_share(self, share: float) -> None:
        """Move the wipe to a share, 0 to 1, of the width."""
        self.share = float(np.clip(share, 0, 1))
        self.update()

    def paintEvent(self, event: QPaintEvent) -> None:
        """Draw both pictures, the line between them and their names."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.SmoothPixmapTransform)
        if self._left is None:
            painter.setPen(self.palette().windowText().color())
            painter.drawText(
                self.rect().adjusted(12, 8, -12, -8), int(Qt.AlignmentFlag.AlignCenter) | int(Qt.TextFlag.TextWordWrap), self.message
            )
            return
        place = self._place()
        painter.drawPixmap(place, self._left)
        if self._right is not None:
            cut = round(place.width() * self.share)
            painter.setClipRect(QRect(place.left() + cut, place.top(), place.width() - cut, place.height()))
            painter.drawPixmap(place, self._right)
            painter.setClipping(False)
            x = place.left() + cut
            painter.setPen(QPen(QColor(0, 0, 0, 160), 3))
            painter.drawLine(x, place.top(), x, place.bottom())
            painter.setPen(QPen(QColor(255, 255, 255), 1))
            painter.drawLine(x, place.top(), x, place.bottom())
        self._draw_names(painter, place)

    def mousePressEvent(self, event: QMouseEvent) -> None:
        """Move the wipe to the pointer."""
        self._wipe_to(event.position().toPoint())

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        """Move the wipe with the pointer."""
        self._wipe_to(event.position().toPoint())

    def _wipe_to(self, point: QPoint) -> None:
        if self._right is not None:
            place = self._place()
            self.set_share((point.x() - place.left()) / max(place.width(), 1))
            self.wiped.emit(self.share)

    def _place(self) -> QRect:
        assert self._left is not None
        size = self._left.size().scaled(self.size(), Qt.AspectRatioMode.KeepAspectRatio)
        return QRect(QPoint((self.width() - size.width()) // 2, (self.height() - size.height()) // 2), size)

    def _draw_names(self, painter: QPainter, place: QRect) -> None:
        for name, is_left in zip(self._names, (True, False), strict=True):
            if not name or (not is_left and self._right is None):
                continue
            width = painter.fontMetrics().horizontalAdvance(name) + 10
            x = place.left() + 4 if is_left else place.right() - width - 3
            box = QRect(x, place.top() + 4, width, painter.fontMetrics().height() + 4)
            painter.fillRect(box, QColor(0, 0, 0, 150))
            painter.setPen(QColor(255, 255, 255))
            painter.drawText(box, Qt.AlignmentFlag.AlignCenter, name)


def pixmap_of(image: Image) -> QPixmap:
    """Return a picture (H,W,3) as Qt's pixmap."""
    height, width = image.shape[:2]
    pixels = np.ascontiguousarray(image)
    return QPixmap.fromImage(QImage(pixels.tobytes(), width, height, 3 * width, QImage.Format.Format_RGB888))
