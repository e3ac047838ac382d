"""A command of the application beside the window, driven by Qt's event loop. Needs the `desktop`
extra.

Its answers are JSON lines on standard output; the last line on standard error is its progress, or
why it ended.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from PySide6.QtCore import QObject, QProcess, Signal

TERMINATE_MS, END_MS = 500, 2000
"""How long a process is waited for: told to end, so that it can take away what is half written, and
then killed."""
MAX_WORDS = 2000


class LineProcess(QObject):
    """Starts at the first `send` or `start`; `ended` carries whether it ended well, and its last
    words."""

    answered = Signal(object)
    message = Signal(str)
    ended = Signal(bool, str)

    def __init__(self, parent: QObject, command: Sequence[str]) -> None:
        super().__init__(parent)
        self._command = tuple(command)
        self._words = ""
        self._is_ending = False
        self._process: QProcess | None = None

    @property
    def is_running(self) -> bool:
        """Whether the process has begun and not ended."""
        return self._process is not None and self._process.state() != QProcess.ProcessState.NotRunning

    def start(self) -> None:
        """Start the process, if it is not running."""
        if self.is_running:
            return
        self._words, self._is_ending = "", False
        process = self._process = QProcess(self)
        process.readyReadStandardOutput.connect(self._on_output)
        process.readyReadStandardError.connect(self._on_words)
        process.finished.connect(self._on_finished)
        process.errorOccurred.connect(self._on_finished)
        process.start(self._command[0], list(self._command[1:]))

    def send(self, request: dict[str, Any]) -> None:
        """Send a request; `answered` carries the answer."""
        self.start()
        assert self._process is not None
        self._process.write(json.dumps(request).encode() + b"\n")

    def end(self) -> None:
        """Stop the process; no signal follows."""
        self._is_ending = True
        if self._process is not None and self.is_running:
            self._process.closeWriteChannel()
            self._process.terminate()
            if not self._process.waitForFinished(TERMINATE_MS):
                self._process.kill()
                self._process.waitForFinished(END_MS)

    def _on_output(self) -> None:
        assert self._process is not None
        while self._process.canReadLine():
            line = bytes(self._process.readLine().data())
            if line.startswith(b"{"):
                self.answered.emit(json.loads(line))

    def _on_words(self) -> None:
        assert self._process is not None
        self._words = (self._words + bytes(self._process.readAllStandardError().data()).decode(errors="replace"))[-MAX_WORDS:]
        self.message.emit(self._last_line)

    @property
    def _last_line(self) -> str:
        return (self._words.strip() or "no message").splitlines()[-1].strip()

    def _on_finished(self, *_: object) -> None:
        if self._is_ending or self._process is None:
            return
        self._is_ending = True
        is_well = self._process.exitStatus() == QProcess.ExitStatus.NormalExit and self._process.exitCode() == 0
        self.ended.emit(is_well and self._process.error() != QProcess.ProcessError.FailedToStart, self._last_line)
