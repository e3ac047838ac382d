"""A picture scaled to its widget or seen closer, or two with a movable wipe. Needs the `desktop`
extra.

The wheel zooms to the pointer, up to `CLOSEST` pixels of the screen for one of the picture; the
right button, or the middle one, moves the picture; a double click changes between the whole picture
and 100 %, unless clicks are `picked`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PySide6.QtCore import QPoint, QPointF, QRect, QSize, Qt, Signal
from PySide6.QtGui import QColor, QImage, QMouseEvent, QPainter, QPaintEvent, QPen, QPixmap, QWheelEvent
from PySide6.QtWidgets import QSizePolicy, QWidget

from radiant_viewer.pictures.images import Image

MIN_WH = (160, 110)
CLOSEST, WHEEL_FACTOR = 8.0, 1.25
GUESS_PX, CROSS_PX = 22, 12
"""Of the screen: the radius of a guess, and the arms of a mark."""


@dataclass(frozen=True)
class PictureMark:
    """A place of the picture, px from its corner: a cross, or a ring where it is only a guess."""

    column: float
    row: float
    is_guess: bool = False


class PictureLabel(QWidget):
    """Shows `left` up to the wipe and `right` beyond it, `left` alone, or else `message`."""

    wiped = Signal(float)
    zoomed = Signal(float)
    """Carries how many pixels of the screen one of the picture takes."""
    picked = Signal(float, float)
    """Carries column and row of a click in the picture, where `picks` is set."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setMinimumSize(*MIN_WH)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self._left: QPixmap | None = None
        self._right: QPixmap | None = None
        self._names = ("", "")
        self.share = 0.5
        self.message = ""
        self._zoom: float | None = None
        self._middle = QPointF(0.5, 0.5)
        self._grabbed: QPointF | None = None
        self.picks = False
        self._marks: tuple[PictureMark, ...] = ()

    def sizeHint(self) -> QSize:
        return QSize(360, 270)

    def show_picture(self, left: Image | None, right: Image | None = None, names: tuple[str, str] = ("", ""), message: str = "") -> None:
        """Replace what is shown; pictures (H,W,3)."""
        self._left, self._right = (None if image is None else pixmap_of(image) for image in (left, right))
        self._names, self.message = names, message
        self._changed()

    def show_marks(self, marks: Sequence[PictureMark]) -> None:
        """Replace the marks that lie over the picture."""
        self._marks = tuple(marks)
        self.update()

    def look_at(self, column: float, row: float, zoom: float) -> None:
        """Show a place of the picture, px, in the middle of the widget."""
        if self._left is None:
            return
        self._zoom = float(np.clip(zoom, min(self._fitting(), 1.0), CLOSEST))
        self._middle = QPointF(column / self._left.width(), row / self._left.height())
        self._changed()

    @property
    def zoom(self) -> float:
        """Pixels of the screen for one of the picture."""
        return self._fitting() if self._zoom is None else self._zoom

    def show_whole(self) -> None:
        """Fit the picture into the widget."""
        self._zoom, self._middle = None, QPointF(0.5, 0.5)
        self._changed()

    def zoom_to(self, zoom: float, at: QPointF | None = None) -> None:
        """Show the picture so large; the place of it under a point of the widget stays there."""
        if self._left is None:
            return
        point = QPointF(self.rect().center()) if at is None else at
        before = self._share_at(point)
        self._zoom = float(np.clip(zoom, min(self._fitting(), 1.0), CLOSEST))
        if self._zoom <= self._fitting():
            # The whole picture is seen: a small one in the middle.
            self._zoom, self._middle = None if self._zoom == self._fitting() else self._zoom, QPointF(0.5, 0.5)
            self._changed()
            return
        scale = self._zoom / self.devicePixelRatioF()
        size = QPointF(scale * self._left.width(), scale * self._left.height())
        away = point - QPointF(self.rect().center())
        self._middle = QPointF(before.x() - away.x() / size.x(), before.y() - away.y() / size.y())
        self._changed()

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
        self._draw_marks(painter, place)
        self._draw_names(painter, place)

    def wheelEvent(self, event: QWheelEvent) -> None:
        """Zoom to the pointer."""
        self.zoom_to(self.zoom * WHEEL_FACTOR ** (event.angleDelta().y() / 120), event.position())

    def mouseDoubleClickEvent(self, event: QMouseEvent) -> None:
        """Change between the whole picture and 100 % of the place under the pointer."""
        if self.picks:
            return
        self.toggle_zoom(at=event.position())

    def toggle_zoom(self, _: bool = False, at: QPointF | None = None) -> None:
        """Change between the whole picture and 100 % about a point of the widget, or its middle."""
        if self._zoom is None:
            self.zoom_to(1.0, at)
        else:
            self.show_whole()

    def mousePressEvent(self, event: QMouseEvent) -> None:
        """Move the wipe to the pointer, or take hold of the picture."""
        if event.button() != Qt.MouseButton.LeftButton:
            self._grabbed = event.position()
            return
        if self.picks:
            self._pick(event.position())
            return
        self._wipe_to(event.position().toPoint())

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        """Let go of the picture."""
        self._grabbed = None

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        """Move the wipe, or the picture, with the pointer."""
        if self._grabbed is None:
            if not self.picks:
                self._wipe_to(event.position().toPoint())
            return
        if self._left is not None and self._zoom is not None:
            moved, size = event.position() - self._grabbed, self._place().size()
            self._middle -= QPointF(moved.x() / max(size.width(), 1), moved.y() / max(size.height(), 1))
            self._changed()
        self._grabbed = event.position()

    def _wipe_to(self, point: QPoint) -> None:
        if self._right is not None:
            place = self._place()
            self.set_share((point.x() - place.left()) / max(place.width(), 1))
            self.wiped.emit(self.share)

    def _pick(self, point: QPointF) -> None:
        if self._left is None:
            return
        share = self._share_at(point)
        if 0 <= share.x() < 1 and 0 <= share.y() < 1:
            self.picked.emit(share.x() * self._left.width(), share.y() * self._left.height())

    def _changed(self) -> None:
        self._middle = QPointF(*(float(np.clip(share, 0, 1)) for share in (self._middle.x(), self._middle.y())))
        self.update()
        self.zoomed.emit(self.zoom)

    def _fitting(self) -> float:
        """The zoom that shows the whole picture."""
        if self._left is None:
            return 1.0
        return min(self.width() / self._left.width(), self.height() / self._left.height()) * self.devicePixelRatioF()

    def _share_at(self, point: QPointF) -> QPointF:
        """Which place of the picture, in shares of its sides, lies under a point of the widget."""
        place = self._place()
        return QPointF((point.x() - place.left()) / max(place.width(), 1), (point.y() - place.top()) / max(place.height(), 1))

    def _place(self) -> QRect:
        assert self._left is not None
        scale = self.zoom / self.devicePixelRatioF()
        size = QSize(round(scale * self._left.width()), round(scale * self._left.height()))
        center = self.rect().center()
        return QRect(
            QPoint(round(center.x() - self._middle.x() * size.width()), round(center.y() - self._middle.y() * size.height())), size
        )

    def _draw_marks(self, painter: QPainter, place: QRect) -> None:
        assert self._left is not None
        scale = place.width() / self._left.width(), place.height() / self._left.height()
        for mark in self._marks:
            center = QPointF(place.left() + scale[0] * mark.column, place.top() + scale[1] * mark.row)
            # Dark below light, to be seen on snow and in shadow.
            for pen in (QPen(QColor(0, 0, 0, 190), 3), QPen(QColor(255, 210, 60), 1)):
                painter.setPen(pen)
                if mark.is_guess:
                    painter.drawEllipse(center, GUESS_PX, GUESS_PX)
                    continue
                for step in (QPointF(CROSS_PX, 0), QPointF(0, CROSS_PX)):
                    # Open in the middle: what is marked stays visible.
                    painter.drawLine(center - step, center - step / 4)
                    painter.drawLine(center + step / 4, center + step)

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
