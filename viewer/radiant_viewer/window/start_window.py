"""`StartWindow`: from a folder of photographs to a run at work, by clicks. Needs the `desktop`
extra.

    choose or drop   →  what it is, its photographs on a map
    machines, quality →  forecast of time and memory, and the command line that does the same
    Start            →  `radiant run …`, its stages here until it has a plan, then the inspector

A process of the application answers (`StartFeeds.worker`); one forecast at a time is asked for, and
of several wishes the last.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from shlex import join
from typing import Any

import numpy as np
from PySide6.QtCore import Qt, QTimer, Signal
from PySide6.QtGui import QCloseEvent, QDragEnterEvent, QDropEvent, QGuiApplication, QKeySequence, QShortcut, QShowEvent
from PySide6.QtWidgets import (
    QApplication,
    QButtonGroup,
    QGroupBox,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QListWidget,
    QListWidgetItem,
    QMainWindow,
    QPlainTextEdit,
    QPushButton,
    QRadioButton,
    QScrollArea,
    QSplitter,
    QVBoxLayout,
    QWidget,
)

from radiant_core.errors import RadiantError
from radiant_viewer.docks.progress_dock import ProgressDock
from radiant_viewer.host.line_process import LineProcess
from radiant_viewer.layers.themes import THEMES, ThemeName, style_sheet
from radiant_viewer.runs.run_feeds import Begun
from radiant_viewer.runs.run_view import is_planned
from radiant_viewer.start.choices import NOTHING_CHOSEN, QUALITIES, VERBS, forecast_text, result_path
from radiant_viewer.start.machine_pane import MachinePane
from radiant_viewer.start.recent import recent_runs
from radiant_viewer.start.source_pane import PlacesMap, SourcePane
from radiant_viewer.start.start_feeds import StartFeeds
from radiant_viewer.window.qt_palette import qt_palette
from radiant_viewer.window.window_size import fit_to_screen

FORM_PX, PROGRESS_PX, RECENT_PX, LINE_PX = 540, 230, 150, 76
POLL_MS = 300


class StartWindow(QMainWindow):
    """`wants_open` carries what is to be shown in the inspector."""

    wants_open = Signal(object)

    def __init__(self, feeds: StartFeeds, theme: ThemeName = "light") -> None:
        super().__init__()
        self._feeds = feeds
        self.found_source: dict[str, Any] = {}
        self.command: tuple[str, ...] = ()
        """Arguments of `radiant` for what is chosen; empty where something is missing."""
        self._pending: dict[int, str] = {}
        """Number of a request that is not answered → what it asks."""
        self._wish: dict[str, Any] | None = None
        self.begun: Begun | None = None
        self._opens: Path | None = None
        self.progress: ProgressDock | None = None
        self._was_shown = False
        self.setWindowTitle("Radiant: new run")
        self.setAcceptDrops(True)
        self.worker = LineProcess(self, feeds.worker)
        self.worker.answered.connect(self._on_answer)
        self.worker.message.connect(self._on_said)
        self.worker.ended.connect(lambda _, words: self.show_status(f"What folders are cannot be told any more: {words}"))
        self.measuring = LineProcess(self, feeds.measuring)
        self.measuring.message.connect(lambda words: self.show_status(f"Measuring this machine: {words}"))
        self.measuring.ended.connect(self._on_measured)
        self.source, self.machines, self.map = SourcePane(), MachinePane(), PlacesMap()
        self.measure = QPushButton("Measure this machine (5 min)")
        self.measure.setToolTip("radiant machine profile: forecasts are this machine's own afterwards")
        self.quality = QButtonGroup(self)
        self.out, self.line = QLineEdit(), QPlainTextEdit()
        self.line.setReadOnly(True)
        self.line.setStyleSheet("font-family: monospace")
        self.line.setFixedHeight(LINE_PX)
        self.forecast = QLabel("")
        self.forecast.setWordWrap(True)
        self.copy, self.start, self.stop = QPushButton("Copy"), QPushButton("Start"), QPushButton("Stop")
        self.recent = QListWidget()
        self._lay_out()
        self._connect()
        self.set_theme(theme)
        self._fill_recent()
        self._send("profiles", {"profiles": True})
        self._show_state()

    @property
    def quality_name(self) -> str:
        """The chosen quality."""
        return QUALITIES[self.quality.checkedId()][0]

    def show_status(self, message: str) -> None:
        """Show one line in the status bar."""
        self.statusBar().showMessage(message)

    def reload(self) -> None:
        """Look for the plan of a run that was begun."""
        self._on_polled()

    def set_theme(self, name: ThemeName) -> None:
        """Use the light or the dark theme."""
        self.theme = THEMES[name]
        QApplication.setPalette(qt_palette(self.theme))
        self.setStyleSheet(style_sheet(self.theme))
        self.map.set_theme(self.theme)

    def dragEnterEvent(self, event: QDragEnterEvent) -> None:
        """Called by Qt."""
        if event.mimeData().hasUrls() and self.begun is None:
            event.acceptProposedAction()

    def dropEvent(self, event: QDropEvent) -> None:
        """Called by Qt."""
        paths = [Path(url.toLocalFile()) for url in event.mimeData().urls() if url.isLocalFile()]
        if paths and self.begun is None:
            event.acceptProposedAction()
            self.source.choose(_common(paths))

    def showEvent(self, event: QShowEvent) -> None:
        """Called by Qt."""
        super().showEvent(event)
        if not self._was_shown:
            self._was_shown = True
            QTimer.singleShot(0, partial(fit_to_screen, self))

    def closeEvent(self, event: QCloseEvent) -> None:
        """End what answers; a run that was begun goes on."""
        self.worker.end()
        self.measuring.end()
        self._poll.stop()
        if self.progress is not None:
            self.progress.end()
        self.machines.end()
        self.map.close_view()
        super().closeEvent(event)

    def begin(self) -> None:
        """Do what is chosen: open it, or begin the command."""
        if self.found_source.get("next") == "open" and self.source.path is not None:
            self.wants_open.emit(self.source.path)
            return
        if not self.command or self.begun is not None:
            return
        if not self._keep_machines():
            return
        self._opens = result_path(self.found_source["next"], Path(self.out.text().strip()))
        self.begun = self._feeds.begin(self.command)
        self.show_status(f"Begun: radiant {join(self.command)}")
        self._poll.start()
        self._show_state()

    def _on_polled(self) -> None:
        if self.begun is None or self._opens is None:
            return
        words = self.begun.poll()
        if self.found_source["next"] == "run":
            if self.progress is None and (self._opens / "manifest.json").is_file():
                self._watch(self._opens)
            if is_planned(self._opens):
                self._poll.stop()
                self.wants_open.emit(self._opens)
                return
        if words is None:
            return
        self._poll.stop()
        self.begun = None
        if words == "" and self._opens.exists():
            self.wants_open.emit(self._opens)
            return
        if self.progress is not None and not (self._opens / "manifest.json").is_file():
            # It took its folder away with it.
            self.progress.end()
            self.removeDockWidget(self.progress)
            self.progress = None
        self.show_status(words or "It ended without a result")
        self._show_state()

    def _watch(self, run: Path) -> None:
        """Show the stages of a run that was begun."""
        self.progress = ProgressDock(self, self._feeds.feeds(run))
        self.progress.setFeatures(ProgressDock.DockWidgetFeature.NoDockWidgetFeatures)
        self.progress.polled.connect(self._on_watched)
        self.addDockWidget(Qt.DockWidgetArea.BottomDockWidgetArea, self.progress)
        self.resizeDocks([self.progress], [PROGRESS_PX], Qt.Orientation.Vertical)
        self._show_state()

    def _on_watched(self) -> None:
        """A run that was stopped before it had a plan may go on by its panel's Resume."""
        if self._opens is not None and self.begun is None and is_planned(self._opens):
            assert self.progress is not None
            self.progress.end()
            self.wants_open.emit(self._opens)

    def _send(self, kind: str, request: dict[str, Any]) -> None:
        """Ask something, in place of what was asked of this kind before."""
        for number in [number for number, pending_kind in self._pending.items() if pending_kind == kind]:
            self._pending[number] = ""
        number = max(self._pending, default=0) + 1
        self._pending[number] = kind
        self.worker.send({**request, "asked": number})

    def _on_answer(self, answer: dict[str, Any]) -> None:
        kind = self._pending.pop(int(answer["asked"]), "")
        if kind == "profiles":
            self.machines.show_profiles(answer["profiles"])
        elif kind == "machines" and "error" in answer:
            self.machines.show_error(answer["error"])
        elif kind == "machines":
            self.machines.on_written()
        elif kind == "look" and "error" in answer:
            self.source.show_error(answer["error"])
            self.map.show_places(np.zeros((0, 2)), "", "m")
            self._show_state()
        elif kind == "look":
            self._on_found(answer)
        elif kind == "forecast":
            self._on_forecast(answer)
        if self._wish is not None and "forecast" not in self._pending.values():
            self._send_wish()

    def _on_found(self, source: dict[str, Any]) -> None:
        self.found_source = source
        self.source.show_found(source)
        self.map.show_places(np.array(source["places"], np.float64).reshape(-1, 2), source["places_are"], source["unit"])
        self.out.setText(source["out"])
        self.machines.propose(Path(source["out"] or Path.cwd() / "run"))
        self._ask_forecast()

    def _on_said(self, words: str) -> None:
        # What was said while it was looked at may come after the answer.
        if words.startswith("reading") and "look" in self._pending.values():
            self.source.text.setText(f"{self.source.path}: {words} …")

    def _look(self, path: Path) -> None:
        self.found_source, self.command = {}, ()
        self._wish = None
        self._show_state()
        self._send("look", {"look": str(path)})

    def _ask_forecast(self) -> None:
        self.command = ()
        self._show_state()
        if self.found_source.get("next") not in ("run", "plan") or not self.machines.is_ready or not self.out.text().strip():
            return
        system, system_as = (None if path is None else str(path) for path in (self.machines.system, self.machines.system_as))
        self._wish = {
            "path": self.found_source["path"],
            "out": self.out.text().strip(),
            "system": system,
            "system_as": system_as,
            "quality": self.quality_name,
        }
        self.forecast.setText("Time: …")
        if "forecast" not in self._pending.values():
            self._send_wish()

    def _send_wish(self) -> None:
        assert self._wish is not None
        self._send("forecast", {"forecast": self._wish})
        self._wish = None

    def _on_forecast(self, answer: dict[str, Any]) -> None:
        if self._wish is not None:
            # Something else is chosen by now.
            return
        if "error" in answer:
            self.forecast.setText(answer["error"])
        else:
            self.command = tuple(answer["command"])
            self.forecast.setText(forecast_text(answer))
        self._show_state()

    def _on_measured(self, is_well: bool, words: str) -> None:
        self.show_status("This machine is measured: forecasts are its own" if is_well else f"It was not measured: {words}")
        self._ask_forecast()
        self._show_state()

    def _show_state(self) -> None:
        """Enable what can be done now, and show the command line that it is."""
        step, is_idle = self.found_source.get("next", ""), self.begun is None
        makes = step in ("run", "plan")
        for widget in (self.source, self.machines, self.out, *self.quality.buttons()):
            widget.setEnabled(is_idle and (widget is self.source or makes))
        self.start.setText(VERBS.get(step, "Start"))
        self.start.setEnabled(is_idle and (step == "open" or bool(self.command)))
        self.stop.setVisible(not is_idle and self.progress is None)
        line = ("inspect", str(self.source.path)) if step == "open" else self.command
        self.line.setPlainText(f"radiant {join(line)}" if line else "")
        self.copy.setEnabled(bool(line))
        self.measure.setEnabled(not self.measuring.is_running)
        self.measure.setVisible(bool(self._feeds.measuring))
        if not makes:
            self.forecast.setText("" if step else NOTHING_CHOSEN)

    def _connect(self) -> None:
        self._poll = QTimer(self, interval=POLL_MS)
        self._poll.timeout.connect(self._on_polled)
        self.source.chosen.connect(self._look)
        self.machines.changed.connect(self._ask_forecast)
        self.machines.wants_file.connect(lambda rows, path: self._send("machines", {"machines": rows, "path": str(path)}))
        self.quality.idClicked.connect(lambda _: self._ask_forecast())
        self.out.textEdited.connect(lambda _: self._ask_forecast())
        self.copy.clicked.connect(self._copy_line)
        self.start.clicked.connect(self.begin)
        self.stop.clicked.connect(lambda: self.begun.stop() if self.begun is not None else None)
        self.measure.clicked.connect(self._begin_measuring)
        self.recent.itemActivated.connect(lambda item: self.wants_open.emit(Path(item.data(Qt.ItemDataRole.UserRole))))
        self.recent.itemClicked.connect(lambda item: self.wants_open.emit(Path(item.data(Qt.ItemDataRole.UserRole))))
        for key, action in (
            ("Ctrl+O", self.source.ask_folder),
            ("Ctrl+Return", self.begin),
            ("F", self.map.fit),
            ("Ctrl+D", lambda: self.set_theme("dark" if self.theme.name == "light" else "light")),
        ):
            QShortcut(QKeySequence(key), self).activated.connect(action)

    def _begin_measuring(self) -> None:
        self.measuring.start()
        self.show_status("Measuring this machine: five minutes, in which it should do nothing else")
        self._show_state()

    def _keep_machines(self) -> bool:
        """Write the list of machines where the command line names it, if it does."""
        try:
            self.machines.keep()
        except RadiantError as error:
            self.show_status(str(error))
            return False
        return True

    def _copy_line(self) -> None:
        if self.found_source.get("next") != "open" and not self._keep_machines():
            return
        QGuiApplication.clipboard().setText(self.line.toPlainText())
        self.show_status("Copied: type it in a terminal, with the same result")

    def _fill_recent(self) -> None:
        self.recent.clear()
        for path in recent_runs():
            if state := self._feeds.state(path):
                item = QListWidgetItem(f"{path.name}   {state}   {path.parent}")
                item.setData(Qt.ItemDataRole.UserRole, str(path))
                self.recent.addItem(item)
        self._again.setVisible(self.recent.count() > 0)

    def _lay_out(self) -> None:
        form = QWidget()
        column = QVBoxLayout(form)
        for title, part in (
            ("1  Photographs", self.source),
            ("2  Machines", self._machine_part()),
            ("3  Quality", self._quality_part()),
            ("4  Result", self._result_part()),
        ):
            box = QGroupBox(title)
            inner = QVBoxLayout(box)
            inner.setContentsMargins(8, 4, 8, 6)
            inner.addWidget(part)
            column.addWidget(box)
        column.addStretch(1)
        area = QScrollArea()
        area.setWidgetResizable(True)
        area.setWidget(form)
        area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        area.setMinimumWidth(FORM_PX)
        right = QSplitter(Qt.Orientation.Vertical)
        self._again = recent = QGroupBox("Open again")
        QVBoxLayout(recent).addWidget(self.recent)
        right.addWidget(self.map)
        right.addWidget(recent)
        right.setStretchFactor(0, 1)
        right.setSizes([10 * RECENT_PX, RECENT_PX])
        splitter = QSplitter(Qt.Orientation.Horizontal)
        splitter.addWidget(area)
        splitter.addWidget(right)
        splitter.setStretchFactor(1, 1)
        splitter.setSizes([FORM_PX, 3 * FORM_PX])
        self.setCentralWidget(splitter)

    def _machine_part(self) -> QWidget:
        part = QWidget()
        layout = QVBoxLayout(part)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self.machines)
        layout.addWidget(self.measure, alignment=Qt.AlignmentFlag.AlignLeft)
        return part

    def _quality_part(self) -> QWidget:
        part = QWidget()
        layout = QHBoxLayout(part)
        layout.setContentsMargins(0, 0, 0, 0)
        for number, (_, title, tip) in enumerate(QUALITIES):
            button = QRadioButton(title)
            button.setToolTip(tip)
            button.setChecked(number == 1)
            self.quality.addButton(button, number)
            layout.addWidget(button)
        layout.addStretch(1)
        return part

    def _result_part(self) -> QWidget:
        part = QWidget()
        layout = QVBoxLayout(part)
        layout.setContentsMargins(0, 0, 0, 0)
        folder, line, buttons = QHBoxLayout(), QHBoxLayout(), QHBoxLayout()
        folder.addWidget(QLabel("Folder"))
        folder.addWidget(self.out)
        line.addWidget(self.line)
        line.addWidget(self.copy)
        self.start.setDefault(True)
        self.start.setMinimumHeight(34)
        buttons.addWidget(self.start, stretch=1)
        buttons.addWidget(self.stop)
        layout.addLayout(folder)
        layout.addWidget(self.forecast)
        layout.addLayout(line)
        layout.addLayout(buttons)
        return part


def _common(paths: list[Path]) -> Path:
    """What was dropped: the one path, or the folder of several files."""
    return paths[0] if len(paths) == 1 else paths[0].parent
