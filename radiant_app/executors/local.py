"""The local executor: a process per node, `num_workers` at a time, with equal numbers of threads.

Each process gets max(1, cores // workers) threads unless another number is asked for: 4 × 2 threads
on 4 cores did 52 units of work where 4 × 1 did 79. Where there are several nodes, processes are
forks of one that has imported their libraries (`fork_server.py`).

A gang starts where all its members fit in, or where nothing else runs: by itself it may exceed
`num_workers`, since its processes mostly wait for each other. Its processes divide the cores among
its devices and what may run beside them.

Of several CUDA devices each process sees one, that which the fewest others use.
"""

from __future__ import annotations

import contextlib
import errno
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from radiant_app.events import Event, Failed, Heartbeat, Listener, decode
from radiant_app.executors.cards import VISIBLE, choose_card, needs_card, visible_cards
from radiant_app.executors.fold import Fold, NodeEnded, RetryPolicy
from radiant_app.executors.fork_server import ForkedProcess, ForkServer, open_server, start_server
from radiant_app.executors.protocol import NodeTask, NodeTime, Prepare
from radiant_app.executors.sessions import signal_session
from radiant_app.interrupts import defer_interrupts
from radiant_app.workers.memory import EDGES_AT_ONCE
from radiant_core.aggregate.tree import Tree
from radiant_core.errors import BadInput, CannotWrite, StageFailed
from radiant_core.io.run_store import disk_is_full, is_sealed

STOP_GRACE_S = 3.0
LEAST_FORKED = 2
"""Nodes of a tree from where on their processes are forks."""
IMPORTED = (
    "radiant_app.workers.nodes",
    "radiant_app.workers.inbox",
    "radiant_app.workers.refining",
    "radiant_core.hierarchy.cloud",
    "radiant_core.hierarchy.edge",
    "radiant_core.hierarchy.refine",
    "radiant_core.train.photographs",
)
"""What nearly all nodes of a tree import."""


_REMEDIES = {
    errno.E2BIG: "unset variables that are large",
    errno.EAGAIN: "end other processes, or raise their limit (ulimit -u)",
    errno.EMFILE: "raise the limit of open files (ulimit -n)",
    errno.ENFILE: "end other processes: the system has too many files open",
    errno.ENOMEM: "free memory",
}
"""What to do where the system starts no process."""

Process = subprocess.Popen[str] | ForkedProcess


def worker_command(task: NodeTask) -> list[str]:
    """Return the command that starts a node's process."""
    return [sys.executable, "-m", task.module, task.kind, str(task.folder), task.stage, task.key]


@dataclass
class LocalExecutor:
    """Runs nodes as processes on this machine. `clock` returns seconds; tests inject their own."""

    num_workers: int
    clock: Callable[[], float] = time.monotonic
    command: Callable[[NodeTask], list[str]] = worker_command
    retry_policy: RetryPolicy = field(default_factory=RetryPolicy)
    num_threads: int | None = None
    """Of each process; None: its share of the cores."""
    variables: Callable[[NodeTask], Mapping[str, str]] = lambda task: {}
    """More variables of a node's process."""

    def begin(self) -> None:
        """Load the libraries of folds to come in the background."""
        if self.command is worker_command:
            start_server(IMPORTED, worker_environment(self.num_threads or 1))

    def fold(self, tree: Tree, prepare: Prepare, listen: Listener) -> Mapping[str, NodeTime]:
        """See `Executor.fold`."""
        width = max(1, sum(1 for node in tree if not node.children))
        threads = self.num_threads or max(1, (os.cpu_count() or 1) // max(1, min(self.num_workers, width)))
        runner = Processes(
            num_workers=self.num_workers,
            command=self.command,
            num_threads=threads,
            gang_threads={} if self.num_threads else _gang_threads(tree, self.num_workers),
            edges_at_once=_edges_at_once(tree, self.num_workers),
            variables=self.variables,
        )
        if self.command is worker_command and sum(1 for _ in tree) >= LEAST_FORKED:
            runner.server = partial(open_server, IMPORTED, worker_environment(threads))
        fold = Fold(runner=runner, prepare=prepare, listen=listen, clock=self.clock, retry_policy=self.retry_policy)
        return fold.run(tree)


def _gang_threads(tree: Tree, num_workers: int) -> dict[str | None, int]:
    """Threads of each process of a gang: max(1, cores // D), D its devices and those beside it."""
    cores, threads = os.cpu_count() or 1, dict[str | None, int]()
    for gang in {node.gang for node in tree} - {None}:
        members = [node for node in tree if node.gang == gang]
        devices = sum(node.tier == "device" for node in members) or len(members)
        others = sum(not node.children and node.gang != gang for node in tree)
        threads[gang] = max(1, cores // (devices + min(others, max(0, num_workers - len(members)))))
    return threads


def _edges_at_once(tree: Tree, num_workers: int) -> int:
    """The most edges that may run at once: as many as workers, or all of a gang."""
    gangs = [node.gang for node in tree if node.tier == "edge"]
    return max([min(num_workers, len(gangs)), *(gangs.count(gang) for gang in gangs if gang is not None)])


def run_task(task: NodeTask, listen: Listener, clock: Callable[[], float] = time.monotonic) -> NodeTime:
    """Run a single task outside any tree, with all cores."""
    root = Tree(id=task.stage, tier="cloud")
    return LocalExecutor(num_workers=1, clock=clock).fold(root, lambda node: task, listen)[task.stage]


@dataclass
class _Running:
    task: NodeTask
    process: Process
    reader: threading.Thread
    card: str | None
    """CUDA device that it sees, of several."""
    failure: Failed | None = None


@dataclass(kw_only=True)
class Processes:
    """The worker processes of one fold; see `Runner`."""

    num_workers: int
    command: Callable[[NodeTask], list[str]]
    num_threads: int
    gang_threads: Mapping[str | None, int] = field(default_factory=dict)
    """Gang → threads of its processes, where it has other ones."""
    edges_at_once: int = 1
    """Edges that may join side by side, which divide what memory is free."""
    server: Callable[[], ForkServer | None] = lambda: None
    """Opens what forks processes once one is to start; None: they start anew."""
    variables: Callable[[NodeTask], Mapping[str, str]] = lambda task: {}
    """As of `LocalExecutor`."""
    lines: queue.Queue[tuple[str, str | None]] = field(default_factory=queue.Queue)
    running: dict[str, _Running] = field(default_factory=dict)

    def has_room(self, num_nodes: int = 1) -> bool:
        return not self.running or len(self.running) + num_nodes <= self.num_workers

    def open_gang(self, gang: str, members: Sequence[tuple[Tree, NodeTask]]) -> None:
        """Nothing: processes of one machine need no places."""

    def close_gang(self, gang: str) -> None:
        """Nothing, as `open_gang`."""

    def start(self, node: Tree, task: NodeTask) -> bool:
        # It may still be importing, which an interrupt need not wait for.
        server = self.server()
        card = choose_card(visible_cards(os.environ), [one.card for one in self.running.values()]) if needs_card(task) else None
        with defer_interrupts():
            process = self._spawn(node, task, server, card)
            reader = threading.Thread(target=self._read_lines, args=(node.id, process), daemon=True)
            self.running[node.id] = _Running(task=task, process=process, reader=reader, card=card)
            reader.start()
        return True

    def wait(self, timeout_s: float) -> tuple[str, Event | NodeEnded | None] | None:
        try:
            node_id, line = self.lines.get(timeout=timeout_s)
        except queue.Empty:
            return None
        if line is not None:
            event = decode(line)
            if isinstance(event, Failed):
                self.running[node_id].failure = event
            return node_id, None if isinstance(event, Failed | Heartbeat) else event
        running = self.running.pop(node_id)
        running.reader.join()
        return node_id, outcome_of(running.task, running.failure, running.process.wait())

    def stop(self, node_id: str) -> None:
        _signal_group(self.running[node_id].process, signal.SIGTERM)
        killer = threading.Timer(STOP_GRACE_S, _signal_group, (self.running[node_id].process, signal.SIGKILL))
        killer.daemon = True
        killer.start()

    def stop_all(self) -> None:
        with defer_interrupts():
            for running in self.running.values():
                _signal_group(running.process, signal.SIGTERM)
            for running in self.running.values():
                try:
                    running.process.wait(timeout=STOP_GRACE_S)
                except subprocess.TimeoutExpired:
                    _signal_group(running.process, signal.SIGKILL)
                    running.process.wait()
                running.reader.join()

    def _spawn(self, node: Tree, task: NodeTask, server: ForkServer | None, card: str | None) -> Process:
        threads = self.gang_threads.get(node.gang, self.num_threads)
        command = self.command(task)
        environment = {**worker_environment(threads, self.edges_at_once), **self.variables(task)}
        if card is not None:
            environment[VISIBLE] = card
        with log_path(task.folder).open("w") as log:
            if server is not None and command[:2] == [sys.executable, "-m"]:
                # It may have been killed.
                with contextlib.suppress(OSError):
                    return server.start_piped(command[2:], log, environment)
            # A session of its own: Ctrl-C reaches only this process, which stops workers in order.
            pipe, start = subprocess.PIPE, subprocess.Popen
            try:
                return start(command, stdout=pipe, stderr=log, stdin=pipe, text=True, env=environment, start_new_session=True)
            except OSError as error:
                raise StageFailed(_why_not_started(task, error)) from error

    def _read_lines(self, node_id: str, process: Process) -> None:
        assert process.stdout is not None and process.stdin is not None
        with process.stdin, process.stdout as lines:
            for line in lines:
                self.lines.put((node_id, line))
            process.wait()
        self.lines.put((node_id, None))


def _why_not_started(task: NodeTask, error: OSError) -> str:
    remedy = _REMEDIES.get(error.errno or 0, "check that its Python is there and may be run")
    return f"{task.stage}: its process cannot be started ({error.strerror}): {remedy}, then run again with --resume."


def outcome_of(task: NodeTask, failure: Failed | None, code: int) -> NodeEnded:
    """How a node ended whose process reported `failure` and exited with `code` (−N: signal N)."""
    if failure is not None and failure.cannot_write:
        return NodeEnded(error=CannotWrite(f"{task.stage}: {failure.message}"))
    if failure is not None:
        error = BadInput if failure.exit_code == BadInput.exit_code else StageFailed
        return NodeEnded(error=error(f"{task.stage}: {failure.message}"))
    if code == 0 and is_sealed(task.folder, task.key):
        return NodeEnded()
    if disk_is_full(task.folder):
        return NodeEnded(
            error=CannotWrite(f"{task.stage}: the disk of {task.folder} is full: free space or choose another folder with --out.")
        )
    reason = f"was killed by signal {-code}" if code < 0 else f"ended with code {code}"
    if code == -signal.SIGKILL:
        reason += " (as systems do where memory runs out)"
    message = f"{task.stage}: its process {reason} before it was done; see {log_path(task.folder)}, then run again with --resume."
    return NodeEnded(error=StageFailed(message), crashed=True)


def worker_environment(num_threads: int, edges_at_once: int = 1) -> dict[str, str]:
    """The variables of a worker; edges that join side by side on its machine share its memory."""
    # Without the last, OpenMP's threads spin after their part and take a core of the rasterizer's.
    thread_variables = {"OMP_NUM_THREADS": str(num_threads), EDGES_AT_ONCE: str(max(1, edges_at_once))}
    return {**os.environ, **thread_variables, "PYTHONUNBUFFERED": "1", "GOMP_SPINCOUNT": "0"}


def log_path(folder: Path) -> Path:
    """The file for all output of a node's process that is no event."""
    return folder / "log.txt"


def _signal_group(process: Process, number: signal.Signals) -> None:
    if process.poll() is None:
        signal_session(process.pid, number)
