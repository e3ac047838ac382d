"""The window of a run without a plan: its stages until it has one. Needs the `desktop` extra."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QLabel, QMainWindow

from radiant_viewer.docks.progress_dock import ProgressDock
from radiant_viewer.layers.themes import THEMES, ThemeName, style_sheet
from radiant_viewer.runs.run_feeds import RunFeeds
from radiant_viewer.runs.run_view import is_planned
from radiant_viewer.runs.unplanned import finish_command

SIZE_WH = (760, 320)
WAITING = "This run has no plan yet: there is nothing to draw. Regions and cameras appear here as soon as it has one."


class WaitingWindow(QMainWindow):
    """Emits `wants_reload` once the run has a plan."""

    wants_reload = Signal()

    def __init__(self, path: Path, feeds: RunFeeds, theme: ThemeName) -> None:
        super().__init__()
        self.path = path
        self.setWindowTitle(f"Radiant: {path.resolve().name}")
        self.resize(*SIZE_WH)
        self.setStyleSheet(style_sheet(THEMES[theme]))
        self.text = QLabel(WAITING)
        self.text.setWordWrap(True)
        self.text.setMargin(10)
        self.setCentralWidget(self.text)
        self.progress = ProgressDock(self, feeds)
        self.progress.setFeatures(ProgressDock.DockWidgetFeature.NoDockWidgetFeatures)
        self.progress.polled.connect(self._on_polled)
        self.addDockWidget(Qt.DockWidgetArea.BottomDockWidgetArea, self.progress)
        self.resizeDocks([self.progress], [SIZE_WH[1]], Qt.Orientation.Vertical)

    def show_status(self, message: str) -> None:
        self.statusBar().showMessage(message)

    def reload(self) -> None:
        """Check whether there is a plan now."""
        self.wants_reload.emit()

    def _on_polled(self) -> None:
        if is_planned(self.path):
            self.wants_reload.emit()
            return
        ended = f"This run ended ({self.progress.progress.status or 'unknown'}) before it had a plan: {finish_command(self.path)}."
        self.text.setText(WAITING if self.progress.progress.is_running else ended)
