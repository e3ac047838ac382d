"""The loop of a node that asks for work: poll, fetch, work, send, wait for the verdict.

All that it knows of its task is there above and in its own folders: it may end at any moment, and
goes on after a restart where sealed files and checkpoints are. Once per node.
"""

from __future__ import annotations

import base64
import json
import shutil
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Protocol

from pydantic import AfterValidator, Field

from radiant_app.events import Event, StageProgress, Warned, encode
from radiant_app.network.arrivals import SPARE_BYTES
from radiant_app.network.carrying import keep_result
from radiant_app.network.home import Home, Invitation
from radiant_app.network.kinds import remove_earlier, task_problem
from radiant_app.network.line import Withdrawn
from radiant_app.network.reception import MAX_EVENT_CHARS, MAX_EVENTS, Ended, plain_text
from radiant_app.strangers import UntrustedRecord, parse_record
from radiant_core import __version__
from radiant_core.errors import BadInput, CannotWrite, RadiantError, StageFailed
from radiant_core.io.run_store import SEAL_NAME, disk_is_full, read_json, write_json
from radiant_core.io.transport.delivery import describe_files
from radiant_core.io.transport.envelope import MAX_COUNTER, Envelope, open_envelope

ASKED_NAME = "asked.json"
FINISHED_SCENE = "inbox/scene.ply"
"""In the folder of a score task."""
MIN_POLL_S, MAX_POLL_S = 0.05, 10.0
MAX_EVENT_BYTES = 1 << 20
"""Of all events of one poll, as JSON has them."""


class Verdict(UntrustedRecord):
    """What became of the task that a node works on."""

    state: str = Field(max_length=32)
    reason: Annotated[str, AfterValidator(plain_text)] = Field(default="", max_length=8000)
    tries: int = Field(default=1, ge=0, le=MAX_COUNTER)


class Offer(UntrustedRecord):
    """A task to do: its envelope and signature, in base 64."""

    text: str
    signature: str = Field(max_length=128)
    tries: int = Field(default=1, ge=0, le=MAX_COUNTER)
    refused: bool = False
    """Whether what was made before is not wanted."""


class PollAnswer(UntrustedRecord):
    """What the node above answers to a poll."""

    verdict: Verdict | None = None
    task: Offer | None = None
    wait_s: float = Field(default=1.0, ge=0, le=3600)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """How work ended; no error: its result is there."""

    error: RadiantError | None = None
    crashed: bool = False


class Work(Protocol):
    """One task being worked on."""

    def heard(self) -> list[Event]:
        """What happened since the last call."""
        ...

    def outcome(self) -> Outcome | None:
        """How it ended; None while it goes on."""
        ...

    def stop(self) -> None:
        """End it; what is saved stays."""
        ...

    def result(self) -> Mapping[str, Path]:
        """Name → file of its result."""
        ...


class Performer(Protocol):
    """Does the work of one kind of node."""

    def place(self, envelope: Envelope) -> Path:
        """The folder for the files of a task."""
        ...

    def begin(self, envelope: Envelope, folder: Path, digest: str) -> Work:
        """Begin a task whose files are in `folder`, or go on with it; BadInput where they cannot be
        used."""
        ...


class Way(Protocol):
    """How a node's requests reach the one above: a `Line`, or what was carried by hand."""

    ended: threading.Event
    upper: Invitation

    @property
    def counter(self) -> int:
        """That of the next request."""
        ...

    def enter(self) -> None:
        """Join, unless that was done before."""
        ...

    def poll(self, body: Mapping[str, Any]) -> dict[str, Any]:
        """What the node above answers to what this one does."""
        ...

    def fetch(self, envelope: Envelope, digest: str, folder: Path) -> None:
        """Get the files of a task into a folder, each with the bytes that were signed."""
        ...

    def send(self, result: Envelope, paths: Mapping[str, Path]) -> None:
        """Send the files of a result, by name."""
        ...

    def close(self) -> None:
        """End it."""
        ...


@dataclass(kw_only=True)
class _Errand:
    envelope: Envelope
    digest: str
    tries: int
    work: Work | None = None
    outcome: Outcome | None = None
    sent: bool = False
    failure_sent: bool = False
    """Whether its failure was sent to the node above."""


@dataclass(kw_only=True)
class Errands:
    """Asks the node above for work until it is ended."""

    home: Home
    line: Way
    performer: Performer
    say: Callable[[str], None] = lambda text: None
    current: _Errand | None = None
    batch: int = 0
    waiting: list[str] = field(default_factory=list)
    """Events that were not sent yet."""
    sending: list[str] = field(default_factory=list)

    @property
    def ended(self) -> threading.Event:
        """Set to end it."""
        return self.line.ended

    def run(self) -> None:
        """Ask and work until `ended`; BadInput where the node above refuses this one."""
        try:
            self.line.enter()
            while not self.ended.is_set():
                wait_s = self._round()
                self.ended.wait(min(max(wait_s, MIN_POLL_S), MAX_POLL_S))
        except Withdrawn:
            if not self.ended.is_set():
                raise
        finally:
            self._drop()
            self.line.close()

    def _round(self) -> float:
        """One poll and what follows; how long to wait for the next."""
        self._work_on()
        body = self._poll_body()
        answer = parse_record(PollAnswer, self.line.poll(body), f"what {self.line.upper.upper} answers")
        self.sending = []
        verdict, current = answer.verdict, self.current
        if current is not None and verdict is not None:
            current.failure_sent = current.failure_sent or body["ended"] is not None
            # A hub that lost what it had, by a power cut or an old copy, asks once more.
            current.sent = current.sent and verdict.state not in ("offered", "taken")
            if verdict.state in ("accepted", "refused", "withdrawn"):
                self._say_scene(current, verdict.state)
                self._say_verdict(current, verdict.state, verdict.reason)
                self._drop()
        if answer.task is not None:
            self._take(answer.task)
        elif self.current is not None:
            self._drop()
        current = self.current
        is_untold = current is not None and current.outcome is not None and not current.sent and not current.failure_sent
        return 0.0 if is_untold else answer.wait_s

    def _poll_body(self) -> dict[str, Any]:
        current = self.current
        if not self.sending:
            num_sent = _num_fitting(self.waiting)
            self.sending, self.waiting = self.waiting[:num_sent], self.waiting[num_sent:]
            # A request's counter is larger than in any process before, whatever the clock says.
            self.batch = self.line.counter
        outcome, ended = None if current is None or current.failure_sent else current.outcome, None
        if outcome is not None and outcome.error is not None and not self.waiting:
            ended = Ended(
                message=str(outcome.error)[:MAX_EVENT_CHARS],
                exit_code=outcome.error.exit_code,
                crashed=outcome.crashed,
                cannot_write=isinstance(outcome.error, CannotWrite),
            ).model_dump()
        return {
            "software": __version__,
            "task": "" if current is None else current.digest,
            "tries": 0 if current is None else current.tries,
            "doing": self._doing(),
            "ended": ended,
            "batch": self.batch,
            "events": self.sending,
        }

    def _doing(self) -> str:
        if self.current is None:
            return "idle"
        kind = self.current.envelope.kind
        return f"{kind}: sent" if self.current.sent else f"{kind}: {'working' if self.current.outcome is None else 'ended'}"

    def _take(self, offered: Offer) -> None:
        """Begin an offered task, unless it is the current one."""
        try:
            text, signature = base64.b64decode(offered.text), base64.b64decode(offered.signature)
        except ValueError as error:
            raise BadInput(f"{self.line.upper.upper} offers a task that is none: use the same version on both sides.") from error
        tries = offered.tries
        envelope = open_envelope(text, signature, self.line.upper.key)
        if self.current is not None and (self.current.digest, self.current.tries) == (envelope.digest, tries):
            return
        self._drop()
        self.current = errand = _Errand(envelope=envelope, digest=envelope.digest, tries=tries)
        try:
            require_own(self.home, envelope)
            note_task(self.home, envelope)
            folder = self.performer.place(envelope)
            if shutil.disk_usage(self.home.folder).free < envelope.num_bytes + SPARE_BYTES:
                raise CannotWrite(f"the disk of this node is full: {envelope.num_bytes + SPARE_BYTES:,} bytes are needed there.")
            if offered.refused:
                # What was made before is not wanted.
                (folder / SEAL_NAME).unlink(missing_ok=True)
            remove_earlier(envelope.kind, folder, envelope.files)
            self.line.fetch(envelope, errand.digest, folder)
            errand.work = self.performer.begin(envelope, folder, errand.digest)
        except Withdrawn:
            # Planned anew while its files came.
            self._drop()
        except RadiantError as error:
            errand.outcome = Outcome(error=error)
        except OSError as error:
            message = f"{error.strerror or type(error).__name__} on the disk of this node."
            errand.outcome = Outcome(error=CannotWrite(message) if disk_is_full(self.home.folder) else StageFailed(message))

    def _work_on(self) -> None:
        """Hear the work, and send its result once it is there."""
        errand = self.current
        if errand is None or errand.work is None:
            return
        self._keep(errand.work.heard())
        if errand.outcome is None:
            errand.outcome = errand.work.outcome()
            self._keep(errand.work.heard())
        # What it said goes first: the node above hears nothing of a task whose result is there.
        is_said = not self.waiting and not self.sending
        if errand.outcome is not None and errand.outcome.error is None and not errand.sent and is_said:
            try:
                self._send(errand, errand.work.result())
            except Withdrawn:
                self._drop()
            except (RadiantError, OSError) as error:
                failure = error if isinstance(error, RadiantError) else StageFailed(f"{error.strerror or type(error).__name__}")
                errand.outcome = Outcome(error=failure)

    def _send(self, errand: _Errand, paths: Mapping[str, Path]) -> None:
        envelope = errand.envelope
        result = envelope.result(describe_files(paths), __version__)
        keep_result(self.home, result, paths)
        self.line.send(result, paths)
        errand.sent = True

    def _keep(self, events: list[Event]) -> None:
        """Keep events to be sent; of progress the newest alone."""
        for event in events:
            if isinstance(event, Warned):
                self.say(f"{event.stage}: {event.message}")
            line = encode(event)
            if len(line) > MAX_EVENT_CHARS:
                continue
            if isinstance(event, StageProgress):
                start = encode(event).split('"done"')[0]
                self.waiting = [waiting_line for waiting_line in self.waiting if not waiting_line.startswith(start)]
            self.waiting.append(line)

    def _say_verdict(self, errand: _Errand, state: str, reason: str) -> None:
        self.say(f"{errand.envelope.stage}: {state}{f', {reason}' if reason else '.'}")

    def _say_scene(self, errand: _Errand, state: str) -> None:
        """Where the finished scene lies, which came to be scored."""
        scene = self.performer.place(errand.envelope) / FINISHED_SCENE
        if errand.envelope.kind == "score" and state == "accepted" and scene.is_file():
            self.say(f"the finished scene is {scene}.")

    def _drop(self) -> None:
        if self.current is not None and self.current.work is not None:
            self.current.work.stop()
        self.current = None
        self.waiting = []


def require_own(home: Home, envelope: Envelope) -> None:
    """Raise BadInput unless a task is the newest that the node above gives the one in `home`."""
    upper = home.upper
    if (envelope.sender, envelope.receiver, envelope.answers) != (upper.upper, upper.node, ""):
        raise BadInput(f"a task is from {envelope.sender} for {envelope.receiver}, expected one from {upper.upper} for {upper.node}.")
    if envelope.software != __version__:
        raise BadInput(f"{upper.upper} has Radiant {envelope.software} and {upper.node} has {__version__}: install the same version.")
    if problem := task_problem(envelope.kind, envelope.files):
        raise BadInput(problem)
    attempt, digest = _noted_tasks(home, envelope).get(envelope.stage, [0, ""])
    if envelope.attempt < attempt or (envelope.attempt == attempt and envelope.digest != digest):
        raise BadInput(f"a task of {envelope.stage} is attempt {envelope.attempt}, and attempt {attempt} was taken before.")


def note_task(home: Home, envelope: Envelope) -> None:
    """Remember a task, so that no older one of its stage is taken."""
    home.run_folder(envelope.run).mkdir(parents=True, exist_ok=True)
    tasks = {**_noted_tasks(home, envelope), envelope.stage: [envelope.attempt, envelope.digest]}
    write_json(home.run_folder(envelope.run) / ASKED_NAME, tasks)


def _noted_tasks(home: Home, envelope: Envelope) -> dict[str, Any]:
    path = home.run_folder(envelope.run) / ASKED_NAME
    return read_json(path) if path.is_file() else {}


def _num_fitting(lines: list[str]) -> int:
    """How many events one poll carries."""
    num_bytes = 0
    for number, line in enumerate(lines[:MAX_EVENTS]):
        num_bytes += len(json.dumps(line))
        if num_bytes > MAX_EVENT_BYTES:
            return max(1, number)
    return min(len(lines), MAX_EVENTS)
