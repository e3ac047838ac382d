"""The network executor: the same fold, whose leaves are machines of others that ask for work.

    leaf          a task is offered to its node, which fetches it, works, and sends the result; that
                  is moved beside the task and sealed, as if the node's process had worked here
    inner node    a process here
    lost          a node that asked for nothing during its lease is given up; any request extends
                  it, so that a slow link costs nothing

The tree is cut at the edges: the cloud's leaves are edges, an edge's are its devices. What a device
sends goes no farther than its edge, but for the edge's report.
"""

from __future__ import annotations

import re
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, get_args

from radiant_app.events import (
    Decided,
    Event,
    Failed,
    Foreseen,
    Heartbeat,
    Listener,
    Outlined,
    RunLeft,
    StageDone,
    StageSkipped,
    StageStarted,
    TimeLeft,
    Warned,
    decode,
)
from radiant_app.executors.fold import Fold, NodeEnded, NodeStarted, RetryPolicy
from radiant_app.executors.local import Processes, worker_command
from radiant_app.executors.protocol import NodeTask, NodeTime, Prepare
from radiant_app.network.contents import check_result, settle_notes
from radiant_app.network.hub import Hub
from radiant_app.network.kinds import NOTES_NAME
from radiant_app.network.reception import Ended, NodeMessage, plain_text
from radiant_core.aggregate.tree import Tree
from radiant_core.errors import BadInput, CannotWrite, RadiantError, StageFailed
from radiant_core.io.run_store import seal, write_json

LEASE_S = 900.0
"""Shortest lease: a machine restarts, or finds its way back into a network, in less."""
ALIVE_S = 30.0
"""Interval of the signs of life of a node with a lease."""
CHECK_S = 0.05
LOOK_S = 1.0
"""Interval of looking for results that were unpacked by another process of this machine."""
MAX_STEP_S = 5.0
"""Most seconds that count against a node between two checks."""
FOLDING = ("region", "edge_refine")
"""Work that begins for its node when those below it are done: so long only the lease counts."""
MAX_SAYINGS = 1000
"""Warnings and decisions that are heard of one task: a run keeps them all in its manifest."""
_PART = re.compile(r"(?:/[a-z_]{1,32}[0-9]{0,2})?")
"""What follows the id of a device in the stages of its work."""
_FORWARDED = tuple(kind for kind in get_args(Event) if kind not in (Failed, Heartbeat, Outlined, Foreseen, RunLeft, TimeLeft, StageSkipped))


class Stopped(StageFailed):
    """Who asked for the work waits for it no more."""


@dataclass(kw_only=True)
class NetworkExecutor:
    """Runs leaves on the nodes that joined `hub`, inner nodes here."""

    hub: Hub
    run: str
    """Number of the run."""
    lease_s: Callable[[str], float] = lambda node_id: LEASE_S
    """Id of a node in the tree → how long it may be silent."""
    clock: Callable[[], float] = time.monotonic
    """Seconds; leases are counted by it too, so that a system clock that is set right ends none."""
    command: Callable[[NodeTask], list[str]] = worker_command
    retry_policy: RetryPolicy = field(default_factory=RetryPolicy)
    stopping: threading.Event = field(default_factory=threading.Event)
    """Set to end the fold."""
    num_threads: int = 1
    is_far: Callable[[Tree], bool] = lambda node: not node.children
    devices_of: Callable[[str], Collection[str]] = lambda machine: ()
    """Id of a machine → the devices below it, of which it may speak; a device has none."""

    def fold(self, tree: Tree, prepare: Prepare, listen: Listener) -> Mapping[str, NodeTime]:
        """See `Executor.fold`."""
        local = Processes(num_workers=1, command=self.command, num_threads=self.num_threads)
        runner = _Machines(executor=self, local=local)

        def settle(event: Event) -> None:
            if isinstance(event, StageSkipped):
                self.hub.settle_stage(self.run, event.stage)
            listen(event)

        return Fold(runner=runner, prepare=prepare, listen=settle, clock=self.clock, retry_policy=self.retry_policy).run(tree)


@dataclass(kw_only=True)
class _Far:
    task: NodeTask
    digest: str
    node: str
    """The id of the machine."""
    heard: int
    """How many of its requests had come when it was looked for last."""
    alive_s: float
    """When it was told last that it is waited for."""
    silent_s: float = 0.0
    """How long nothing was heard of it, while somebody here could have heard it."""
    started: bool = False
    begun: set[str] = field(default_factory=set)
    """Stages that its events have begun."""
    num_said: int = 0
    """Warnings and decisions that were heard of this task."""


@dataclass(kw_only=True)
class _Machines:
    """The machines of one fold; see `Runner`."""

    executor: NetworkExecutor
    local: Processes
    far: dict[str, _Far] = field(default_factory=dict)
    ready: deque[tuple[str, Event | NodeStarted | NodeEnded | None]] = field(default_factory=deque)
    checked_s: float | None = None
    """When leases were checked last."""
    looked_s: float = 0.0
    """When results were looked for last that came by another carrier."""

    def has_room(self, num_nodes: int = 1) -> bool:
        """Far nodes are machines of their own."""
        return True

    def open_gang(self, gang: str, members: Sequence[tuple[Tree, NodeTask]]) -> None:
        """Nothing: nodes of others are where they are."""

    def close_gang(self, gang: str) -> None:
        """Nothing, as `open_gang`."""

    def start(self, node: Tree, task: NodeTask) -> bool:
        if not self.executor.is_far(node):
            return self.local.start(node, task)
        name = machine_of(node.id)
        offered = self.executor.hub.offer(self.executor.run, name, task.kind, task.stage, task.folder)
        self.far[node.id] = _Far(
            task=task, digest=offered.digest, node=name, heard=self.executor.hub.heard_of.get(name, 0), alive_s=self.executor.clock()
        )
        if offered.state in ("taken", "received") and task.kind not in FOLDING:
            self._mark_started(node.id)
        if offered.state == "received":
            self.executor.hub.messages.put(NodeMessage(digest=offered.digest, received=True))
        return False

    def wait(self, timeout_s: float) -> tuple[str, Event | NodeStarted | NodeEnded | None] | None:
        until_s = time.monotonic() + timeout_s
        while True:
            if self.executor.stopping.is_set():
                raise Stopped("the work was stopped by who asked for it.")
            self._listen_to_nodes()
            self._find_carried()
            self._check_leases()
            if self.ready:
                return self.ready.popleft()
            left_s = until_s - time.monotonic()
            message = self.local.wait(max(0.0, min(CHECK_S, left_s))) if self.local.running else None
            if message is not None or left_s <= 0:
                return message
            if not self.local.running:
                time.sleep(min(CHECK_S, left_s))

    def _listen_to_nodes(self) -> None:
        while not self.executor.hub.messages.empty():
            message = self.executor.hub.messages.get()
            addressed = next(((node_id, far) for node_id, far in self.far.items() if far.digest == message.digest), None)
            if addressed is None:
                continue
            node_id, far = addressed
            if message.is_taken and far.task.kind not in FOLDING:
                self._mark_started(node_id)
            for event in self._heard(far, message.events):
                if isinstance(event, StageStarted) and event.stage == far.task.stage:
                    self._mark_started(node_id)
                else:
                    self.ready.append((node_id, event))
            if message.received:
                self._end(node_id, self._take(far))
            elif message.ended is not None:
                self._end(node_id, ended_of(far.task.stage, message.ended))

    def _heard(self, far: _Far, lines: Collection[str]) -> list[Event]:
        """What a node says of its task, as far as it may be heard."""
        devices, events = self.executor.devices_of(far.node), list[Event]()
        for event in (event for line in lines for event in admit_event(line, far.node, far.begun, devices)):
            if isinstance(event, Warned | Decided):
                far.num_said += 1
            if not isinstance(event, Warned | Decided) or far.num_said <= MAX_SAYINGS:
                events.append(event)
            elif far.num_said == MAX_SAYINGS + 1:
                warning = f"{far.node} warns of and decides more than {MAX_SAYINGS:,} things: the rest is left out."
                events.append(Warned(stage=far.task.stage, message=warning))
        return events

    def _take(self, far: _Far) -> NodeEnded:
        """Move a result to its place and seal it, or refuse it."""
        hub = self.executor.hub
        try:
            names = hub.install(far.digest)
            check_result(far.task.kind, far.task.folder, names)
            if NOTES_NAME in names:
                settle_notes(far.task.folder, far.task.stage)
            else:
                # A report alone: whoever skips its stage later reads notes there.
                write_json(far.task.folder / NOTES_NAME, {"decisions": [], "warnings": []})
                names = [*names, NOTES_NAME]
            seal(far.task.folder, far.task.key, names)
        except CannotWrite as error:
            return NodeEnded(error=error)
        except OSError as error:
            return NodeEnded(error=CannotWrite(f"{far.task.stage}: {error.strerror or type(error).__name__} on the disk of this machine."))
        except BadInput as error:
            hub.refuse(far.digest, str(error))
            return NodeEnded(error=StageFailed(f"{far.task.stage}: what {far.node} sent cannot be used: {error}"))
        hub.accept(far.digest)
        return NodeEnded()

    def _mark_started(self, node_id: str) -> None:
        self.far[node_id].started = True
        self.ready.append((node_id, NodeStarted(machine=self.far[node_id].node)))

    def _end(self, node_id: str, ended: NodeEnded) -> None:
        if ended.error is None and not self.far[node_id].started:
            self._mark_started(node_id)
        del self.far[node_id]
        self.ready.append((node_id, ended))

    def _find_carried(self) -> None:
        """Take results that nobody said, since they came by a disk."""
        if (now_s := time.monotonic()) - self.looked_s < LOOK_S:
            return
        self.looked_s = now_s
        for node_id, far in list(self.far.items()):
            hub_task = self.executor.hub.store.task(far.digest)
            if hub_task is not None and hub_task.state == "received":
                self._end(node_id, self._take(far))

    def _check_leases(self) -> None:
        now_s = self.executor.clock()
        # A process that was suspended heard nobody: that counts against no node.
        passed_s, self.checked_s = min(now_s - (self.checked_s or now_s), MAX_STEP_S), now_s
        for node_id, far in list(self.far.items()):
            heard = self.executor.hub.heard_of.get(far.node, 0)
            far.silent_s, far.heard = (far.silent_s + passed_s if heard == far.heard else 0.0), heard
            if now_s - far.alive_s < ALIVE_S:
                continue
            far.alive_s = now_s
            member = self.executor.hub.store.member(far.node)
            lease_s = max(LEASE_S, self.executor.lease_s(node_id))
            if member is not None and member.revoked:
                self._lose(node_id, far, "it is revoked")
            elif far.silent_s > lease_s and not self.executor.hub.store.is_carried(far.digest):
                self._lose(node_id, far, f"nothing was heard of it for {lease_s / 60:.0f} minutes")
            else:
                self.ready.append((node_id, None))

    def _lose(self, node_id: str, far: _Far, reason: str) -> None:
        self.executor.hub.withdraw(far.digest, reason)
        self._end(node_id, NodeEnded(error=StageFailed(f"{far.task.stage}: {reason}; --resume waits for it again.")))

    def stop(self, node_id: str) -> None:
        if node_id not in self.far:
            return self.local.stop(node_id)
        self.executor.hub.withdraw(self.far[node_id].digest, "it took too long and was given up")
        far = self.far[node_id]
        self._end(node_id, NodeEnded(error=StageFailed(f"{far.task.stage}: it was given up.")))
        return None

    def stop_all(self) -> None:
        """Far nodes go on: what they finish is taken when the run goes on."""
        self.local.stop_all()


def machine_of(node_id: str) -> str:
    """The id of the machine that works on a node of a tree."""
    return "/".join(node_id.split("/")[:2])


def ended_of(stage: str, ended: Ended) -> NodeEnded:
    """How a node ended that said so."""
    kinds: dict[bool, type[RadiantError]] = {True: BadInput, False: StageFailed}
    error = CannotWrite if ended.cannot_write else kinds[ended.exit_code == BadInput.exit_code]
    failure: Any = error(f"{stage}: {ended.message.removeprefix(f'{stage}: ')}")
    return NodeEnded(error=failure, crashed=ended.crashed)


def admit_event(line: str, node: str, begun: set[str], devices: Collection[str] | None = None) -> list[Event]:
    """The event in a line that a node sent, as far as it may be heard.

    Args:
        line: as it came.
        node: the machine that sent it.
        begun: stages that it began before; this line's is added.
        devices: names of the devices below an edge, of which it speaks too; None: any.

    Returns:
        None, one, or the beginning that its end lacks before it: of its own stages, typed to the
        last field, in texts without control characters, and in no emulated time.
    """
    try:
        event = decode(line)
    except StageFailed:
        return []
    stage = event.decision.stage if isinstance(event, Decided) else getattr(event, "stage", "")
    if not isinstance(event, _FORWARDED) or not _is_own(stage, node, devices):
        return []
    event = _plain_event(event)
    if isinstance(event, StageStarted):
        begun.add(stage)
    elif isinstance(event, StageDone) and stage.startswith("edges/"):
        return []  # said here, when its result is there
    elif isinstance(event, StageDone) and stage not in begun:
        begun.add(stage)
        return [StageStarted(stage=stage), event]
    return [event]


def _is_own(stage: str, node: str, devices: Collection[str] | None) -> bool:
    """Whether a node may speak of a stage: of its own work, or an edge of that of its devices."""
    if stage.startswith(node) and _PART.fullmatch(stage.removeprefix(node)):
        return True
    match = re.match(r"devices/([A-Za-z0-9][A-Za-z0-9_-]{0,63})", stage)
    if match is None or not node.startswith("edges/") or not _PART.fullmatch(stage[match.end() :]):
        return False
    return devices is None or match[1] in devices


def _plain_event(event: Event) -> Event:
    """Its texts are printed in a terminal, and its times are those of a machine that is there."""
    if isinstance(event, Decided):
        return Decided(decision=replace(event.decision, **_plain_texts(event.decision)))
    real = {"emulated": False} if isinstance(event, StageStarted | StageDone | StageSkipped) else {}
    return replace(event, **_plain_texts(event), **real)


def _plain_texts(record: Any) -> dict[str, Any]:
    values = {text_field.name: getattr(record, text_field.name) for text_field in fields(record)}
    return {name: plain_text(value) for name, value in values.items() if isinstance(value, str)}
