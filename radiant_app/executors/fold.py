"""The fold of a tree, the same under every executor: which node may start, what is skipped, tried again, given up, or ends the run.

A `Runner` says where and how a node's process runs. Of the nodes that can run, devices come first, since edges and the cloud wait for
them; teachers take what is left. Runs once per run; between two messages it only waits.

    crashed      the process ended without a word, or was silent for `SILENT_S`: tried again from its checkpoint, `attempts` times in all
    late         by `Watch`, which knows the plan's times: given up where the rest can go on without it, else a warning
    failed       said so itself: a warning where the rest can go on without it, else the end of the run

Time counts against a node only as far as the fold itself ran and could hear it: a run that is suspended for an hour (SIGSTOP, a frozen
container) finds its nodes as it left them. What has arrived is heard before anybody is judged, and what is sealed is done.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from radiant_app.events import Event, Listener, StageDone, StageSkipped, StageStarted, Warned
from radiant_app.executors.protocol import NodeTask, NodeTime, Prepare
from radiant_core.aggregate.tree import Tree
from radiant_core.errors import BadInput, StageFailed
from radiant_core.io.run_store import disk_is_full, is_sealed

URGENCY = {"device": 0, "edge": 1, "cloud": 2, "teacher": 3}
"""Order in which nodes that can run are started: that of the longest way to the end. A teacher only shortens its edge."""
SILENT_S = 300.0
"""A worker beats every few seconds from a thread of its own; without a beat for so long it counts as dead and is stopped."""
LOOK_S = 1.0
"""Longest time between two looks at who is late or silent."""
MOST_LOOKS = 5
"""So many times `LOOK_S` is the most that counts against a node between two looks: where it was longer, the fold did not run."""
PAUSE_S = 30.0
"""A wait that took so much longer than it was asked to was a pause of the whole process. Below, a busy machine explains it."""


@dataclass(frozen=True, kw_only=True)
class Began:
    """A node that had to wait for a machine runs."""

    machine: str


@dataclass(frozen=True, kw_only=True)
class Ended:
    """A node's process is gone."""

    error: BadInput | StageFailed | None = None
    """Why the node is not done; None where it is."""
    crashed: bool = False
    """Whether it ended without saying why, so that another try may help."""


MayFail = Callable[[Tree, BadInput | StageFailed], bool]
"""Whether the rest goes on without a node that failed so."""


class Runner(Protocol):
    """Where the processes of nodes run."""

    def has_room(self) -> bool:
        """Whether another node may be started now."""
        ...

    def start(self, node: Tree, task: NodeTask) -> bool:
        """Start the node's process; whether it runs now, else a `Began` will say when. The node is not running."""
        ...

    def wait(self, timeout_s: float) -> tuple[str, Event | Began | Ended | None] | None:
        """The next message of a running node, by node id: an event, its end, or None for a mere sign of life. None after the timeout.

        StageFailed when the runner itself is lost.
        """
        ...

    def stop(self, node_id: str) -> None:
        """Ask a running node to end soon; its end is a message of `wait`."""
        ...

    def stop_all(self) -> None:
        """End every running node and wait for that."""
        ...


class Watch(Protocol):
    """Who is late."""

    def late(self, node_id: str, ran_s: float) -> str | None:
        """Why a node that has run so long is late, and None while it is not."""
        ...

    def too_late(self, node_id: str, ran_s: float) -> str | None:
        """Why nobody should wait for it any longer, and None while somebody should."""
        ...

    def paused(self, node_ids: Collection[str], seconds: float) -> None:
        """The run stood still for so long while these nodes ran: what they will have taken says nothing of others."""
        ...


@dataclass(frozen=True, kw_only=True)
class Faults:
    """What is done about nodes that fail."""

    may_fail: MayFail = lambda node, error: False
    attempts: int = 1
    """How often a node is tried whose process ends without saying why."""
    watch: Watch | None = None
    """Who is late; None: nobody is."""
    on_lost: Callable[[Tree, Collection[str]], None] = lambda node, begun: None
    """Told of a node that the rest goes on without, and of the ids of all that run or are done by then."""


@dataclass(kw_only=True)
class _Running:
    node: Tree
    task: NodeTask
    started_s: float
    watched_s: float = 0.0
    """How long it has run, as far as that counts against it."""
    silent_s: float = 0.0
    """As `watched_s`, since its last sign of life."""
    began: bool = False
    """Whether it runs, or waits for a machine."""
    note: str = ""
    """Why it is tried again."""
    warned: bool = False
    given_up: Ended | None = None
    """Why it was told to end before it was done."""


@dataclass(kw_only=True)
class Fold:
    """One fold; lives as long as the call of an executor."""

    runner: Runner
    prepare: Prepare
    listen: Listener
    clock: Callable[[], float]
    faults: Faults
    running: dict[str, _Running] = field(default_factory=dict)
    times: dict[str, NodeTime] = field(default_factory=dict)
    needless: set[str] = field(default_factory=set)
    """Teachers whose edge has all its devices."""
    num_tries: dict[str, int] = field(default_factory=dict)
    origin_s: float = 0.0
    looked_s: float = 0.0
    """When it was last looked who is late, by the system's clock."""

    def run(self, tree: Tree) -> Mapping[str, NodeTime]:
        """Run every node; see `Executor.fold`."""
        waiting = sorted(tree, key=lambda node: URGENCY[node.tier])
        edges = [node for node in tree if node.tier == "edge"]
        self.origin_s, self.looked_s = self.clock(), time.monotonic()
        try:
            while waiting or self.running:
                while (node := self._next(waiting)) is not None:
                    waiting.remove(node)
                    self._begin(node)
                    self._drop_needless(edges)
                if self.running:
                    if self._hear():
                        self._look_for_late()
                    self._drop_needless(edges)
        finally:
            self.runner.stop_all()
        return self.times

    def _hear(self) -> bool:
        """Handle what has arrived, for `LOOK_S` at most; whether nothing is left. Else it may be the end of the one that seems late."""
        begun_s = time.monotonic()
        message = self.runner.wait(LOOK_S)
        waited_s = time.monotonic() - begun_s
        if waited_s > LOOK_S + PAUSE_S:
            self._tell_pause(waited_s)
        until_s = time.monotonic() + LOOK_S
        while message is not None and time.monotonic() < until_s:
            self._handle(*message)
            message = self.runner.wait(0.0) if self.running else None
        if message is not None:
            self._handle(*message)
        return message is None

    def _tell_pause(self, seconds: float) -> None:
        at_work = [running for running in self.running.values() if running.began]
        for running in at_work:
            message = f"the run stood still for {seconds:.0f} s meanwhile, as if suspended: this time does not count towards its deadline."
            self.listen(Warned(stage=running.task.stage, message=message))
        if self.faults.watch is not None:
            self.faults.watch.paused([running.node.id for running in at_work], seconds)

    def _drop_needless(self, edges: list[Tree]) -> None:
        """An edge whose devices are all there takes what its teachers have rendered so far and does the rest itself."""
        for edge in edges:
            if all(device.id in self.times for teacher in edge.children for device in teacher.children):
                self.needless.update(child.id for child in edge.children if child.tier == "teacher")
        for node_id in self.needless & self.running.keys():
            self._give_up(self.running[node_id], Ended())

    def _next(self, waiting: list[Tree]) -> Tree | None:
        """The most urgent node that can start now, if there is room."""
        if not self.runner.has_room():
            return None
        ready = [node for node in waiting if all(child.id in self.times for child in node.children)]
        # What needs no worker must not wait behind what does: an edge waits for it.
        return next((node for node in ready if node.id in self.needless), ready[0] if ready else None)

    def _now_s(self) -> float:
        return self.clock() - self.origin_s

    def _begin(self, node: Tree) -> None:
        task = self.prepare(node)
        now_s = self._now_s()
        if task is None:
            self.times[node.id] = NodeTime(started_s=now_s, ended_s=now_s)
            return
        if is_sealed(task.folder, task.key):
            self.times[node.id] = NodeTime(started_s=now_s, ended_s=now_s)
            self.listen(StageSkipped(stage=task.stage))
            return
        if node.id in self.needless:
            self.times[node.id] = NodeTime(started_s=now_s, ended_s=now_s)
            return
        self._start(node, task, now_s)

    def _start(self, node: Tree, task: NodeTask, now_s: float, note: str = "") -> None:
        self.num_tries[node.id] = self.num_tries.get(node.id, 0) + 1
        running = _Running(node=node, task=task, started_s=now_s, note=note)
        self.running[node.id] = running
        if self.runner.start(node, task):
            self._began(running)

    def _began(self, running: _Running, machine: str = "") -> None:
        running.began = True
        self.listen(StageStarted(stage=running.task.stage, machine=machine))
        if running.note:
            self.listen(Warned(stage=running.task.stage, message=running.note))

    def _handle(self, node_id: str, message: Event | Began | Ended | None) -> None:
        running = self.running[node_id]
        running.silent_s = 0.0
        if isinstance(message, Began):
            running.started_s, running.watched_s = self._now_s(), 0.0
            self._began(running, message.machine)
        elif isinstance(message, Ended):
            del self.running[node_id]
            done = message.error is None or is_sealed(running.task.folder, running.task.key)
            self._finish(running, Ended() if done else running.given_up or message)
        elif message is not None:
            self.listen(message)

    def _finish(self, running: _Running, ended: Ended) -> None:
        task, error = running.task, ended.error
        if error is not None:
            full = disk_is_full(task.folder)
            if ended.crashed and not full and self.num_tries[running.node.id] < self.faults.attempts:
                note = " ".join([running.note, f"{_reason(task, error)} It is tried again from its last checkpoint."]).strip()
                self._start(running.node, task, self._now_s(), note)
                return
            if full or not self.faults.may_fail(running.node, error):
                raise error
            self.listen(Warned(stage=task.stage, message=_reason(task, error)))
            self.faults.on_lost(running.node, {*self.times, *self.running})
        now_s = self._now_s()
        self.times[running.node.id] = NodeTime(started_s=running.started_s, ended_s=now_s)
        if error is None and running.began:
            self.listen(StageDone(stage=task.stage, seconds=now_s - running.started_s))

    def _look_for_late(self) -> None:
        now_s = time.monotonic()
        passed_s, self.looked_s = min(now_s - self.looked_s, MOST_LOOKS * LOOK_S), now_s
        for node_id, running in self.running.items():
            running.watched_s += passed_s
            running.silent_s += passed_s
            if running.given_up is not None or not running.began:
                continue
            stage, silent_s = running.task.stage, running.silent_s
            if silent_s > SILENT_S:
                message = f"{stage}: its process gave no sign of life for {silent_s:.0f} s and was stopped; run again with --resume."
                self._give_up(running, Ended(error=StageFailed(message), crashed=True))
            elif self.faults.watch is not None:
                self._look_at(node_id, running, running.watched_s, self.faults.watch)

    def _look_at(self, node_id: str, running: _Running, ran_s: float, watch: Watch) -> None:
        if (reason := watch.too_late(node_id, ran_s)) is not None:
            error = StageFailed(f"{running.task.stage}: {reason}, and was given up.")
            if self.faults.may_fail(running.node, error):
                self._give_up(running, Ended(error=error))
                return
        if not running.warned and (reason := watch.late(node_id, ran_s)) is not None:
            running.warned = True
            self.listen(Warned(stage=running.task.stage, message=f"{reason}; it goes on."))

    def _give_up(self, running: _Running, ended: Ended) -> None:
        if running.given_up is None:
            running.given_up = ended
            self.runner.stop(running.node.id)


def _reason(task: NodeTask, error: Exception) -> str:
    return str(error).removeprefix(f"{task.stage}: ")
