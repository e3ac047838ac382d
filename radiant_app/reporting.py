"""`EventReporter` turns reports of a node into events of the run; a node's notes keep them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from radiant_app.events import Decided, Event, StageProgress, Warned
from radiant_app.strangers import UntrustedRecord, parse_record
from radiant_core.decisions import Decision
from radiant_core.io.run_store import read_json

if TYPE_CHECKING:
    from radiant_core.sfm.config import SfmProgress

Emit = Callable[[Event], None]


@dataclass(frozen=True, kw_only=True)
class EventReporter:
    """A `radiant_core.hierarchy.reporter.Reporter` that emits events of its stage."""

    stage: str
    emit: Emit

    def decide(self, decision: Decision) -> None:
        """Emit a decision, as one of this stage."""
        self.emit(Decided(decision=replace(decision, stage=self.stage)))

    def warn(self, message: str) -> None:
        """Emit a warning."""
        self.emit(Warned(stage=self.stage, message=message))

    def progress(self, done: float, total: float, note: str = "") -> None:
        """Emit the progress of the node."""
        self.emit(StageProgress(stage=self.stage, done=done, total=total, note=note))

    def sfm_progress(self, progress: SfmProgress) -> None:
        """Emit the progress of structure from motion."""
        self.emit(StageProgress(stage=self.stage, **asdict(progress)))


class Notes(UntrustedRecord):
    """What stands in notes.json."""

    decisions: tuple[Decision, ...]
    warnings: tuple[str, ...]


def read_notes(folder: Path, stage: str) -> list[Event]:
    """Read the decisions and warnings of a finished node; BadInput where they are none."""
    notes = parse_record(Notes, read_json(folder / "notes.json", ("decisions", "warnings")), "notes.json")
    decided = [Decided(decision=decision) for decision in notes.decisions]
    return [*decided, *(Warned(stage=stage, message=message) for message in notes.warnings)]
