"""`Progress`: the manifest, listener and clock of a run, passed through its stages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from radiant_app.events import Event, Listener, StageSkipped
from radiant_app.files.run_folder import Manifest
from radiant_app.reporting import read_notes


@dataclass(frozen=True, kw_only=True)
class Progress:
    """The manifest, listener and clock of a run."""

    manifest: Manifest
    listener: Listener
    clock: Callable[[], float]
    started_s: float

    def listen(self, event: Event) -> None:
        """Record an event and forward it; of a skipped stage also its notes."""
        self.manifest.record(event, self.clock() - self.started_s)
        self.listener(event)
        if isinstance(event, StageSkipped):
            for noted in read_notes(self.manifest.folder / event.stage, event.stage):
                self.listen(noted)
