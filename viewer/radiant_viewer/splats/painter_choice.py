"""`PainterChoice`: measures other painters beside the views of a window, by Qt's event loop, and
says who draws. Once per window. Needs the `desktop` extra."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from PySide6.QtCore import QEvent, QObject, QTimer, Signal
from PySide6.QtWidgets import QWidget

from radiant_core.choices import Painter
from radiant_core.decisions import Decision
from radiant_viewer.host.line_process import LineProcess
from radiant_viewer.splats.choosing import OTHERS, Measured, choose_painter, has_graphics_card

PATIENCE_MS = 120_000


class PainterChoice(QObject):
    """With a graphics card it measures after the first picture in full, without one when the mouse
    comes to `note`. `decided` carries the painter and the `Decision`."""

    decided = Signal(str, object)

    def __init__(self, note: QWidget, ply_path: Path, has_card: Callable[[], bool] = has_graphics_card) -> None:
        super().__init__(note)
        self._ply_path, self._has_card = ply_path, has_card()
        self._others: list[Painter] = list(OTHERS) if self._has_card else list(OTHERS[:1])
        self._process: LineProcess | None = None
        self._reasons: list[str] = []
        self._patience = QTimer(self, singleShot=True, interval=PATIENCE_MS)
        self._patience.timeout.connect(lambda: self._learn(f"no picture within {PATIENCE_MS // 1000} s"))
        if not self._has_card:
            note.installEventFilter(self)

    @property
    def first_words(self) -> str:
        """Of the note before anything is measured."""
        if self._has_card:
            return "Drawn by our renderer; other painters are measured beside it."
        return "Drawn by our renderer: there is no graphics card. VTK's Gaussians are being measured to compare."

    def on_first_picture(self) -> None:
        """The view shows the model in full."""
        if self._has_card:
            self.begin()

    def begin(self) -> None:
        """Measure, unless that was begun before."""
        if self._process is None:
            self._measure_next()

    def end(self) -> None:
        """Stop; no signal follows."""
        self._patience.stop()
        if self._process is not None:
            self._process.end()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Called by Qt."""
        if event.type() == QEvent.Type.Enter:
            self.begin()
        return super().eventFilter(watched, event)

    def _measure_next(self) -> None:
        command = [sys.executable, "-m", "radiant_viewer.splats.measuring", str(self._ply_path), self._others[0]]
        self._process = LineProcess(self, command)
        self._process.answered.connect(self._on_answer)
        self._process.ended.connect(lambda _, words: self._learn(f"its process ended ({words})"))
        self._process.start()
        self._patience.start()

    def _on_answer(self, answer: dict[str, Any]) -> None:
        self._learn(Measured(**answer))

    def _learn(self, measured: Measured | str) -> None:
        """What was measured of the first of the others; the next one if it does not draw."""
        self.end()
        rival = self._others.pop(0)
        painter, decision = choose_painter(rival, measured, has_card=self._has_card)
        self._reasons.append(decision.reason)
        if painter == rival or not self._others:
            self.decided.emit(painter, Decision(**{**vars(decision), "reason": "; ".join(self._reasons)}))
        else:
            self._measure_next()
