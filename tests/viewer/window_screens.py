"""The windows as they open, in both themes: `python -m tests.viewer.window_screens RUN PHOTOS OUT`, under an X server whose
screen they fill; `tests.viewer.screens` gives them one of each size.

Imported only in processes that show a window: pytest's own keep clear of Qt.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from PySide6.QtTest import QTest

from radiant_viewer.window.start_window import StartWindow
from radiant_viewer.window.window import InspectorWindow
from tests.viewer.start_user import PATIENCE_S, Newcomer, use_start
from tests.viewer.window_user import User, until, use_window

REST_MS = 2500
TABS = ("Photograph", "Measures", "Cleaning", "Plan", "Seams", "Timeline", "Fly-through")


def picture_start(window: StartWindow, photos: Path, out: Path) -> dict[str, Any]:
    """Before anything is chosen, and with photographs and machines listed, in both themes."""
    until(lambda: window.machines.kind.count() > 1, "no machines came", PATIENCE_S)
    for name in ("start", "start_photographs"):
        if name != "start":
            Newcomer(window).drop(photos)
            until(lambda: window.command, "nothing was said of the photographs", PATIENCE_S)
            window.machines.kind.setCurrentText("Machines listed here")
            until(lambda: "--system" in window.command, "the list made no system file", PATIENCE_S)
        for theme in ("light", "dark"):
            window.set_theme(theme)
            QTest.qWait(REST_MS)
            _save(window, out, name, theme)
    return {}


def picture_inspector(window: InspectorWindow, out: Path) -> None:
    """As it opens, at the worst photograph, and each panel that shares its place, in both themes."""
    user, model = User(window), window.model
    assert model is not None
    for theme in ("light", "dark"):
        if theme == "dark":
            user.press("Ctrl+D")
        user.press("F")
        _rest(window)
        _save(window, out, "window", theme)
        user.press("W")
        _rest(window)
        _save(window, out, "window_worst", theme)
        for tab in TABS:
            dock = next((one for one in window.all_docks() if one.windowTitle() == tab), None)
            if dock is not None:
                window.raise_dock(dock)
                QTest.qWait(500)
                _save(window, out, f"window_{tab.lower()}", theme)


def _rest(window: InspectorWindow) -> None:
    QTest.qWait(REST_MS)
    model = window.model
    assert model is not None
    until(lambda: model.shown_is_full and model._map_drawn == model._map_key(), "the model was never drawn in full")
    QTest.qWait(REST_MS)


def _save(window: StartWindow | InspectorWindow, out: Path, name: str, theme: str) -> None:
    kind = "window_begin" if isinstance(window, StartWindow) else ""
    path = out / f"{kind}{name.removeprefix('start')}_{window.width()}_{theme}.png"
    assert window.screen().grabWindow(int(window.winId())).save(str(path), "PNG")
    print(path, flush=True)


def main(run: Path, photos: Path, out: Path) -> None:
    """Both windows; of the run a copy, which keeps what they write."""
    use_start(lambda window: picture_start(window, photos, out))
    with TemporaryDirectory() as temporary:
        copy = Path(temporary) / run.name
        shutil.copytree(run, copy)
        use_window(copy, lambda window: picture_inspector(window, out))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
