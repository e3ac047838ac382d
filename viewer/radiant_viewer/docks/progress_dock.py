"""Progress of a run: a bar per stage, loss, warnings, time left, polled once a second; the run is
stopped and resumed here. Needs the `desktop` extra."""

from __future__ import annotations

from shlex import join

from PySide6.QtCore import Qt, QTimer, Signal
from PySide6.QtGui import QGuiApplication
from PySide6.QtWidgets import (
    QDockWidget,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QProgressBar,
    QPushButton,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from radiant_core.errors import RadiantError
from radiant_viewer.docks.loss_curve import LossWidget
from radiant_viewer.host.protocols import StatusHost
from radiant_viewer.layers.region_layer import duration_text
from radiant_viewer.runs.progress_summary import progress_summary
from radiant_viewer.runs.run_feeds import Begun, RunFeeds, RunProgress, StageState

POLL_MS = 1000
HEADINGS = ("Stage", "State", "", "Doing")


class ProgressDock(QDockWidget):
    """`shown` is the last reading; `polled` is emitted after every reading but the first."""

    polled = Signal()

    def __init__(self, host: StatusHost, feeds: RunFeeds) -> None:
        super().__init__("Progress")
        self.setObjectName("progress")
        self._host, self._feeds = host, feeds
        self.progress = RunProgress()
        self._filled: tuple[StageState, ...] = ()
        self.summary = QLabel("")
        self.reload = QPushButton("Reload")
        self.reload.setToolTip("Read the run's plan, model and figures anew (F5)")
        self.reload.clicked.connect(host.reload)
        self.stop, self.resume, self.copy = QPushButton("Stop"), QPushButton("Resume"), QPushButton("Copy command")
        self.stop.setToolTip("End the run as Ctrl-C in its terminal does; what is finished is kept")
        self.resume.setToolTip("Go on with the run: its own command with --resume")
        self.copy.setToolTip("Copy the command line that goes on with this run")
        self.stop.clicked.connect(self._on_stop)
        self.resume.clicked.connect(self._on_resume)
        self.copy.clicked.connect(self._on_copy)
        self.loss = LossWidget()
        self._begun: Begun | None = None
        self.table = QTableWidget(0, len(HEADINGS))
        self.table.setHorizontalHeaderLabels(HEADINGS)
        self.table.setEditTriggers(QTableWidget.EditTrigger.NoEditTriggers)
        self.table.verticalHeader().setVisible(False)
        self.table.verticalHeader().setDefaultSectionSize(22)
        self.table.horizontalHeader().setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        self.table.horizontalHeader().setStretchLastSection(True)
        row = QHBoxLayout()
        row.addWidget(self.summary, stretch=1)
        for button in (self.stop, self.resume, self.copy, self.reload):
            row.addWidget(button)
        body = QWidget()
        layout = QVBoxLayout(body)
        layout.setContentsMargins(4, 2, 4, 4)
        layout.addLayout(row)
        self.machines = QLabel("")
        self.machines.setTextFormat(Qt.TextFormat.PlainText)
        self.machines.setWordWrap(True)
        self.machines.hide()
        layout.addWidget(self.machines)
        across = QHBoxLayout()
        across.addWidget(self.table, stretch=1)
        across.addWidget(self.loss)
        layout.addLayout(across)
        self.setWidget(body)
        self._timer = QTimer(self)
        self._timer.timeout.connect(self._poll)
        self._timer.start(POLL_MS)
        self.refresh()

    def end(self) -> None:
        """Stop polling."""
        self._timer.stop()

    def refresh(self) -> None:
        """Read the progress and show it; a run that ended may be resumed, so polling goes on."""
        try:
            now = self._feeds.progress()
        except RadiantError as error:
            # The run may be in the middle of writing.
            self.summary.setText(str(error))
            return
        was_running, had_ended = self.progress.is_running, bool(self.progress.status) and not self.progress.is_running
        self.progress = now
        self._show_control(now)
        self.loss.show_curves(now.losses)
        if now.stages != self._filled:
            self._fill(now.stages)
        self.summary.setText(progress_summary(now))
        self.summary.setToolTip("\n".join(now.warnings))
        self.machines.setText("\n".join(now.machines))
        self.machines.setVisible(bool(now.machines))
        if was_running and not now.is_running:
            self._host.show_status(f"The run ended ({now.status}).")
        if now.is_running and had_ended:
            self._host.show_status("The run goes on.")

    def _show_control(self, now: RunProgress) -> None:
        can_be_ours = self._feeds.control is not None
        is_beginning = self._begun is not None and not now.is_running
        self.copy.setVisible(can_be_ours)
        self.stop.setVisible(can_be_ours and now.is_running)
        self.resume.setVisible(can_be_ours and not now.is_running and now.status in ("interrupted", "failed"))
        self.resume.setEnabled(not is_beginning)
        if not now.is_running:
            self.stop.setEnabled(True)

    def _on_stop(self) -> None:
        assert self._feeds.control is not None
        try:
            self._feeds.control.stop()
        except RadiantError as error:
            self._host.show_status(str(error))
            return
        self.stop.setEnabled(False)
        self._host.show_status("The run is being stopped; Resume goes on with it")

    def _on_resume(self) -> None:
        assert self._feeds.control is not None
        try:
            self._begun = self._feeds.control.resume()
        except RadiantError as error:
            self._host.show_status(str(error))
            return
        self.resume.setEnabled(False)
        self._host.show_status("The run begins again where it was")

    def _on_copy(self) -> None:
        assert self._feeds.control is not None
        try:
            line = f"radiant {join(self._feeds.control.arguments())}"
        except RadiantError as error:
            self._host.show_status(str(error))
            return
        QGuiApplication.clipboard().setText(line)
        self._host.show_status(f"Copied: {line}")

    def _poll(self) -> None:
        if self._begun is not None and (words := self._begun.poll()) is not None:
            self._begun = None
            if words:
                self._host.show_status(f"The run ended: {words}")
        self.refresh()
        self.polled.emit()

    def _fill(self, stages: tuple[StageState, ...]) -> None:
        self._filled = stages
        self.table.setRowCount(len(stages))
        for row, stage in enumerate(stages):
            took = "" if stage.seconds is None else f" in {duration_text(stage.seconds)}"
            self.table.setItem(row, 0, QTableWidgetItem(stage.stage))
            self.table.setItem(row, 1, QTableWidgetItem(stage.state + took))
            bar = self.table.cellWidget(row, 2)
            if not isinstance(bar, QProgressBar):
                bar = QProgressBar()
                bar.setFixedWidth(160)
                self.table.setCellWidget(row, 2, bar)
            share = stage.share
            # Qt animates a bar without a range.
            bar.setRange(0, 0 if share is None and stage.state == "running" else 100)
            bar.setValue(0 if share is None else round(100 * share))
            self.table.setItem(row, 3, QTableWidgetItem(stage.note))
        self.table.scrollToBottom()
