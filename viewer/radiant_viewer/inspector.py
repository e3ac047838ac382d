"""The desktop window of `radiant inspect RUN|MODEL.ply`: map and 3D view, layers, cameras, photographs, seams, splats, timeline.

It draws the same layers as the headless pictures. Needs the `desktop` extra and a display; `open_window` says so otherwise.
Building it takes a second or two; showing or hiding a layer redraws both views, some 50 ms each.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from radiant_core.errors import RadiantError
from radiant_viewer.desktop import require_desktop
from radiant_viewer.run_feeds import RunFeeds
from radiant_viewer.subject import Subject, load_subject

if TYPE_CHECKING:
    from PySide6.QtWidgets import QApplication

    from radiant_core.scene import SfmScene
    from radiant_viewer.plan_files import PlanSetting
    from radiant_viewer.themes import ThemeName
    from radiant_viewer.window import InspectorWindow

PULSE_MS = 200
"""How soon a window hears Ctrl-C."""


def open_window(
    path: Path,
    feeds: RunFeeds | None = None,
    theme: ThemeName = "light",
    setting: PlanSetting | None = None,
    scene: SfmScene | None = None,
) -> int:
    """Show a run, a plan or a PLY until its window is closed and return the exit code; BadInput without a desktop or for a broken run.

    `setting`: with which machines the plan may be changed; `scene`: the cameras of a plan without waypoints.
    """
    require_desktop()
    # What cannot be shown is refused before any window appears.
    subject = load_subject(Path(path), scene)
    from PySide6.QtWidgets import QApplication

    existing = QApplication.instance()
    application = existing if isinstance(existing, QApplication) else QApplication(sys.argv[:1])
    application.setStyle("Fusion")
    desk = _Desk(feeds or RunFeeds(), setting, scene)
    desk.show(subject, theme)
    with _closed_by_signals(application) as caught:
        code = application.exec()
    return 128 + caught[-1] if caught else code


@contextmanager
def _closed_by_signals(application: QApplication) -> Iterator[list[int]]:
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


class _Desk:
    """Keeps the window, and puts a new one in its place when the run is to be read anew."""

    def __init__(self, feeds: RunFeeds, setting: PlanSetting | None = None, scene: SfmScene | None = None) -> None:
        self._feeds, self._setting, self._scene = feeds, setting, scene
        self.window: InspectorWindow | None = None

    def show(self, subject: Subject, theme: ThemeName) -> None:
        """Open a window, then close the one before, so that the application does not end in between."""
        from radiant_viewer.window import InspectorWindow

        before, self.window = self.window, InspectorWindow(subject, self._feeds, theme, self._setting)
        self.window.wants_reload.connect(self._reload)
        if before is not None:
            self.window.setGeometry(before.geometry())
        self.window.show()
        if before is not None:
            before.close()
            before.deleteLater()

    def _reload(self) -> None:
        assert self.window is not None
        try:
            subject = load_subject(self.window.subject.path, self._scene)
        except RadiantError as error:
            # What is shown stays: a run may be in the middle of writing.
            self.window.tell(str(error))
            return
        self.show(subject, self.window.theme.name)
