"""The painters of a real window: `python -m tests.viewer.painter_user RUN`, under an X server. Prints
one JSON line: what the note says without a graphics card, how VTK's picture compares with ours
after it took over, and who draws once its process has ended.

Imported only in processes that show a window: pytest's own keep clear of Qt.
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PySide6.QtCore import QEvent, QProcess
from PySide6.QtWidgets import QApplication

from radiant_core.choices import Painter
from radiant_core.decisions import Decision
from radiant_viewer.splats import painter_choice
from radiant_viewer.splats.choosing import Measured, choose_painter
from radiant_viewer.splats.measuring import depth_error, picture_psnr_db
from radiant_viewer.window.window import InspectorWindow
from tests.viewer.window_kit import patient
from tests.viewer.window_user import until, use_window


def faster(rival: Painter, measured: Measured | str, *, has_card: bool) -> tuple[Painter, Decision]:
    """As if a graphics card had drawn in no time."""
    fast = measured if isinstance(measured, str) else replace(measured, other_s=1e-9)
    return choose_painter(rival, fast, has_card=has_card)


def hover(window: InspectorWindow, results: dict[str, Any]) -> None:
    """Without a card the mouse over the note asks."""
    note, model = window.view.note, window.model
    assert model is not None
    until(lambda: model.shown_is_full, "the model never came")
    assert "no graphics card" in note.toolTip() and model.decision is None
    QApplication.sendEvent(note, QEvent(QEvent.Type.Enter))
    until(lambda: model.decision is not None, "nothing was measured", 120)
    results["without_card"] = note.toolTip()
    results["painters"] = [model.painter]


def take_over(window: InspectorWindow, results: dict[str, Any]) -> None:
    """With one, VTK's takes over; and ours again when it ends."""
    model = window.model
    assert model is not None
    until(lambda: model.shown_is_full, "the model never came")
    before = np.array(window.view.backdrop.picture)
    until(lambda: model.decision is not None, "nothing was measured", 120)
    assert model.decision is not None
    until(lambda: model.painter == "vtk" and model.shown_is_full, f"it never took over: {model.decision.reason}")
    after = np.array(window.view.backdrop.picture)
    results["painters"].append(model.painter)
    results |= {"psnr_db": picture_psnr_db(after, before), "depth_error": depth_error(after, before)}
    model.findChildren(QProcess)[-1].kill()
    until(lambda: model.painter == "radiant" and model.shown_is_full, "nothing draws on")
    results["ended"] = model.painter


def main(run: Path) -> None:
    """Two windows."""
    results: dict[str, Any] = {}
    # The machine may be busy with other tests.
    painter_choice.PATIENCE_MS = round(1000 * patient(painter_choice.PATIENCE_MS / 1000))
    use_window(run, lambda window: hover(window, results))
    painter_choice.choose_painter = faster
    painter_choice.PainterChoice.__init__.__defaults__ = (lambda: True,)
    use_window(run, lambda window: take_over(window, results))
    print(json.dumps(results))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
