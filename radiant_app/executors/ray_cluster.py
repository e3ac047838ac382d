"""The Ray executor: the same tree folded on a cluster of one owner's machines, a Ray task per node.

This process never imports Ray: it talks to `ray_driver`, a process of its own, in lines of JSON
over pipes. Ray may end the process that is connected to a cluster; then that is the driver, and the
run can say what to do.

    place     a machine started with `--resources '{"device:north-1": 1}'` runs that device,
              `edge:north` that edge, `cloud` the cloud; others run anywhere
    files     the run's folder lies on a file system that all machines see under the same path. A
              node reads its photographs there itself; through Ray go only its command, its events,
              and in the end the hash of its seal, which is compared with the file's
    gangs     nodes that run at the same time have one placement group (`ray_places.py`)
    faults    Ray retries nothing (max_retries 0): what a lost machine leaves unfinished is started
              again by `Fold`, elsewhere if need be, from its last checkpoint. A lock in the node's
              folder keeps a lost process that still lives from writing beside it
"""

from __future__ import annotations

import json
import os
import queue
import secrets
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from radiant_app.events import Event, Failed, Heartbeat, Listener, decode
from radiant_app.executors.cards import needs_card
from radiant_app.executors.fold import Fold, NodeEnded, NodeStarted, RetryPolicy
from radiant_app.executors.local import outcome_of, worker_command
from radiant_app.executors.protocol import NodeTask, NodeTime, Prepare
from radiant_app.interrupts import defer_interrupts
from radiant_core.aggregate.tree import Tree
from radiant_core.errors import BadInput, StageFailed
from radiant_core.extras import require_extra
from radiant_core.io.run_store import SEAL_NAME, file_sha256

SEEN_S = 20.0
"""How long another machine's file may take to appear: network file systems cache directories."""
STOP_S = 15.0
CONNECT_S = 10.0
SECRET_BYTES = 32
LOG_NAME = "ray.log"
DRIVER = "import sys; from radiant_app.executors.ray_driver import main; sys.exit(main(sys.argv[1:]))"
"""Imported by its name, so that Ray's workers import the task and get no copy of it."""


@dataclass(kw_only=True)
class RayExecutor:
    """Nodes as tasks of the Ray cluster at `address`, host:port; "local": one for this fold."""

    address: str
    log: Path
    """File for what Ray itself has to say."""
    clock: Callable[[], float] = time.monotonic
    command: Callable[[NodeTask], list[str]] = worker_command
    retry_policy: RetryPolicy = field(default_factory=RetryPolicy)

    def fold(self, tree: Tree, prepare: Prepare, listen: Listener) -> Mapping[str, NodeTime]:
        """See `Executor.fold`; BadInput where Ray is not installed or no cluster answers."""
        require_cluster(self.address)
        runner = _Cluster(address=self.address, log=self.log, command=self.command, tree=tree)
        fold = Fold(runner=runner, prepare=prepare, listen=listen, clock=self.clock, retry_policy=self.retry_policy)
        with runner:
            return fold.run(tree)


def require_cluster(address: str) -> None:
    """Raise BadInput for a malformed address and without Ray or a cluster; cheap, before a run."""
    require_extra("cluster", "no cluster can be used", "leave out --executor ray")
    if address == "local":
        return
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal() or "://" in address:
        raise BadInput(f"--address {address!r} is no host:port: give that of the cluster's head, 6379 if nothing else was said, or local.")
    try:
        socket.create_connection((host, int(port)), timeout=CONNECT_S).close()
    except (OSError, OverflowError) as error:
        raise BadInput(f"no Ray cluster answers at {address} ({error}): start it by `ray start --head`, or correct --address.") from error


def resource_of(node: Tree) -> str:
    """The resource of a node's machine: a device scores too."""
    parts = node.id.split("/")
    if parts[0] == "cloud" or len(parts) < 2:
        return parts[0]
    return f"{parts[0].removesuffix('s')}:{parts[1]}"


@dataclass(kw_only=True)
class _Cluster:
    """The driver process and the nodes it runs; see `Runner`."""

    address: str
    log: Path
    command: Callable[[NodeTask], list[str]]
    tree: Tree
    messages: queue.Queue[dict[str, Any] | None] = field(default_factory=queue.Queue)
    running: dict[str, NodeTask] = field(default_factory=dict)
    failures: dict[str, Failed] = field(default_factory=dict)
    process: subprocess.Popen[str] | None = None

    def __enter__(self) -> None:
        self.log.parent.mkdir(parents=True, exist_ok=True)
        with defer_interrupts(), self.log.open("a") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-c", DRIVER, self.address],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                env=_environment(self.address),
                start_new_session=True,
            )
        threading.Thread(target=self._read_messages, args=(self.process,), daemon=True).start()
        try:
            answer = self.messages.get()
            if answer is None or "refused" in answer:
                raise BadInput(f"{'' if answer is None else answer['refused']} See {self.log} for what Ray says.".strip())
        except BaseException:
            self.__exit__()
            raise
        leaves = [resource_of(node) for node in self.tree if not node.children]
        self._send(leaves=leaves, edges=[resource_of(node) for node in self.tree if node.tier == "edge"])

    def __exit__(self, *exc_info: object) -> None:
        assert self.process is not None and self.process.stdin is not None and self.process.stdout is not None
        with defer_interrupts():
            with suppress(BrokenPipeError):
                self.process.stdin.close()
            try:
                self.process.wait(timeout=STOP_S)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()

    def has_room(self, num_nodes: int = 1) -> bool:
        """Ray queues tasks that find no free machine."""
        return True

    def open_gang(self, gang: str, members: Sequence[tuple[Tree, NodeTask]]) -> None:
        """Reserve the places of all members at once."""
        devices = [node.id for node, _ in members if node.tier == "device"]
        computing = devices or [node.id for node, _ in members]

        def record(node: Tree, task: NodeTask) -> dict[str, Any]:
            near = next((below.id for below in node if below.id in computing), computing[0])
            return {"node": node.id, "place": resource_of(node), "gpu": needs_card(task), "computes": node.id in computing, "near": near}

        self._send(open=gang, members=[record(node, task) for node, task in members])

    def close_gang(self, gang: str) -> None:
        """Free them."""
        self._send(close=gang)

    def start(self, node: Tree, task: NodeTask) -> bool:
        self.running[node.id] = task
        self.failures.pop(node.id, None)
        record = task.folder / "task.json"
        self._send(
            start=node.id,
            stage=task.stage,
            command=self.command(task),
            folder=str(task.folder.resolve()),
            task_sha256=file_sha256(record) if record.is_file() else None,
            place=resource_of(node),
            gpu=needs_card(task),
            gang=node.gang,
        )
        return False

    def wait(self, timeout_s: float) -> tuple[str, Event | NodeStarted | NodeEnded | None] | None:
        try:
            message = self.messages.get(timeout=timeout_s)
        except queue.Empty:
            return None
        if message is None:
            raise StageFailed(
                f"the connection to the Ray cluster at {self.address} is lost; see {self.log}. What is finished is kept: "
                "start the cluster again if its head is gone, then run again with --resume."
            )
        node_id = message["node"]
        if node_id not in self.running:
            return self.wait(timeout_s)
        if "began" in message:
            return node_id, NodeStarted(machine=message["began"])
        if "line" in message:
            event = decode(message["line"])
            if isinstance(event, Failed):
                self.failures[node_id] = event
            return node_id, None if isinstance(event, Failed | Heartbeat) else event
        task = self.running.pop(node_id)
        if "lost" in message:
            return node_id, NodeEnded(error=StageFailed(f"{task.stage}: {message['lost']} Run again with --resume."), crashed=True)
        _wait_for_seal(task.folder, message["seal_sha256"])
        return node_id, outcome_of(task, self.failures.get(node_id), message["code"])

    def stop(self, node_id: str) -> None:
        self._send(stop=node_id)

    def stop_all(self) -> None:
        for node_id in self.running:
            self._send(stop=node_id)
        deadline_s = time.monotonic() + STOP_S
        with defer_interrupts():
            while self.running and time.monotonic() < deadline_s:
                try:
                    message = self.messages.get(timeout=0.5)
                except queue.Empty:
                    continue
                if message is None:
                    return
                if "began" not in message and "line" not in message:
                    self.running.pop(message["node"], None)

    def _send(self, **message: Any) -> None:
        assert self.process is not None and self.process.stdin is not None
        try:
            self.process.stdin.write(json.dumps(message) + "\n")
            self.process.stdin.flush()
        except BrokenPipeError:
            return  # `wait` reports the lost driver

    def _read_messages(self, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        with process.stdout as lines:
            for line in lines:
                self.messages.put(json.loads(line))
        self.messages.put(None)


def _environment(address: str) -> dict[str, str]:
    """The environment of the driver; a local cluster requires a secret and listens on loopback."""
    if address != "local":
        return dict(os.environ)
    # Else Ray takes the address of the network, even if given 127.0.0.1. Its secret comes from here
    # before it looks for one, or makes one, in ~/.ray.
    secret = {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(SECRET_BYTES)}
    return {**os.environ, "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0", **secret}


def _wait_for_seal(folder: Path, sha256: str | None) -> None:
    """Wait until done.json has the bytes that its writer saw, at most `SEEN_S`."""
    deadline_s = time.monotonic() + SEEN_S
    seal = folder / SEAL_NAME
    while sha256 is not None and time.monotonic() < deadline_s:
        if seal.is_file() and file_sha256(seal) == sha256:
            return
        time.sleep(0.2)
