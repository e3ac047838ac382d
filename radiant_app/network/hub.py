"""`Hub`: the node that others join, as who conducts uses it: offer a task, take its result. Once
per process."""

from __future__ import annotations

import queue
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from radiant_app.network.arrivals import INCOMING, Arrivals
from radiant_app.network.home import Home, Listening
from radiant_app.network.kinds import RESULT_FILES, task_files, task_problem
from radiant_app.network.reception import NodeMessage, Reception
from radiant_app.network.serving import serve
from radiant_app.network.store import HubStore, KnownTask, open_store
from radiant_core import __version__
from radiant_core.errors import BadInput
from radiant_core.io.transport.delivery import describe_files
from radiant_core.io.transport.envelope import Envelope, open_envelope, sign_envelope

POLL_S = 2.0
"""How long nodes wait between two polls."""
MAX_MESSAGES = 200
"""While nobody reads, members could fill the memory with events: these are progress alone."""


@dataclass(kw_only=True)
class Hub:
    """A node that others join, while it listens."""

    home: Home
    store: HubStore
    arrivals: Arrivals
    port: int = 0
    messages: queue.Queue[NodeMessage] = field(default_factory=queue.Queue)
    """What nodes say of their tasks."""
    heard_of: Mapping[str, int] = field(default_factory=dict)
    """Node → how many requests it made of this process."""

    def hear(self, message: NodeMessage) -> None:
        """Keep what a node says until it is read; of events no more than `MAX_MESSAGES`."""
        if self.messages.qsize() >= MAX_MESSAGES:
            message = replace(message, events=())
        if message != NodeMessage(digest=message.digest):
            self.messages.put(message)

    def public_key(self, node: str) -> bytes:
        """The key of a node that joined, in PEM; BadInput where it has not."""
        member = self.store.member(node)
        if member is None or member.key is None:
            name = node.rsplit("/", maxsplit=1)[-1]
            raise BadInput(f"{node} has not joined: radiant node invite {name}, and take the file to that machine.")
        return member.key.public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)

    def offer(self, run: str, node: str, kind: str, stage: str, folder: Path) -> KnownTask:
        """Sign the files of a task in `folder` and offer it; the same files are the same task,
        other ones a new attempt. BadInput where files are missing."""
        files = describe_files(task_files(kind, folder))
        attempt, last = 1, self.store.newest_attempt(run, node, stage)
        if last is not None:
            before = open_envelope(last.text, last.signature, self.home.key.public_key())
            is_same_task = (before.files, before.kind, before.software) == (files, kind, __version__)
            attempt = last.attempt if is_same_task else last.attempt + 1
        envelope = Envelope(
            run=run,
            sender=self.home.node,
            receiver=node,
            kind=kind,
            stage=stage,
            attempt=attempt,
            answers="",
            software=__version__,
            files=files,
        )
        if problem := task_problem(kind, files):
            raise BadInput(problem)
        text, signature = sign_envelope(envelope, self.home.key)
        task = KnownTask(
            digest=envelope.digest,
            run=run,
            node=node,
            stage=stage,
            attempt=attempt,
            text=text,
            signature=signature,
            folder=folder.resolve(),
            tries=1,
            state="offered",
            reason="",
            changed_s=0.0,
        )
        return self.store.put_task(task)

    def install(self, digest: str) -> Sequence[str]:
        """Move the files of a received result beside its task; their names."""
        result, folder = self._result(digest), self._task(digest).folder
        files = RESULT_FILES[result.kind]
        for name in {*files.needed, *files.possible} - {*result.files}:
            # Of an earlier attempt, which had it.
            (folder / name).unlink(missing_ok=True)
        return self.arrivals.install(digest, result, folder)

    def accept(self, digest: str) -> None:
        """Tell the node that its result is taken."""
        self.store.move_task(digest, "accepted", ("received",))
        self.arrivals.remove(digest)

    def refuse(self, digest: str, reason: str) -> None:
        """Tell the node that its result cannot be used, and why."""
        self.store.move_task(digest, "refused", ("received",), reason)
        self.arrivals.remove(digest)

    def withdraw(self, digest: str, reason: str = "") -> None:
        """Wait for a task no more."""
        self.store.move_task(digest, "withdrawn", ("offered", "taken", "received"), reason)
        self.arrivals.remove(digest)

    def reject_stage(self, run: str, stage: str, reason: str) -> None:
        """What was accepted for a stage cannot be used: asked again, its node makes it anew."""
        self.store.reject_stage(run, stage, reason)

    def settle_stage(self, run: str, stage: str) -> None:
        """A stage is sealed: what was received for it is taken, also if a process ended between."""
        self.store.settle_stage(run, stage)

    def _task(self, digest: str) -> KnownTask:
        task = self.store.task(digest)
        assert task is not None
        return task

    def _result(self, digest: str) -> Envelope:
        task = self._task(digest)
        result, member = self.store.result(digest), self.store.member(task.node)
        assert result is not None
        if member is None or member.key is None or member.revoked:
            raise BadInput(f"{task.node} is not known here any more.")
        return open_envelope(*result, member.key)


@contextmanager
def open_hub(home: Home, poll_s: float | None = None) -> Iterator[Hub]:
    """Listen for nodes, which poll every `poll_s`, until the end of the block; BadInput where that
    cannot be done."""
    listening: Listening = home.listening
    (home.folder / INCOMING).mkdir(exist_ok=True)
    with open_store(home.folder) as store:
        hub = Hub(home=home, store=store, arrivals=Arrivals(folder=home.folder / INCOMING))
        reception = Reception(node=home.node, key=home.key, store=store, arrivals=hub.arrivals, heard=hub.hear, poll_s=poll_s or POLL_S)
        hub.heard_of = reception.heard_of
        hub.arrivals.remove_all_but(store.open_digests())
        with serve(listening, home.identity, reception) as port:
            hub.port = port
            yield hub
