"""A newcomer at the real start window: `python -m tests.viewer.start_user PHOTOS FLIGHT OUT`, under an
X server. Prints one JSON line of what was seen and how many actions each task took.

Imported only in processes that show a window: pytest's own keep clear of Qt.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PySide6.QtCore import QMimeData, QPoint, QPointF, Qt, QTimer, QUrl
from PySide6.QtGui import QDragEnterEvent, QDropEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QWidget

from radiant_app.commands.inspect.feeds import feeds_of, run_state, start_feeds
from radiant_app.commands.inspect.window import opening_of
from radiant_app.commands.run.control import BegunCommand
from radiant_viewer.start.start_feeds import StartFeeds
from radiant_viewer.window.inspector import open_start
from radiant_viewer.window.start_window import StartWindow
from radiant_viewer.window.window import InspectorWindow
from tests.viewer.moved_views import pixels_of
from tests.viewer.window_user import until

LEFT = Qt.MouseButton.LeftButton
KNOWN = Path(__file__).parents[2] / "sample_scenes/hamlet/known"
SMALL = ("--steps", "60", "--long-side-px", "96", "--max-splats", "2000", "--poses", str(KNOWN))
"""Of runs that are begun: poses are known, so that nothing is matched."""
PATIENCE_S = 240


class Newcomer:
    """Does with the start window what a person can, and counts it."""

    def __init__(self, window: StartWindow) -> None:
        self.window, self.actions, self.begun_s = window, ["radiant inspect"], time.monotonic()

    def drop(self, path: Path) -> None:
        """Drop a folder or file on the window."""
        self.actions.append(f"drop {path.name}")
        data = QMimeData()
        data.setUrls([QUrl.fromLocalFile(str(path))])
        copies, keys = Qt.DropAction.CopyAction, Qt.KeyboardModifier.NoModifier
        # Qt drops only on what took the drag before.
        QApplication.sendEvent(self.window, QDragEnterEvent(QPointF(50, 50), copies, data, LEFT, keys))
        QApplication.sendEvent(self.window, QDropEvent(QPointF(50, 50), copies, data, LEFT, keys))

    def click(self, widget: QWidget, what: str) -> None:
        """Click once."""
        self.actions.append(f"click {what}")
        QTest.mouseClick(widget, LEFT, pos=QPoint())


def _seen(window: type, but: object = None) -> Any:
    return next((one for one in QApplication.topLevelWidgets() if isinstance(one, window) and one.isVisible() and one is not but), None)


def _contrast(window: StartWindow) -> float:
    """Of the places on the map against its ground, as WCAG has it."""
    pixels = pixels_of(window.map.canvas.plotter).astype(float) / 255
    linear = np.where(pixels <= 0.04045, pixels / 12.92, ((pixels + 0.055) / 1.055) ** 2.4)
    light = linear @ np.array([0.2126, 0.7152, 0.0722]) + 0.05
    ground = light[-3, 3]
    # The middle of a place; its rim is dark in both themes.
    place = np.quantile(light, 1 - 1e-4) if ground < 0.5 else np.quantile(light[light < 0.9 * ground], 0.5)
    return float(max(place / ground, ground / place))


def look_around(window: StartWindow, photos: Path, flight: Path, out: Path) -> dict[str, Any]:
    """What is said of photographs, of a flight, of machines and qualities, and of nothing."""
    user = Newcomer(window)
    assert window.map.canvas.scale_bar.isHidden(), "a map of nothing has a scale"
    assert not window.recent.count() and not window.recent.isVisible(), "an empty list is in the way"
    user.drop(photos)
    until(lambda: window.command, "nothing was said of the photographs", PATIENCE_S)
    assert window.map.canvas.scale_bar.isVisible()
    QTest.qWait(500)
    assert "12 photographs" in window.source.text.text(), window.source.text.text()
    for theme in ("dark", "light"):
        window.set_theme(theme)
        QTest.qWait(500)
        assert _contrast(window) > 4.5, f"places can hardly be seen in the {theme} theme"
    usual = {"title": window.found_source["title"], "command": window.command, "forecast": window.forecast.text()}
    places = len(window.map.canvas.actors.get("Places", ()))
    window.quality.button(2).click()
    until(lambda: "--steps" in window.command, "no finer command came", PATIENCE_S)
    fine = window.command
    window.machines.kind.setCurrentText("Machines listed here")
    until(lambda: "--system" in window.command, "the list made no system file", PATIENCE_S)
    assert not window.machines.table.horizontalScrollBar().isVisible(), "a column of the machines is cut off"
    listed, listed_file = window.command, Path(window.command[window.command.index("--system") + 1])
    was_there = listed_file.exists()
    user.click(window.copy, "Copy")
    kept = listed_file.read_text()
    cell = window.machines.table.item(0, 2)
    assert cell is not None
    cell.setText("many")
    until(window.machines.message.text, "a wrong number was taken", PATIENCE_S)
    refused = window.machines.message.text()
    window.machines.kind.setCurrentText("This machine alone")
    user.drop(flight)
    until(lambda: window.command and window.command[0] == "plan", "nothing was said of the flight", PATIENCE_S)
    flown = {"title": window.found_source["title"], "command": window.command}
    user.drop(out)
    until(lambda: not window.found_source and "Looking" not in window.source.text.text(), "nothing was said of an empty folder", PATIENCE_S)
    return {
        "usual": usual,
        "places": places,
        "fine": fine,
        "listed": listed,
        "was_there": was_there,
        "kept": kept,
        "refused": refused,
        "flown": flown,
        "nothing": window.source.text.text(),
    }


def train(window: StartWindow, photos: Path, out: Path) -> dict[str, Any]:
    """Drop and start; stop where it trains, resume, until there is a model; as few actions as
    there are."""
    user = Newcomer(window)
    user.drop(photos)
    until(lambda: window.command, "nothing was said of the photographs", PATIENCE_S)
    window.out.setText(str(out))
    window.command = (*window.command[:3], str(out), *window.command[4:])
    user.click(window.start, "Start")
    actions, ready_s = list(user.actions), time.monotonic() - user.begun_s
    until(lambda: window.progress is not None, "no stages came", PATIENCE_S)
    until(lambda: _seen(InspectorWindow), "no plan came", PATIENCE_S)
    first = _seen(InspectorWindow)
    dock = first.docks.progress
    until(lambda: not dock.stop.isHidden() or not dock.progress.is_running, "it cannot be stopped", PATIENCE_S)
    stopped = dock.progress.is_running
    if stopped:
        dock.stop.click()
    until(lambda: not _dock().progress.is_running, "it did not stop", PATIENCE_S)
    after_stop = _dock().progress.status
    if after_stop == "interrupted":
        _dock().resume.click()
    until(lambda: _dock().progress.status == "done", "it did not go on", 2 * PATIENCE_S)
    until(lambda: _seen(InspectorWindow).model is not None, "the model did not come", PATIENCE_S)
    return {
        "actions": actions,
        "ready_s": ready_s,
        "stopped": stopped,
        "after_stop": after_stop,
        "seconds": time.monotonic() - user.begun_s,
    }


def _dock() -> Any:
    until(lambda: _seen(InspectorWindow), "the window went away")
    return _seen(InspectorWindow).docks.progress


def use_start(act: Callable[[StartWindow], dict[str, Any]]) -> dict[str, Any]:
    """Open the start window, act in it, close all windows; raise what went wrong."""
    results: list[dict[str, Any]] = []
    failures: list[BaseException] = []
    real = start_feeds()
    feeds = StartFeeds(worker=real.worker, begin=lambda line: BegunCommand((*line, *SMALL)), feeds=feeds_of, state=run_state)

    def drive() -> None:
        try:
            until(lambda: _seen(StartWindow), "no window came")
            results.append(act(_seen(StartWindow)))
        except BaseException as error:  # noqa: BLE001 (raised below, once Qt has let go)
            failures.append(error)
        finally:
            QApplication.closeAllWindows()

    QTimer.singleShot(0, drive)
    code = open_start(feeds, opening_of)
    if failures:
        raise failures[0]
    assert code == 0, code
    return results[0]


def main(photos: Path, flight: Path, out: Path) -> None:
    """Both sessions."""
    (out / "nothing").mkdir()
    seen = use_start(lambda window: look_around(window, photos, flight, out / "nothing"))
    trained = use_start(lambda window: train(window, photos, out / "run"))
    again = use_start(lambda window: {"rows": [window.recent.item(row).text() for row in range(window.recent.count())]})
    print(json.dumps({"seen": seen, "trained": trained, "again": again["rows"]}))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
