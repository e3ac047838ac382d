"""The fold of a tree under every executor: which node may start, is skipped, tried again, given up.

A `Runner` starts the process of a node. Of the nodes that can run, devices come first, since edges
and the cloud wait for them. Runs once per run.

    crashed      the process ended without reporting an error, or sent no heartbeat for `SILENT_S`:
                 started again from its checkpoint, at most `max_attempts` times in all
    overdue      by `Deadlines`: given up if the run can do without the node, else a warning
    failed       reported its error: a warning if the run can do without the node, else its end

Nodes of a gang (`Tree.gang`) run at the same time and talk to each other. They are prepared one
after another once every child outside the gang is done, then started in one go: those of them that
have work and are not sealed. A member that crashes is started again by itself while the others go
on. Members below one that is given up would wait for it without end: they are stopped and given up
with it. The node above waits for all members. Nodes that are ready may overtake a gang that waits
for room.

Time counts against a node only while the fold itself runs and can receive messages, so that a run
that is suspended (SIGSTOP, a frozen container) loses no node. Messages that have arrived are
handled before any deadline is checked, and a sealed node is done.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from radiant_app.events import Event, Listener, StageDone, StageSkipped, StageStarted, Warned
from radiant_app.executors.protocol import NodeTask, NodeTime, Prepare
from radiant_core.aggregate.tree import Tree, require_gangs
from radiant_core.errors import BadInput, StageFailed
from radiant_core.io.run_store import SEAL_NAME, disk_is_full, is_sealed

URGENCY = {"device": 0, "edge": 1, "cloud": 2}
"""Order in which nodes are started: the longest path first."""
SILENT_S = 300.0
"""Heartbeats come from a worker's own thread; without one for this long it is stopped as dead."""
CHECK_INTERVAL_S = 1.0
"""Longest time between two checks for overdue or silent nodes."""
MAX_INTERVALS = 5
"""Most intervals that count against a node between two checks: after more, the fold stood still."""
PAUSE_S = 30.0
"""A wait longer than its timeout by this much is a pause of the process, not a busy machine."""


@dataclass(frozen=True, kw_only=True)
class NodeStarted:
    """A node that waited for a machine now runs."""

    machine: str


@dataclass(frozen=True, kw_only=True)
class NodeEnded:
    """The process of a node ended."""

    error: BadInput | StageFailed | None = None
    """Why the node is not done; None where it is."""
    crashed: bool = False
    """Whether it ended without reporting an error, so that another attempt may succeed."""


MayFail = Callable[[Tree, BadInput | StageFailed], bool]
"""Whether the run goes on without a node that failed with this error."""


class Runner(Protocol):
    """Starts, observes and stops the processes of nodes."""

    def has_room(self, num_nodes: int = 1) -> bool:
        """Whether so many nodes more may be started now, to run at the same time; where nothing
        runs, any number may."""
        ...

    def open_gang(self, gang: str, members: Sequence[tuple[Tree, NodeTask]]) -> None:
        """Told before the members of a gang that have something to do are started."""
        ...

    def close_gang(self, gang: str) -> None:
        """Told when all members of a gang have ended, and none is started again."""
        ...

    def start(self, node: Tree, task: NodeTask) -> bool:
        """Start a node's process; True if it runs now, False if a `NodeStarted` follows."""
        ...

    def wait(self, timeout_s: float) -> tuple[str, Event | NodeStarted | NodeEnded | None] | None:
        """The next message of a running node: an event, its end, or None for a heartbeat; None
        after the timeout. Raises StageFailed when the runner itself is lost."""
        ...

    def stop(self, node_id: str) -> None:
        """Request the end of a running node; `wait` returns its end as a message."""
        ...

    def stop_all(self) -> None:
        """End every running node and wait until all have ended."""
        ...


class Deadlines(Protocol):
    """How long each node may take."""

    def overdue_reason(self, node_id: str, ran_s: float) -> str | None:
        """Why a node that has run for `ran_s` is overdue; None while it is not."""
        ...

    def timeout_reason(self, node_id: str, ran_s: float) -> str | None:
        """Why the run should stop waiting for the node; None while it should wait."""
        ...

    def exclude_pause(self, node_ids: Collection[str], seconds: float) -> None:
        """The run stood still for `seconds` while these nodes ran: their times predict nothing."""
        ...


@dataclass(frozen=True, kw_only=True)
class RetryPolicy:
    """Which nodes are started again, given up or required."""

    may_fail: MayFail = lambda node, error: False
    max_attempts: int = 1
    """How often a node is started whose process ends without reporting an error."""
    deadlines: Deadlines | None = None
    """None: no node has a deadline."""
    on_given_up: Callable[[Tree, Collection[str]], None] = lambda node, begun: None
    """Called with a node that the run goes on without, and ids of nodes that run or are done."""


Unit = tuple[Tree, ...]
"""Nodes that start in one go: a node by itself, or all members of a gang."""


@dataclass(kw_only=True)
class _Running:
    node: Tree
    task: NodeTask
    started_s: float
    counted_s: float = 0.0
    """How long it has run, as far as that counts against it."""
    silent_s: float = 0.0
    """As `counted_s`, since its last message."""
    is_started: bool = False
    """False while it waits for a machine."""
    note: str = ""
    """Why it was started again."""
    warned: bool = False
    given_up: NodeEnded | None = None
    """Why it was stopped before it was done."""
    is_orphan: bool = False
    """Whether that is because a member of its gang failed that it waits for."""


@dataclass(kw_only=True)
class Fold:
    """One fold; lives as long as the call of an executor."""

    runner: Runner
    prepare: Prepare
    listen: Listener
    clock: Callable[[], float]
    retry_policy: RetryPolicy
    running: dict[str, _Running] = field(default_factory=dict)
    times: dict[str, NodeTime] = field(default_factory=dict)
    gangs: dict[str, Unit] = field(default_factory=dict)
    num_tries: dict[str, int] = field(default_factory=dict)
    origin_s: float = 0.0
    checked_s: float = 0.0
    """When deadlines were last checked, by the system's clock."""

    def run(self, tree: Tree) -> Mapping[str, NodeTime]:
        """Run every node; see `Executor.fold`. BadInput for gangs that `require_gangs` refuses."""
        require_gangs(tree)
        waiting = _units(tree)
        self.gangs = {unit[0].gang: unit for unit in waiting if unit[0].gang is not None}
        self.origin_s, self.checked_s = self.clock(), time.monotonic()
        try:
            while waiting or self.running:
                while (unit := self._next(waiting)) is not None:
                    waiting.remove(unit)
                    self._begin(unit)
                if self.running and self._handle_messages():
                    self._check_deadlines()
        finally:
            self.runner.stop_all()
        return self.times

    def _handle_messages(self) -> bool:
        """Handle messages for `CHECK_INTERVAL_S`; False if some are left, which may end a node."""
        begun_s = time.monotonic()
        message = self.runner.wait(CHECK_INTERVAL_S)
        waited_s = time.monotonic() - begun_s
        if waited_s > CHECK_INTERVAL_S + PAUSE_S:
            self._report_pause(waited_s)
        until_s = time.monotonic() + CHECK_INTERVAL_S
        while message is not None and time.monotonic() < until_s:
            self._handle(*message)
            message = self.runner.wait(0.0) if self.running else None
        if message is not None:
            self._handle(*message)
        return message is None

    def _report_pause(self, seconds: float) -> None:
        started = [running for running in self.running.values() if running.is_started]
        for running in started:
            message = f"the run stood still for {seconds:.0f} s meanwhile, as if suspended: this time does not count towards its deadline."
            self.listen(Warned(stage=running.task.stage, message=message))
        if self.retry_policy.deadlines is not None:
            self.retry_policy.deadlines.exclude_pause([running.node.id for running in started], seconds)

    def _next(self, waiting: list[Unit]) -> Unit | None:
        if not self.runner.has_room():
            return None
        return next((unit for unit in waiting if all(map(self._is_ready, unit)) and self.runner.has_room(len(unit))), None)

    def _is_ready(self, node: Tree) -> bool:
        return all(self._has_ended(child) or (node.gang is not None and child.gang == node.gang) for child in node.children)

    def _has_ended(self, node: Tree) -> bool:
        """Whether a node has ended, and with it all of its gang."""
        return all(member.id in self.times for member in ((node,) if node.gang is None else self.gangs[node.gang]))

    def _now_s(self) -> float:
        return self.clock() - self.origin_s

    def _begin(self, unit: Unit) -> None:
        gang = unit[0].gang
        tasks = [(node, self.prepare(node)) for node in unit]
        if gang is not None and not all(_is_done(task) for _, task in tasks):
            # What one of them began anew the others cannot have finished.
            for task in (task for _, task in tasks if task is not None):
                (task.folder / SEAL_NAME).unlink(missing_ok=True)
        members = [(node, task) for node, task in tasks if task is not None and not self._skips(node, task)]
        for node in set(unit) - {node for node, _ in members}:
            now_s = self._now_s()
            self.times[node.id] = NodeTime(started_s=now_s, ended_s=now_s)
        if members and gang is not None:
            self.runner.open_gang(gang, members)
        for node, task in members:
            self._start(node, task, self._now_s())

    def _skips(self, node: Tree, task: NodeTask) -> bool:
        """Whether a node has nothing to do."""
        if not _is_done(task):
            return False
        self.listen(StageSkipped(stage=task.stage))
        return True

    def _start(self, node: Tree, task: NodeTask, now_s: float, note: str = "") -> None:
        self.num_tries[node.id] = self.num_tries.get(node.id, 0) + 1
        running = _Running(node=node, task=task, started_s=now_s, note=note)
        self.running[node.id] = running
        if self.runner.start(node, task):
            self._mark_started(running)

    def _mark_started(self, running: _Running, machine: str = "") -> None:
        running.is_started = True
        self.listen(StageStarted(stage=running.task.stage, machine=machine))
        if running.note:
            self.listen(Warned(stage=running.task.stage, message=running.note))

    def _handle(self, node_id: str, message: Event | NodeStarted | NodeEnded | None) -> None:
        running = self.running[node_id]
        running.silent_s = 0.0
        if isinstance(message, NodeStarted):
            running.started_s, running.counted_s = self._now_s(), 0.0
            self._mark_started(running, message.machine)
        elif isinstance(message, NodeEnded):
            del self.running[node_id]
            is_finished = message.error is None or is_sealed(running.task.folder, running.task.key)
            self._finish(running, NodeEnded() if is_finished else running.given_up or message)
        elif message is not None:
            self.listen(message)

    def _finish(self, running: _Running, ended: NodeEnded) -> None:
        task, error = running.task, ended.error
        if error is not None:
            full = disk_is_full(task.folder)
            if ended.crashed and not full and self.num_tries[running.node.id] < self.retry_policy.max_attempts:
                note = " ".join([running.note, f"{_reason(task, error)} It is tried again from its last checkpoint."]).strip()
                self._start(running.node, task, self._now_s(), note)
                return
            if full or not (running.is_orphan or self.retry_policy.may_fail(running.node, error)):
                raise error
            self.listen(Warned(stage=task.stage, message=_reason(task, error)))
            self.retry_policy.on_given_up(running.node, {*self.times, *self.running})
            self._give_up_below(running.node)
        now_s = self._now_s()
        self.times[running.node.id] = NodeTime(started_s=running.started_s, ended_s=now_s)
        if error is None and running.is_started:
            self.listen(StageDone(stage=task.stage, seconds=now_s - running.started_s))
        if running.node.gang is not None and self._has_ended(running.node):
            self.runner.close_gang(running.node.gang)

    def _give_up_below(self, failed: Tree) -> None:
        """Stop the members of a gang that wait for one that has failed."""
        below = [self.running[node.id] for node in failed if node.gang == failed.gang and node.id in self.running]
        for running in below if failed.gang is not None else ():
            if running.is_orphan:
                continue
            message = f"{running.task.stage}: it was stopped and given up, since {failed.id} failed, with which it ran together."
            ended = NodeEnded(error=StageFailed(message))
            self._give_up(running, ended)
            # Also where it was stopped to be started again.
            running.given_up, running.is_orphan = ended, True

    def _check_deadlines(self) -> None:
        now_s = time.monotonic()
        passed_s, self.checked_s = min(now_s - self.checked_s, MAX_INTERVALS * CHECK_INTERVAL_S), now_s
        for node_id, running in self.running.items():
            running.counted_s += passed_s
            running.silent_s += passed_s
            if running.given_up is not None or not running.is_started:
                continue
            stage, silent_s = running.task.stage, running.silent_s
            if silent_s > SILENT_S:
                message = f"{stage}: its process gave no sign of life for {silent_s:.0f} s and was stopped; run again with --resume."
                self._give_up(running, NodeEnded(error=StageFailed(message), crashed=True))
            elif self.retry_policy.deadlines is not None:
                self._check_deadline(node_id, running, self.retry_policy.deadlines)

    def _check_deadline(self, node_id: str, running: _Running, deadlines: Deadlines) -> None:
        if (reason := deadlines.timeout_reason(node_id, running.counted_s)) is not None:
            error = StageFailed(f"{running.task.stage}: {reason}, and was given up.")
            if self.retry_policy.may_fail(running.node, error):
                self._give_up(running, NodeEnded(error=error))
                return
        if not running.warned and (reason := deadlines.overdue_reason(node_id, running.counted_s)) is not None:
            running.warned = True
            self.listen(Warned(stage=running.task.stage, message=f"{reason}; it continues."))

    def _give_up(self, running: _Running, ended: NodeEnded) -> None:
        if running.given_up is None:
            running.given_up = ended
            self.runner.stop(running.node.id)


def _is_done(task: NodeTask | None) -> bool:
    return task is None or is_sealed(task.folder, task.key)


def _units(tree: Tree) -> list[Unit]:
    """Every node once, the most urgent first; a gang stands where its most urgent member does."""
    units: dict[tuple[str, str], list[Tree]] = {}
    for node in sorted(tree, key=lambda node: URGENCY[node.tier]):
        units.setdefault(("node", node.id) if node.gang is None else ("gang", node.gang), []).append(node)
    return [tuple(unit) for unit in units.values()]


def _reason(task: NodeTask, error: Exception) -> str:
    return str(error).removeprefix(f"{task.stage}: ")
