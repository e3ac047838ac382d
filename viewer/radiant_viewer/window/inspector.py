"""The desktop window of `radiant inspect RUN|MODEL.ply`: map and 3D view, layers, cameras, photographs, seams, splats, timeline.

It draws the same layers as the headless pictures. Needs the `desktop` extra and a display; `open_window` says so otherwise.
Building it takes a second or two; showing or hiding a layer redraws both views, some 50 ms each.
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

    from radiant_core.scene import SfmScene
    from radiant_viewer.editing.plan_files import PlanSetting
    from radiant_viewer.layers.themes import ThemeName
    from radiant_viewer.window.waiting_window import WaitingWindow
    from radiant_viewer.window.window import InspectorWindow

PULSE_MS = 200
"""How soon a window hears Ctrl-C."""


def open_window(
    path: Path,
    feeds: RunFeeds | None = None,
    theme: ThemeName = "light",
    setting: Callable[[], PlanSetting] | None = None,
    scene: SfmScene | None = None,
) -> int:
    """Show a run, a plan or a PLY until its window is closed and return the exit code; BadInput without a desktop or for a broken run.

    A run at work that has no plan yet is waited for. `setting`: with which machines the plan may be changed, read anew with the run;
    `scene`: the cameras of a plan without waypoints.
    """
    require_desktop()
    desk = _Desk(Path(path), feeds or RunFeeds(), setting, scene)
    # What cannot be shown is refused before any window appears.
    first = desk.read()
    from PySide6.QtWidgets import QApplication

    existing = QApplication.instance()
    application = existing if isinstance(existing, QApplication) else QApplication(sys.argv[:1])
    application.setStyle("Fusion")
    desk.show(first, theme)
    with _close_on_signals(application) as caught:
        code = application.exec()
    return 128 + caught[-1] if caught else code


@contextmanager
def _close_on_signals(application: QApplication) -> Iterator[list[int]]:
    """Ctrl-C and SIGTERM close the windows as their own button does; yields the numbers of the signals that came.

    An exception, as Python raises for them otherwise, would end one slot of Qt's and leave the window open.
    """
    from PySide6.QtCore import QTimer

    caught: list[int] = []

    def close(number: int, _: FrameType | None) -> None:
        caught.append(number)
        QTimer.singleShot(0, application.closeAllWindows)

    if threading.current_thread() is not threading.main_thread():
        # Python takes signals in its main thread alone.
        yield caught
        return
    before = {number: signal.signal(number, close) for number in (signal.SIGINT, signal.SIGTERM)}
    # Python looks for signals only when it runs: Qt waits in C++.
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
    """What a window shows, and with which machines its plan may be changed."""

    subject: Subject
    setting: PlanSetting | None


class _Desk:
    """Keeps the window, and puts a new one in its place when the run is to be read anew."""

    def __init__(
        self, path: Path, feeds: RunFeeds, setting: Callable[[], PlanSetting] | None = None, scene: SfmScene | None = None
    ) -> None:
        self._path, self._feeds, self._setting, self._scene = path, feeds, setting, scene
        self.window: InspectorWindow | WaitingWindow | None = None

    def read(self) -> _Reading | None:
        """What is to be shown; None while a run at work has no plan yet. Raises as `load_subject` and the setting."""
        setting = None if self._setting is None else self._setting()
        if self._path.is_dir() and not is_planned(self._path) and self._feeds.progress().is_running:
            return None
        return _Reading(subject=load_subject(self._path, self._scene), setting=setting)

    def show(self, reading: _Reading | None, theme: ThemeName) -> None:
        """Open a window, then close the one before, so that the application does not end in between."""
        from PySide6.QtCore import Qt

        from radiant_viewer.window.waiting_window import WaitingWindow
        from radiant_viewer.window.window import InspectorWindow
        from radiant_viewer.window.window_state import read_window_state, restore_window

        before = self.window
        if reading is None:
            self.window = WaitingWindow(self._path, self._feeds, theme)
        else:
            state = read_window_state(before) if isinstance(before, InspectorWindow) else None
            restore = None if state is None else partial(restore_window, state=state)
            self.window = InspectorWindow(reading.subject, self._feeds, theme, reading.setting, restore)
        self.window.wants_reload.connect(self._reload)
        if isinstance(before, InspectorWindow):
            self.window.setGeometry(before.geometry())
            # Nobody who writes elsewhere is to lose the keyboard to a run that went on.
            self.window.setAttribute(Qt.WidgetAttribute.WA_ShowWithoutActivating, not before.isActiveWindow())
        self.window.show()
        if before is not None:
            before.close()
            before.deleteLater()

    def _reload(self) -> None:
        from radiant_viewer.window.window import InspectorWindow

        assert self.window is not None
        try:
            reading = self.read()
        except RadiantError as error:
            # What is shown stays: a run may be in the middle of writing.
            self.window.show_status(str(error))
            return
        if reading is not None:
            self.show(reading, self.window.theme.name if isinstance(self.window, InspectorWindow) else "light")
