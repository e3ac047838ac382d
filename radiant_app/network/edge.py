"""What an edge does with a task of the cloud: `EdgeRun` in a thread. Once per task."""

from __future__ import annotations

import os
import queue
import sqlite3
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from radiant_app.events import Event
from radiant_app.executors.local import worker_command
from radiant_app.executors.protocol import NodeTask
from radiant_app.network.errands import Outcome
from radiant_app.network.hub import Hub
from radiant_app.network.messages import EDGE_TASKS
from radiant_app.network.regions import REQUESTS, EdgeRun
from radiant_core.errors import BadInput, RadiantError
from radiant_core.hierarchy.codec import load_task
from radiant_core.io.transport.envelope import Envelope


@dataclass(kw_only=True)
class EdgeWork:
    """A thread that folds the devices of an edge."""

    part: EdgeRun
    events: queue.Queue[Event]
    thread: threading.Thread | None = None
    ended: Outcome | None = None
    files: Mapping[str, Path] = field(default_factory=dict)

    def start(self, kind: str, folder: Path) -> None:
        """Begin a task of this kind, whose files are in `folder`."""
        task = load_task(EDGE_TASKS[kind], folder, f"{kind} task")
        self.thread = threading.Thread(target=self._work, args=(kind, task), daemon=True)
        self.thread.start()

    def _work(self, kind: str, task: object) -> None:
        try:
            self.files = self.part.answer(kind, task)
            self.ended = Outcome()
        except RadiantError as error:
            self.ended = Outcome(error=error)
        except (OSError, sqlite3.Error) as error:
            reason = str(getattr(error, "strerror", None) or error or type(error).__name__)
            self.ended = Outcome(error=BadInput(f"{reason} on the disk of this edge."))
        finally:
            # A thread that died of our own fault is a crash: its outcome is said, then it is seen.
            self.ended = self.ended or Outcome(error=BadInput("this edge failed by a fault of the software; its terminal says which."))

    def heard(self) -> list[Event]:
        """See `Work`."""
        return [self.events.get() for _ in range(self.events.qsize())]

    def outcome(self) -> Outcome | None:
        """See `Work`."""
        return self.ended

    def stop(self) -> None:
        """See `Work`."""
        self.part.stopping.set()
        if self.thread is not None:
            self.thread.join()

    def result(self) -> Mapping[str, Path]:
        """See `Work`."""
        return self.files


@dataclass(frozen=True, kw_only=True)
class EdgePerformer:
    """Works on the tasks of an edge."""

    hub: Hub
    command: Callable[[NodeTask], list[str]] = worker_command
    listen: Callable[[Event], None] = lambda event: None
    """Hears the events of its devices too."""

    def place(self, envelope: Envelope) -> Path:
        """See `Performer`."""
        folder = self.hub.home.run_folder(envelope.run) / REQUESTS / envelope.kind
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def begin(self, envelope: Envelope, folder: Path, digest: str) -> EdgeWork:
        """See `Performer`."""
        del digest
        if envelope.kind not in EDGE_TASKS:
            raise BadInput(f"an edge was asked for {envelope.kind[:40]!r}, which is a device's work: look at the join files.")
        self.hub.store.withdraw_all(envelope.run)
        events: queue.Queue[Event] = queue.Queue()

        def emit(event: Event) -> None:
            events.put(event)
            self.listen(event)

        threads = os.cpu_count() or 1
        part = EdgeRun(hub=self.hub, number=envelope.run, emit=emit, command=self.command, num_threads=threads)
        work = EdgeWork(part=part, events=events)
        work.start(envelope.kind, folder)
        return work
