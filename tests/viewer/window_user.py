"""A user of the real window: keys, clicks, drags and names given to dialogs, counted; needs an X
server.

Imported only in processes that show a window: pytest's own keep clear of Qt.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PySide6.QtCore import QPoint, Qt, QTimer
from PySide6.QtGui import QKeySequence
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QComboBox, QFileDialog, QLineEdit, QTabBar, QWidget

from radiant_app.commands.inspect.window import open_inspector
from radiant_core.choices import Painter
from radiant_core.plan.borders.borders import shared_borders
from radiant_viewer.host.canvas import Canvas
from radiant_viewer.window.window import InspectorWindow
from tests.viewer.window_kit import patient

LEFT = Qt.MouseButton.LeftButton
PATIENCE_S = 60


class User:
    """Does with a window what a person can; `actions` tells what was done."""

    def __init__(self, window: InspectorWindow) -> None:
        self.window, self.actions = window, ["radiant inspect RUN"]

    def press(self, keys: str) -> None:
        """One key, with its modifiers."""
        self.actions.append(f"press {keys}")
        QTest.keySequence(self.window, QKeySequence(keys))

    def click(self, widget: QWidget, what: str, spot: QPoint | None = None) -> None:
        """Once, in the middle of a widget or at a spot of it."""
        self.actions.append(f"click {what}")
        QTest.mouseClick(widget, LEFT, pos=spot or QPoint())

    def drag(self, widget: QWidget, path: np.ndarray, what: str) -> None:
        """The left button along places (P,2) px of a widget."""
        self.actions.append(f"drag {what}")
        places = [QPoint(round(x), round(y)) for x, y in path]
        QTest.mousePress(widget, LEFT, pos=places[0])
        for place in places[1:]:
            QTest.mouseMove(widget, place)
        QTest.mouseRelease(widget, LEFT, pos=places[-1])

    def click_tab(self, title: str) -> None:
        """The tab of a panel."""
        bars = self.window.findChildren(QTabBar)
        bar, index = next((bar, index) for bar in bars for index in range(bar.count()) if bar.tabText(index) == title)
        self.click(bar, f"tab {title}", bar.tabRect(index).center())

    def choose(self, box: QComboBox, text: str) -> None:
        """An entry of a list, which opens by one click and is left by another."""
        self.click(box, f"list of {box.currentText()}")
        view = box.view()
        until(view.isVisible, "the list never opened")
        # Qt takes what comes at once for the end of the click that opened the list.
        QTest.qWait(QApplication.doubleClickInterval() + 100)
        spot = view.visualRect(box.model().index(box.findText(text), 0)).center()
        self.click(view.viewport(), text, spot)

    def will_name(self, path: Path) -> None:
        """Give a name to the dialog that opens next: it runs its own loop, so answer in advance."""
        self.actions.append(f"name {path.name}")

        def answer() -> None:
            dialog = QApplication.activeModalWidget()
            if not isinstance(dialog, QFileDialog):
                QTimer.singleShot(20, answer)
                return
            field = dialog.findChild(QLineEdit, "fileNameEdit")
            assert isinstance(field, QLineEdit)
            dialog.activateWindow()
            until(dialog.isActiveWindow, "the dialog never got the keyboard")
            field.selectAll()
            QTest.keyClicks(field, str(path))
            while dialog.isVisible():
                # The list of completions takes a Return that comes while it opens.
                QTest.keyClick(field, Qt.Key.Key_Return)
                QTest.qWait(100)

        QTimer.singleShot(20, answer)

    def drag_border(self, num_cameras: int) -> tuple[int, int]:
        """Drag the longest border of the slowest region into it until so many cameras change hands,
        as the panel says; how many did at last, and after how many frames. The plan is being
        edited."""
        self.actions.append(f"drag the border into the slowest region until {num_cameras} cameras change hands")
        planning, view = self.window.planning, self.window.map.plotter
        assert planning is not None and planning.session is not None
        session, shown = planning.session, planning.dock.changes
        before = session.editor.state.cloud
        slowest = int(before.edge_time_s.argmax())
        border = max((one for one in shared_borders(before) if slowest in (one.first, one.second)), key=lambda one: one.length_m)
        inward = border.toward_first if border.first == slowest else -border.toward_first
        grabbed = border.ends.mean(axis=0) + 0.5 * inward

        def moved() -> int:
            words = shown.text().split()
            return int(words[0]) if "hands" in words[:6] else 0

        frames: list[object] = []
        session.previewed.connect(frames.append)
        QTest.mousePress(view, LEFT, pos=pixel(self.window.map, grabbed))
        stop, away = QPoint(), 0.0
        while moved() < num_cameras:
            seen = len(frames)
            # As a hand does: fast first, then slowly.
            away += 3.0 if moved() < 0.7 * num_cameras else 0.6
            QTest.mouseMove(view, stop := pixel(self.window.map, grabbed + away * inward))
            until(lambda seen=seen: len(frames) > seen, "no frame of the drag came")
        live = moved()
        QTest.mouseRelease(view, LEFT, pos=stop)
        until(lambda: bool(session.editor.edits) and not session.is_busy, "the drag never became an edit")
        return live, len(frames)


def until(condition: Callable[[], object], what: str, patience_s: float = PATIENCE_S) -> None:
    """Let the window work until a condition holds; AssertionError with `what` after a minute, or
    as long as is said."""
    end = time.monotonic() + patient(patience_s)
    while not condition():
        assert time.monotonic() < end, what
        QTest.qWait(10)


def pixel(canvas: Canvas, place: np.ndarray) -> QPoint:
    """Where a place (2,) of the world lies on the map's widget."""
    x, y = canvas.pixels_of(np.array([[*place, 0.0]]))[0]
    return QPoint(round(x), round(canvas.size_wh[1] - 1 - y))


def use_window(path: Path, act: Callable[[InspectorWindow], None], painter: Painter | None = None) -> None:
    """Open `radiant inspect` on a path, act in its window, and close it; raise what went wrong."""
    failures: list[BaseException] = []

    def drive() -> None:
        window = next(one for one in QApplication.topLevelWidgets() if isinstance(one, InspectorWindow) and one.isVisible())
        try:
            # What a window manager does with a new window.
            window.activateWindow()
            until(window.isActiveWindow, "the window never got the keyboard")
            QTest.qWait(100)
            act(window)
        except BaseException as error:  # noqa: BLE001 (raised below, once Qt has let go)
            failures.append(error)
        finally:
            QApplication.closeAllWindows()

    QTimer.singleShot(0, drive)
    code = open_inspector(path, painter=painter)
    if failures:
        raise failures[0]
    assert code == 0, f"the window ended with exit code {code}"
