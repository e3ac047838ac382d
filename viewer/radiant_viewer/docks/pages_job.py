"""The pages of a run that are sent, made anew after a cleaning by a button. Needs the `desktop`
extra."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from PySide6.QtCore import QObject
from PySide6.QtWidgets import QPushButton

from radiant_viewer.host.line_process import LineProcess
from radiant_viewer.host.protocols import StatusHost
from radiant_viewer.runs.sent_pages import older_sentence


class PagesJob(QObject):
    """`button` is there while the pages of a run's folder show an earlier cleaning; it runs
    `command`, which writes them."""

    def __init__(self, host: StatusHost, run: Path, command: Sequence[str]) -> None:
        super().__init__()
        self._host, self._run = host, run
        self._process = LineProcess(self, command)
        self.button = QPushButton("Rewrite pages")
        self.button.clicked.connect(self.begin)
        self._process.message.connect(lambda words: host.show_status(f"Pages: {words}"))
        self._process.ended.connect(self._on_ended)
        self._has_command = bool(command)
        self.look()

    def look(self) -> str:
        """Show the button where a page is older than the cleaning; returns what to say of it."""
        sentence = older_sentence(self._run)
        self.button.setVisible(bool(sentence) and self._has_command)
        self.button.setToolTip(f"{sentence}: make them as the model is cleaned now, some minutes")
        return sentence

    def begin(self) -> None:
        """Make them, unless that is being done."""
        if not self._process.is_running:
            self.button.setEnabled(False)
            self._host.show_status("Pages: begun")
            self._process.start()

    def end(self) -> None:
        """Stop making them; each stays as it was until it is whole."""
        if self._process.is_running:
            self._process.end()

    def _on_ended(self, is_well: bool, words: str) -> None:
        self.button.setEnabled(True)
        older = self.look()
        if is_well and not older:
            self._host.show_status("report.html and scene.html show the model as it is cleaned now")
        else:
            self._host.show_status(f"The pages are as they were: {words or older}")
