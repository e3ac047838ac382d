"""Progress of a run: a bar per stage, warnings, time left, polled once a second. Needs the
`desktop` extra."""

from __future__ import annotations

from PySide6.QtCore import Qt, QTimer, Signal
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
from radiant_viewer.host.protocols import StatusHost
from radiant_viewer.layers.region_layer import duration_text
from radiant_viewer.runs.run_feeds import RunFeeds, RunProgress, StageState

POLL_MS = 1000
HEADINGS = ("Stage", "State", "", "Doing")


class ProgressDock(QDockWidget):
    """`shown` is the last reading; `polled` is emitted after every reading but the first."""

    polled = Signal()

    def __init__(self, host: StatusHost, feeds: RunFeeds) -> None:
        super().__init__("Progress")
        self.setObjectName("progress")
        self._host, self._feeds = host, feeds
        self.shown = RunProgress()
        self._filled: tuple[StageState, ...] = ()
        self.summary = QLabel("")
        self.reload = QPushButton("Reload")
        self.reload.setToolTip("Read the run's plan, model and figures anew (F5)")
        self.reload.clicked.connect(host.reload)
        self.table = QTableWidget(0, len(HEADINGS))
        self.table.setHorizontalHeaderLabels(HEADINGS)
        self.table.setEditTriggers(QTableWidget.EditTrigger.NoEditTriggers)
        self.table.verticalHeader().setVisible(False)
        self.table.verticalHeader().setDefaultSectionSize(22)
        self.table.horizontalHeader().setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        self.table.horizontalHeader().setStretchLastSection(True)
        row = QHBoxLayout()
        row.addWidget(self.summary, stretch=1)
        row.addWidget(self.reload)
        body = QWidget()
        layout = QVBoxLayout(body)
        layout.setContentsMargins(4, 2, 4, 4)
        layout.addLayout(row)
        self.machines = QLabel("")
        self.machines.setTextFormat(Qt.TextFormat.PlainText)
        self.machines.setWordWrap(True)
        self.machines.hide()
        layout.addWidget(self.machines)
        layout.addWidget(self.table)
        self.setWidget(body)
        self._timer = QTimer(self)
        self._timer.timeout.connect(self._poll)
        self._timer.start(POLL_MS)
        self.read()

    def end(self) -> None:
        """Stop polling."""
        self._timer.stop()

    def read(self) -> None:
        """Read the progress and show it; a run that ended may be resumed, so polling goes on."""
        try:
            now = self._feeds.progress()
        except RadiantError as error:
            # The run may be in the middle of writing.
            self.summary.setText(str(error))
            return
        was_running, had_ended = self.shown.is_running, bool(self.shown.status) and not self.shown.is_running
        self.shown = now
        if now.stages != self._filled:
            self._fill(now.stages)
        self.summary.setText(_summary(now))
        self.summary.setToolTip("\n".join(now.warnings))
        self.machines.setText("\n".join(now.machines))
        self.machines.setVisible(bool(now.machines))
        if was_running and not now.is_running:
            self._host.show_status(f"The run ended ({now.status}).")
        if now.is_running and had_ended:
            self._host.show_status("The run goes on.")

    def _poll(self) -> None:
        self.read()
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


def _summary(progress: RunProgress) -> str:
    if not progress.stages:
        return f"This run is {progress.status or 'of an older version'}; it kept no stream of events."
    done = {stage.stage for stage in progress.stages if stage.state in ("done", "skipped")}
    finished = f"{len(done)} of {len(progress.stages)} stages that began are finished"
    if progress.expected:
        finished = f"{len(done & set(progress.expected))} of {len(progress.expected)} stages finished"
    parts = [f"Run {progress.status or 'unknown'}", finished]
    whole = progress.whole
    if progress.is_running and whole is not None:
        parts[1] = f"{whole.phase}, {whole.number} of {whole.num_phases}"
        if whole.left_s is not None:
            off = "" if whole.off_percent is None else f" ± {whole.off_percent:.0f} %"
            parts.append(f"about {duration_text(max(1, round(whole.left_s)))}{off} left")
    elif progress.is_running and progress.seconds_left is not None:
        parts.append(f"devices and edges: about {duration_text(max(1, round(progress.seconds_left)))} left")
    if progress.warnings:
        parts.append(f"{len(progress.warnings)} warning{'s' * (len(progress.warnings) > 1)}")
    return "   ·   ".join(parts)
