"""What a device does with a task: the installed worker of its kind, in a folder of its own.

    HOME/runs/<run>/devices/<id>/           own_source.json: where its photographs are; its model
                        .../{count,raster,refine,refine2,…,score}/

No code comes with a task, and no name of a photograph. The worker checks the signature of its edge
once more. Once per task.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from radiant_app.events import Decided, Event
from radiant_app.executors.fold import NodeEnded
from radiant_app.executors.local import Processes, worker_command
from radiant_app.executors.protocol import NodeTask
from radiant_app.network.errands import Outcome
from radiant_app.network.home import Home
from radiant_app.network.kinds import RESULT_FILES
from radiant_app.workers.delivering import identify_owned, identify_part, use_run_number
from radiant_app.workers.own_photographs import save_own_source
from radiant_core.aggregate.tree import Tree
from radiant_core.hierarchy.codec import FRAME_NAME, sent_files
from radiant_core.io.run_store import is_sealed, read_json
from radiant_core.io.transport.delivery import RECORD_NAME, SIGNATURE_NAME
from radiant_core.io.transport.envelope import Envelope

LEAVES = (
    "how many photographs it has, and how many of them stand in each cell of a raster (5 m unless the owner of the run says else)",
    "a model of what they show, which rendered at their places resembles them, and what they change in the joined scene",
    "to its edge alone: where each photograph was taken, under a number",
    "figures of the finished scene on the photographs that it holds out; messages, with names left out",
)
HIDDEN_PLACE = "[a folder of the device]"
_NO_WORD = r"(?:(?<![\w-])|(?<=\\[abfnrtv])|(?<=\\x[0-9a-f]{2})|(?<=\\u[0-9a-f]{4}))"
"""No letter stands before, but that of an escape."""
STAYS = "photographs, their names, their EXIF, pictures made of them"


@dataclass(kw_only=True)
class DeviceWork:
    """The worker process of one task; or none, where its folder is sealed."""

    folder: Path
    task: NodeTask
    processes: Processes
    places: tuple[Path, ...] = ()
    """Folders of the device's owner, whose names are nobody's business."""
    ended: Outcome | None = None
    events: list[Event] = field(default_factory=list)

    def heard(self) -> list[Event]:
        """See `Work`."""
        while self.processes.running and (message := self.processes.wait(0.0)) is not None:
            _, event = message
            if isinstance(event, NodeEnded):
                error = event.error and type(event.error)(hide_places(str(event.error), self.places))
                self.ended = Outcome(error=error, crashed=event.crashed)
            elif event is not None:
                self.events.append(hide_in_event(event, self.places))
        events, self.events = self.events, []
        return events

    def outcome(self) -> Outcome | None:
        """See `Work`."""
        return self.ended

    def stop(self) -> None:
        """See `Work`."""
        self.processes.stop_all()

    def result(self) -> Mapping[str, Path]:
        """See `Work`."""
        if self.task.kind != "own_field":
            names = RESULT_FILES[self.task.kind].needed
            return {name: self.folder / name for name in names}
        files = {name: self.folder / name for name in RESULT_FILES["own_field"].needed}
        if read_json(self.folder / FRAME_NAME, ("status",))["status"] != "placed":
            return files
        signed = {name: self.folder / name for name in (RECORD_NAME, SIGNATURE_NAME)}
        return {**files, **sent_files(self.folder), **signed}


def hide_places(text: str, places: Iterable[Path]) -> str:
    """A text, or a line of JSON, without the names of these folders. A folder right below the root,
    such as /north, is no part of a longer word: devices/north is an id."""
    for place in sorted({str(path) for folder in places for path in (folder, folder.resolve())}, key=len, reverse=True):
        for written in dict.fromkeys((place, json.dumps(place)[1:-1])):
            before = _NO_WORD if len(Path(place).parts) <= 2 else ""
            text = re.sub(before + re.escape(written), lambda match: HIDDEN_PLACE, text)
    return text


def hide_in_event(event: Event, places: Iterable[Path]) -> Event:
    """An event without the names of these folders in its texts; its stage stays, which says of what
    it is."""
    if isinstance(event, Decided):
        return Decided(decision=replace(event.decision, **_hidden_texts(event.decision, places)))
    return replace(event, **_hidden_texts(event, places))


def _hidden_texts(record: Any, places: Iterable[Path]) -> dict[str, str]:
    texts = {text_field.name: getattr(record, text_field.name) for text_field in fields(record) if text_field.name != "stage"}
    return {name: hide_places(text, places) for name, text in texts.items() if isinstance(text, str)}


@dataclass(frozen=True, kw_only=True)
class DevicePerformer:
    """Works on the tasks of a device."""

    home: Home
    photographs: Path
    poses: Path | None = None
    command: Callable[[NodeTask], list[str]] = worker_command

    def place(self, envelope: Envelope) -> Path:
        """See `Performer`."""
        folder = self.home.run_folder(envelope.run) / envelope.stage
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def begin(self, envelope: Envelope, folder: Path, digest: str) -> DeviceWork:
        """See `Performer`."""
        run, node, upper = self.home.run_folder(envelope.run), envelope.receiver, self.home.upper
        use_run_number(run, envelope.run)
        (run / node).mkdir(parents=True, exist_ok=True)
        key = upper.key.public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
        identify_owned(run, node, upper.upper, self.home.identity, key)
        if envelope.stage != node:
            identify_part(run, envelope.stage, node, upper.upper)
        save_own_source(run / node, self.photographs, self.poses)
        task = NodeTask(kind=envelope.kind, stage=envelope.stage, folder=folder, key=digest)
        processes = Processes(num_workers=1, command=self.command, num_threads=os.cpu_count() or 1)
        places = (self.home.folder, self.photographs, *([self.poses] if self.poses else []))
        work = DeviceWork(folder=folder, task=task, processes=processes, places=tuple(path.absolute() for path in places))
        if is_sealed(folder, digest):
            work.ended = Outcome()
        else:
            processes.start(Tree(id=envelope.stage, tier="device"), task)
        return work
