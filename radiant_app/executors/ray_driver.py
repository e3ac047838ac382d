"""The process connected to a Ray cluster, started by `RayExecutor`: submits tasks, forwards output.

    in    {"leaves": [place…], "edges": [place…]} once, {"start": node, command, folder…},
          {"stop": node}; {"open": gang, "members": [{"node", "place", "gpu", "computes",
          "near"}…]} before those are started, {"close": gang} when all have ended; ends with it
    out   {"ready": …} or {"refused": why} once, then {"node", "began" | "line" | "lost" | "code"}

A task is a generator: its first item says where it runs, then come the lines of the node's worker
process, of which one comes every few seconds at least, and its code with the hash of its seal. It
reserves `num_cpus` of its machine and gives its process as many threads. A member of a gang takes
its part of the gang's placement group (`ray_places.Gang`).
"""

from __future__ import annotations

import fcntl
import json
import os
import queue
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

# Before Ray is imported: it sends usage statistics by default.
os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
# A task without a GPU must not change its process's environment; else Ray warns at every start.
os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")

import ray
from ray.exceptions import RayError

from radiant_app.events import Failed, encode
from radiant_app.executors.local import worker_environment
from radiant_app.executors.ray_places import PLACE_SHARE, Gang, find_machines, have_gpus, living_machines, num_at, num_threads, offers
from radiant_core.errors import RadiantError, StageFailed
from radiant_core.io.run_store import SEAL_NAME, file_sha256

CHECK_INTERVAL_S = 2.0
"""Interval at which it is checked whether a machine is left for each waiting task."""
GONE_S = 20.0
"""A waiting task is lost if no machine can run it for this long: a restarted one rejoins sooner."""
LOCK_S = 120.0
"""How long a task waits for an earlier process: a machine without a head stops in a minute."""
SEEN_S = 20.0
LOCAL_STORE_BYTES = 100 * 2**20
"""Ray's least object store is 75 MB; no model ever lies in it."""
LOCK_NAME = ".worker"
_OUT = sys.stdout
"""The stream of messages."""


@dataclass
class _Task:
    message: dict[str, Any]
    items: Any
    began: bool = False
    gang: Gang | None = None
    """The gang in whose group it waits or runs."""
    unplaceable_since_s: float | None = None

    def wanted(self) -> dict[str, float]:
        """What it takes of one machine."""
        return {"CPU": self.message["cpus"], "GPU": self.message["gpus"], **self.message["resources"]}


@dataclass
class _Driver:
    commands: queue.Queue[dict[str, Any] | None] = field(default_factory=queue.Queue)
    tasks: dict[str, _Task] = field(default_factory=dict)
    leaves: Sequence[str] = ()
    edges: Sequence[str] = ()
    gangs: dict[str, Gang] = field(default_factory=dict)
    checked_s: float = 0.0

    def run(self) -> None:
        """Serve until the input ends; then cancel all running tasks."""
        threading.Thread(target=self._read_commands, daemon=True).start()
        while True:
            try:
                command = self.commands.get(block=not self.tasks)
            except queue.Empty:
                self._forward_items()
                continue
            if command is None:
                break
            self._execute(command)
        for task in self.tasks.values():
            ray.cancel(task.items, force=True)

    def _read_commands(self) -> None:
        for line in sys.stdin:
            self.commands.put(json.loads(line))
        self.commands.put(None)

    def _execute(self, command: dict[str, Any]) -> None:
        if "leaves" in command:
            self.leaves, self.edges = command["leaves"], command["edges"]
        elif "open" in command:
            self.gangs[command["open"]] = Gang.open(command["members"], self.leaves)
        elif "close" in command:
            self.gangs.pop(command["close"]).close()
        elif "start" in command:
            self._start(command)
        elif command["stop"] in self.tasks:
            ray.cancel(self.tasks[command["stop"]].items, force=True)

    def _start(self, message: dict[str, Any]) -> None:
        fit = find_machines(message["place"], message["gpu"])
        if not fit:
            kind = "a GPU and a free CPU" if message["gpu"] else "a CPU"
            _send(node=message["start"], lost=f"no living machine of the cluster has {kind}.")
            return
        node, threads = message["start"], num_threads(fit, self.leaves)
        pinned = message["place"] in fit[0]["Resources"]
        num_gpus = int(message["gpu"] and bool(have_gpus(fit)))
        message |= {"cpus": threads, "gpus": num_gpus, "resources": {message["place"]: PLACE_SHARE} if pinned else {}}
        gang, options = self.gangs.get(message["gang"]), dict[str, Any]()
        if gang is not None:
            amounts, options = gang.place(node)
            message |= amounts
        task = _run_node.options(num_cpus=message["cpus"], num_gpus=message["gpus"], resources=message["resources"], **options)
        at_once = min(num_at(fit, self.edges), max(int(machine["Resources"]["CPU"]) // threads for machine in fit))
        items = task.remote(message["command"], message["folder"], message["stage"], message["task_sha256"], threads, at_once)
        self.tasks[node] = _Task(message=message, items=items, gang=gang if options else None)

    def _forward_items(self) -> None:
        ready, _ = ray.wait([task.items for task in self.tasks.values()], timeout=0.1)
        for node in [node for node, task in self.tasks.items() if any(task.items is items for items in ready)]:
            task = self.tasks[node]
            try:
                item: Any = ray.get(next(task.items))
            except (StopIteration, RayError) as error:
                del self.tasks[node]
                _send(node=node, lost=f"its machine or Ray's worker is gone ({type(error).__name__}).")
                continue
            task.began = True
            if task.gang is not None:
                task.gang.began = True
            _send(node=node, **item)
            if "code" in item:
                del self.tasks[node]
        if time.monotonic() - self.checked_s > CHECK_INTERVAL_S:
            self.checked_s = time.monotonic()
            self._drop_unplaceable()

    def _drop_unplaceable(self) -> None:
        waiting = {node: task for node, task in self.tasks.items() if not task.began}
        machines = living_machines() if waiting else []
        for node, task in waiting.items():
            if node not in self.tasks:
                continue
            if task.gang is not None and task.gang.is_gone(node):
                # Its gang waits for it, so it does not wait until Ray has another machine for it.
                ray.cancel(task.items, force=True)
                del self.tasks[node]
                self._start(task.message)
            elif any(offers(machine, task.wanted()) for machine in machines):
                task.unplaceable_since_s = None
            elif task.unplaceable_since_s is None:
                task.unplaceable_since_s = time.monotonic()
            elif time.monotonic() - task.unplaceable_since_s > GONE_S:
                self._drop(node, task)

    def _drop(self, node: str, task: _Task) -> None:
        """Report a waiting task as lost, and with it all members that wait for the same group: it
        will never be placed, and each is started again without it."""
        dropped = {node: task}
        if task.gang is not None and not task.gang.began:
            task.gang.close()
            dropped = {name: waiting for name, waiting in self.tasks.items() if waiting.gang is task.gang}
        for name, waiting in dropped.items():
            ray.cancel(waiting.items, force=True)
            del self.tasks[name]
            _send(node=name, lost="the machine that it waited for is gone.")


@ray.remote(max_retries=0, num_returns="streaming")
def _run_node(
    command: list[str], folder: str, stage: str, task_sha256: str | None, threads: int, edges_at_once: int
) -> Iterator[dict[str, Any]]:
    """On the node's machine: run its worker process, yield its lines, then its code and seal."""
    yield {"began": socket.gethostname()}
    place = Path(folder)
    try:
        _require_same_files(place, task_sha256)
        lock = _lock_folder(place)
    except (RadiantError, OSError) as error:
        yield {"line": encode(Failed(stage=stage, message=str(error), exit_code=StageFailed.exit_code))}
        yield {"code": StageFailed.exit_code, "seal_sha256": None}
        return
    environment = worker_environment(threads, edges_at_once)
    # The first word is the Python of the machine that started the run. The child keeps the lock
    # while it lives, even without this process, and ends when its standard input closes.
    with (place / "log.txt").open("w") as log:
        process = subprocess.Popen(
            [sys.executable, *command[1:]],
            stdout=subprocess.PIPE,
            stdin=subprocess.PIPE,
            stderr=log,
            text=True,
            env=environment,
            pass_fds=[lock],
            start_new_session=True,
        )
    os.close(lock)
    assert process.stdout is not None
    for line in process.stdout:
        yield {"line": line}
    code, seal = process.wait(), place / SEAL_NAME
    yield {"code": code, "seal_sha256": file_sha256(seal) if code == 0 and seal.is_file() else None}


def _require_same_files(folder: Path, task_sha256: str | None) -> None:
    """Raise StageFailed unless this machine sees the folder, and in it the task that was dealt."""
    deadline_s = time.monotonic() + SEEN_S
    while True:
        record = folder / "task.json"
        if folder.is_dir() and (task_sha256 is None or (record.is_file() and file_sha256(record) == task_sha256)):
            return
        if time.monotonic() > deadline_s:
            raise StageFailed(
                f"the machine {socket.gethostname()} does not see {folder} as the machine that started the run does: put the run on a "
                "file system that all machines share, under the same path."
            )
        time.sleep(0.5)


def _lock_folder(folder: Path) -> int:
    """A file descriptor that holds the lock of a folder; StageFailed if that stays taken."""
    descriptor = os.open(folder / LOCK_NAME, os.O_RDWR | os.O_CREAT, 0o644)
    deadline_s = time.monotonic() + LOCK_S
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > deadline_s:
                os.close(descriptor)
                raise StageFailed(f"another process has been working in {folder} for {LOCK_S:.0f} s: end it.") from None
            time.sleep(0.2)
        else:
            os.set_inheritable(descriptor, True)
            return descriptor


def _connect(address: str, temporary: Path) -> str | None:
    """Connect to the cluster, a local one with its files in `temporary`; why not, or None."""
    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
    if address == "local":
        sizes: dict[str, Any] = {"include_dashboard": False, "object_store_memory": LOCAL_STORE_BYTES}
        ray.init(address="local", _temp_dir=str(temporary), **sizes, **quiet)
        return None
    try:
        ray.init(address=address, **quiet)
    except (ConnectionError, RuntimeError, ValueError, RayError) as error:
        first = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        return f"this machine cannot join the Ray cluster at {address} ({first}): run `ray start --address {address}` here too."
    return None


def _send(**message: Any) -> None:
    _OUT.write(json.dumps(message) + "\n")


def main(arguments: list[str]) -> int:
    """Serve one fold."""
    global _OUT  # noqa: PLW0603 - the process has one
    # Ray prints to standard output too: the messages keep the real one.
    _OUT = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    # The paths of sockets are limited to 107 bytes: $TMPDIR may be longer by itself.
    with tempfile.TemporaryDirectory(prefix="ray-", dir="/tmp", ignore_cleanup_errors=True) as temporary:
        refused = _connect(arguments[0], Path(temporary))
        if refused is not None:
            _send(refused=refused)
            return 2
        _send(ready=True)
        _Driver().run()
        ray.shutdown()
    return 0
