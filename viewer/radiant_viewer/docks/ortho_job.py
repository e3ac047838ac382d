"""The orthophoto of a run, made on demand and shown on the map. Needs the `desktop` extra."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from PySide6.QtCore import QObject
from PySide6.QtWidgets import QPushButton

from radiant_core.errors import CannotWrite
from radiant_viewer.host.line_process import LineProcess
from radiant_viewer.host.protocols import StatusHost
from radiant_viewer.layers.ortho_layer import ORTHO
from radiant_viewer.runs.run_feeds import SurveyCommands

NEXT = "ortho_next.tif"


class OrthoJob(QObject):
    """Writes RUN/survey/ortho.tif by `radiant export`, in place of an earlier one. The window sees
    that it changed and reads it, unless that would end what the user is at."""

    def __init__(self, host: StatusHost, parent: QObject, run: Path, commands: SurveyCommands | None) -> None:
        super().__init__(parent)
        self._host, self._out = host, run / ORTHO
        self._next = self._out.with_name(NEXT)
        self.button = QPushButton("Make orthophoto")
        self.button.setToolTip(f"Render the model from straight above into {ORTHO} of the run, the map's background")
        self._process = LineProcess(self, commands.ortho(self._next) if commands is not None else ())
        self.button.clicked.connect(self.begin)
        self._process.message.connect(lambda words: host.show_status(f"Orthophoto: {words}"))
        self._process.ended.connect(self._on_ended)

    @property
    def is_running(self) -> bool:
        """Whether it is being made."""
        return self._process.is_running

    def begin(self) -> None:
        """Make it, unless that is being done."""
        if self.is_running:
            return
        try:
            self._out.parent.mkdir(exist_ok=True)
            self._next.unlink(missing_ok=True)
        except OSError as error:
            self._host.show_status(str(CannotWrite(f"cannot write {self._out}: {error.strerror}.")))
            return
        self.button.setEnabled(False)
        self._host.show_status("Orthophoto: begun")
        self._process.start()

    def end(self) -> None:
        """Stop making it, and leave nothing of it behind."""
        if not self.is_running:
            return
        self._process.end()
        for unfinished in self._out.parent.glob(f".{NEXT}.*.part"):
            with suppress(OSError):
                unfinished.unlink()

    def _on_ended(self, is_well: bool, words: str) -> None:
        self.button.setEnabled(True)
        if not is_well:
            self._host.show_status(f"No orthophoto was made: {words}")
            return
        try:
            self._next.replace(self._out)
        except OSError as error:
            self._host.show_status(str(CannotWrite(f"cannot write {self._out}: {error.strerror}.")))
            return
        self._host.show_status(f"The orthophoto is {self._out}; the map shows it once nothing else is in progress here")
