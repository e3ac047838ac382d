"""The Gantt chart of plan and measured run, as in the report. Needs the `desktop` extra."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtGui import QResizeEvent, QShowEvent
from PySide6.QtWidgets import QDockWidget, QLabel, QScrollArea

from radiant_core.errors import RadiantError
from radiant_viewer.charts.gantt_chart import gantt_picture
from radiant_viewer.host.picture_label import pixmap_of
from radiant_viewer.host.protocols import Host
from radiant_viewer.layers.themes import ThemeName
from radiant_viewer.pictures.images import Image
from radiant_viewer.runs.run_feeds import RunFeeds

MIN_WIDTH_PX = 900


class GanttDock(QDockWidget):
    """Draws when it is first shown, and when its width changes."""

    def __init__(self, host: Host, feeds: RunFeeds) -> None:
        super().__init__("Timeline")
        self.setObjectName("timeline")
        self._host, self._feeds = host, feeds
        self.image: Image | None = None
        self._drawn_for: tuple[int, ThemeName] | None = None
        self.label = QLabel("")
        self.label.setAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignTop)
        area = QScrollArea()
        area.setWidgetResizable(True)
        area.setWidget(self.label)
        self.setWidget(area)

    def showEvent(self, event: QShowEvent) -> None:
        """Draw when the tab is opened."""
        super().showEvent(event)
        self._draw()

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Draw for the new width."""
        super().resizeEvent(event)
        if self.isVisible():
            self._draw()

    def follow_theme(self) -> None:
        """Draw in the window's colours."""
        if self.isVisible():
            self._draw()

    def _draw(self) -> None:
        width_px, theme = max(MIN_WIDTH_PX, self.width() - 24), self._host.theme
        if self._drawn_for == (width_px, theme.name):
            return
        self._drawn_for = (width_px, theme.name)
        try:
            rows = self._feeds.gantt_rows()
            if not rows:
                self.label.setText("This run keeps no timeline: it was planned without a system, or by an older version.")
                return
            self.image = gantt_picture(rows, "", self._feeds.gantt_detail(), width_px, theme)
            self.label.setPixmap(pixmap_of(self.image))
        except RadiantError as error:
            self.label.setText(str(error))
