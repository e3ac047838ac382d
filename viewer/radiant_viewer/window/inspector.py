"""The desktop window of `radiant inspect [RUN|MODEL.ply]`: map, 3D view, and docks around them; the
start window where nothing is named.

It draws the same layers as the headless pictures. Needs the `desktop` extra and a display. Building
it takes a second or two; showing or hiding a layer redraws both views, some 50 ms each.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from radiant_core.errors import RadiantError
from radiant_viewer.runs.run_feeds import RunFeeds
from radiant_viewer.runs.run_view import is_planned
from radiant_viewer.window.desktop import require_desktop
from radiant_viewer.window.subject import Subject, load_subject

if TYPE_CHECKING:
    from PySide6.QtWidgets import QApplication

    from radiant_core.choices import Painter
    from radiant_core.scene import SfmScene
    from radiant_viewer.editing.store.plan_files import PlanSetting
    from radiant_viewer.layers.themes import ThemeName
    from radiant_viewer.start.start_feeds import StartFeeds
    from radiant_viewer.window.waiting_window import WaitingWindow
    from radiant_viewer.window.window import InspectorWindow

PULSE_MS = 200
"""Longest delay until Ctrl-C closes the window."""


def open_window(
    path: Path,
    feeds: RunFeeds | None = None,
    theme: ThemeName = "light",
    setting: Callable[[], PlanSetting] | None = None,
    scene: SfmScene | None = None,
    painter: Painter | None = None,
) -> int:
    """Show a run, a plan or a PLY until its window is closed.

    Args:
        path: a run folder, a plan, or a .ply file; a running run without a plan is waited for.
        feeds: the application's progress and timeline of the run.
        setting: returns the machines with which the plan can be edited; called per reading.
        scene: the cameras of a plan without waypoints.
        painter: who draws the model, by default our renderer unless another is measured to be
            faster.

    Returns: the exit code.
    Raises: BadInput without a desktop, and as `load_subject`.
    """
    require_desktop()
    owner = _WindowOwner(Opening(path=Path(path), feeds=feeds or RunFeeds(), setting=setting, scene=scene, painter=painter))
    # Errors come before any window appears.
    first = owner.load()
    application = _application()
    owner.show(first, theme)
    return _work_on(application)


@dataclass(frozen=True, kw_only=True, eq=False)
class Opening:
    """What a window shows; fields as the arguments of `open_window`."""

    path: Path
    feeds: RunFeeds
    setting: Callable[[], PlanSetting] | None = None
    scene: SfmScene | None = None
    painter: Painter | None = None


def open_start(feeds: StartFeeds, opening: Callable[[Path], Opening], theme: ThemeName = "light") -> int:
    """Show the start window, and what is opened or begun there, until the last window is closed.

    Args:
        feeds: the application's commands.
        opening: how a path is opened; raises BadInput for what cannot be shown.

    Returns: the exit code.
    Raises: BadInput without a desktop.
    """
    require_desktop()
    application = _application()
    from radiant_viewer.window.start_window import StartWindow

    window, owners = StartWindow(feeds, theme), []

    def open_path(path: Path) -> None:
        try:
            owner = _WindowOwner(opening(path))
            reading = owner.load()
        except RadiantError as error:
            window.show_status(str(error))
            return
        # The application ends with its last window: this one is closed after the next is shown.
        owner.show(reading, window.theme.name)
        owners.append(owner)
        window.close()

    window.wants_open.connect(open_path)
    window.show()
    return _work_on(application)


def _application() -> QApplication:
    from PySide6.QtWidgets import QApplication

    existing = QApplication.instance()
    application = existing if isinstance(existing, QApplication) else QApplication(sys.argv[:1])
    application.setStyle("Fusion")
    return application


def _work_on(application: QApplication) -> int:
    with _close_on_signals(application) as caught:
        code = application.exec()
    return 128 + caught[-1] if caught else code


@contextmanager
def _close_on_signals(application: QApplication) -> Iterator[list[int]]:
    """Let Ctrl-C and SIGTERM close the windows, as their button does; yields the received signals.
    Python's KeyboardInterrupt would end one of Qt's slots and leave the window open."""
    from PySide6.QtCore import QTimer

    caught: list[int] = []

    def close(number: int, _: FrameType | None) -> None:
        caught.append(number)
        QTimer.singleShot(0, application.closeAllWindows)

    if threading.current_thread() is not threading.main_thread():
        # Python handles signals in its main thread only.
        yield caught
        return
    before = {number: signal.signal(number, close) for number in (signal.SIGINT, signal.SIGTERM)}
    # Python checks for signals only while it runs, and Qt waits in C++.
    pulse = QTimer()
    pulse.timeout.connect(lambda: None)
    pulse.start(PULSE_MS)
    try:
        yield caught
    finally:
        pulse.stop()
        for number, handler in before.items():
            signal.signal(number, handler)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Reading:
    """What a window shows, and the setting in which its plan can be edited."""

    subject: Subject
    setting: PlanSetting | None


class _WindowOwner:
    """Holds the window, and replaces it when the run is read again."""

    def __init__(self, opening: Opening) -> None:
        self._path, self._feeds, self._setting, self._scene = opening.path, opening.feeds, opening.setting, opening.scene
        self._painter: Painter | None = opening.painter
        self.window: InspectorWindow | WaitingWindow | None = None

    def load(self) -> _Reading | None:
        """Return what to show; None while a running run has no plan. Raises as `load_subject` and
        the setting."""
        setting = None if self._setting is None else self._setting()
        if self._path.is_dir() and not is_planned(self._path) and self._feeds.progress().is_running:
            return None
        return _Reading(subject=load_subject(self._path, self._scene), setting=setting)

    def show(self, reading: _Reading | None, theme: ThemeName) -> None:
        """Open a window, then close the previous one: else the application would end between."""
        from PySide6.QtCore import Qt

        from radiant_viewer.start.recent import remember_run
        from radiant_viewer.window.waiting_window import WaitingWindow
        from radiant_viewer.window.window import InspectorWindow
        from radiant_viewer.window.window_state import read_window_state, restore_window

        before = self.window
        if before is None:
            remember_run(self._path)
        if reading is None:
            self.window = WaitingWindow(self._path, self._feeds, theme)
        else:
            state = read_window_state(before) if isinstance(before, InspectorWindow) else None
            restore = None if state is None else partial(restore_window, state=state)
            self.window = InspectorWindow(reading.subject, self._feeds, theme, reading.setting, restore, self._painter)
        self.window.wants_reload.connect(self._reload)
        if isinstance(before, InspectorWindow):
            self.window.setGeometry(before.geometry())
            # A run that goes on must not take the keyboard from another program.
            self.window.setAttribute(Qt.WidgetAttribute.WA_ShowWithoutActivating, not before.isActiveWindow())
        self.window.show()
        if before is not None:
            before.close()
            before.deleteLater()

    def _reload(self) -> None:
        from radiant_viewer.window.window import InspectorWindow

        assert self.window is not None
        try:
            reading = self.load()
        except RadiantError as error:
            # Keep what is shown: the run may be in the middle of writing.
            self.window.show_status(str(error))
            return
        if reading is not None:
            self.show(reading, self.window.theme.name if isinstance(self.window, InspectorWindow) else "light")
