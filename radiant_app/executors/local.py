"""The local executor: one operating-system process per node, at most `num_workers` at a time. Threads are shared out evenly.

Each process gets max(1, cores // workers) threads: 4 × 2 threads on 4 cores did 52 units of work where 4 × 1 did 79.
Of the nodes that can run, devices come first, since edges and the cloud wait for them; teachers take what is left.
"""

from __future__ import annotations

import os
import queue
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from radiant_app.events import Event, Failed, Listener, StageDone, StageSkipped, StageStarted, Warned, decode
from radiant_app.executors.protocol import NodeTask, NodeTime, Prepare
from radiant_core.aggregate.tree import Tree
from radiant_core.errors import BadInput, StageFailed
from radiant_core.io.run_store import is_sealed

STOP_GRACE_S = 3.0
URGENCY = {"device": 0, "edge": 1, "cloud": 2, "teacher": 3}
"""Order in which nodes that can run are started: that of the longest way to the end. A teacher only shortens its edge."""
FULL_BYTES = 1 << 20
"""With less than this left a disk counts as full: the libraries that write there end their process without a word."""


def worker_command(task: NodeTask) -> list[str]:
    """How a node's process is started."""
    return [sys.executable, "-m", "radiant_app.worker", task.kind, str(task.folder), task.stage, task.key]


@dataclass
class LocalExecutor:
    """Processes on this machine. `clock` gives seconds; injected so that tests decide the time."""

    num_workers: int
    clock: Callable[[], float] = time.monotonic
    command: Callable[[NodeTask], list[str]] = worker_command
    may_fail: Callable[[Tree], bool] = lambda node: False
    """Nodes without which the rest goes on: their failure is a warning."""

    def fold(self, tree: Tree, prepare: Prepare, listen: Listener) -> Mapping[str, NodeTime]:
        """See `Executor.fold`."""
        threads = max(1, (os.cpu_count() or 1) // max(1, min(self.num_workers, _width(tree))))
        return _Fold(executor=self, prepare=prepare, listen=listen, num_threads=threads).run(tree)


def run_task(task: NodeTask, listen: Listener, clock: Callable[[], float] = time.monotonic) -> NodeTime:
    """Run a single task, outside of any tree, with all cores."""
    root = Tree(id=task.stage, tier="cloud")
    return LocalExecutor(num_workers=1, clock=clock).fold(root, lambda node: task, listen)[task.stage]


@dataclass
class _Running:
    node: Tree
    task: NodeTask
    process: subprocess.Popen[str]
    reader: threading.Thread
    started_s: float
    failure: Failed | None = None
    stopped: bool = False
    """Whether it was told to end because nobody needs it any more."""


@dataclass
class _Fold:
    """The state of one fold; lives as long as the call."""

    executor: LocalExecutor
    prepare: Prepare
    listen: Listener
    num_threads: int
    lines: queue.Queue[tuple[str, str | None]] = field(default_factory=queue.Queue)
    running: dict[str, _Running] = field(default_factory=dict)
    times: dict[str, NodeTime] = field(default_factory=dict)
    needless: set[str] = field(default_factory=set)
    """Teachers whose edge has all its devices."""
    origin_s: float = 0.0

    def run(self, tree: Tree) -> Mapping[str, NodeTime]:
        waiting = sorted(tree, key=lambda node: URGENCY[node.tier])
        edges = [node for node in tree if node.tier == "edge"]
        self.origin_s = self.executor.clock()
        try:
            while waiting or self.running:
                while (node := self._next(waiting)) is not None:
                    waiting.remove(node)
                    self._start(node)
                    self._drop_needless(edges)
                if self.running:
                    self._handle(*self.lines.get())
                    self._drop_needless(edges)
        finally:
            with _interrupts_later():
                self._stop_all()
        return self.times

    def _drop_needless(self, edges: list[Tree]) -> None:
        """An edge whose devices are all there takes what its teachers have rendered so far and does the rest itself."""
        for edge in edges:
            if all(device.id in self.times for teacher in edge.children for device in teacher.children):
                self.needless.update(child.id for child in edge.children if child.tier == "teacher")
        for node_id in self.needless & self.running.keys():
            self.running[node_id].stopped = True
            _signal_group(self.running[node_id].process, signal.SIGTERM)

    def _next(self, waiting: list[Tree]) -> Tree | None:
        """The most urgent node that can start now, if a worker is free."""
        if len(self.running) >= self.executor.num_workers:
            return None
        ready = [node for node in waiting if all(child.id in self.times for child in node.children)]
        # What needs no worker must not wait behind what does: an edge waits for it.
        return next((node for node in ready if node.id in self.needless), ready[0] if ready else None)

    def _now_s(self) -> float:
        return self.executor.clock() - self.origin_s

    def _start(self, node: Tree) -> None:
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
        self.listen(StageStarted(stage=task.stage))
        with _interrupts_later():
            process = _spawn(self.executor.command(task), task.folder, self.num_threads)
            reader = threading.Thread(target=self._read, args=(node.id, process), daemon=True)
            self.running[node.id] = _Running(node=node, task=task, process=process, reader=reader, started_s=now_s)
            reader.start()

    def _read(self, node_id: str, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None and process.stdin is not None
        with process.stdin, process.stdout as lines:
            for line in lines:
                self.lines.put((node_id, line))
            process.wait()
        self.lines.put((node_id, None))

    def _handle(self, node_id: str, line: str | None) -> None:
        running = self.running[node_id]
        if line is None:
            del self.running[node_id]
            running.reader.join()
            self._finish(running)
            return
        event: Event = decode(line)
        if isinstance(event, Failed):
            running.failure = event
        else:
            self.listen(event)

    def _finish(self, running: _Running) -> None:
        task, error = running.task, None if running.stopped else _error_of(running)
        if error is not None:
            if not self.executor.may_fail(running.node) or shutil.disk_usage(task.folder).free < FULL_BYTES:
                raise error
            self.listen(Warned(stage=task.stage, message=str(error).removeprefix(f"{task.stage}: ")))
        now_s = self._now_s()
        self.times[running.node.id] = NodeTime(started_s=running.started_s, ended_s=now_s)
        if error is None:
            self.listen(StageDone(stage=task.stage, seconds=now_s - running.started_s))

    def _stop_all(self) -> None:
        for running in self.running.values():
            _signal_group(running.process, signal.SIGTERM)
        for running in self.running.values():
            try:
                running.process.wait(timeout=STOP_GRACE_S)
            except subprocess.TimeoutExpired:
                _signal_group(running.process, signal.SIGKILL)
                running.process.wait()
            running.reader.join()


def _error_of(running: _Running) -> BadInput | StageFailed | None:
    """Why a node whose process has ended is not done; None when it is."""
    task, code = running.task, running.process.returncode
    if running.failure is not None:
        error = BadInput if running.failure.exit_code == BadInput.exit_code else StageFailed
        return error(f"{task.stage}: {running.failure.message}")
    if code == 0 and is_sealed(task.folder, task.key):
        return None
    if shutil.disk_usage(task.folder).free < FULL_BYTES:
        return BadInput(f"{task.stage}: the disk of {task.folder} is full: free space or choose another folder with --out.")
    reason = f"was killed by signal {-code}" if code < 0 else f"ended with code {code}"
    return StageFailed(
        f"{task.stage}: its process {reason} before it was done; see {_log_path(task.folder)}, then run again with --resume."
    )


def _width(tree: Tree) -> int:
    """How many nodes of the tree can run at once at most: its leaves."""
    return max(1, sum(1 for node in tree if not node.children))


def _spawn(command: list[str], folder: Path, num_threads: int) -> subprocess.Popen[str]:
    # Without the last, OpenMP's threads spin after their part and take a core from the rasterizer's.
    environment = {**os.environ, "OMP_NUM_THREADS": str(num_threads), "PYTHONUNBUFFERED": "1", "GOMP_SPINCOUNT": "0"}
    # A session of its own: Ctrl-C reaches only us, and we stop the workers in order.
    with _log_path(folder).open("w") as log:
        return subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=log, stdin=subprocess.PIPE, text=True, env=environment, start_new_session=True
        )


@contextmanager
def _interrupts_later() -> Iterator[None]:
    """Hold Ctrl-C and termination back while a worker is started or stopped: it would outlive the run."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    held: list[int] = []
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGALRM)
    before = {number: signal.signal(number, lambda caught, frame: held.append(caught)) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if held:
            signal.raise_signal(held[0])


def _log_path(folder: Path) -> Path:
    return folder / "log.txt"


def _signal_group(process: subprocess.Popen[str], number: signal.Signals) -> None:
    if process.poll() is None:
        os.killpg(process.pid, number)
