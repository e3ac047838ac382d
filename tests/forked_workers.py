"""Worker processes as forks of one that has imported everything: what they compute is a worker's,
without the seconds of its imports.

An executor starts CLIENT for each node. It hands its standard streams to the server, whose fork
runs the worker's own `main`, and ends with the fork's exit code; the fork ends with it. All tests
of a process share a server for each set of imports.
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import json
import os
import select
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module
from pathlib import Path

from radiant_app.executors.protocol import NodeTask

WORKER = "radiant_app.workers.worker"
IMPORTED = (
    "torch",
    WORKER,
    "radiant_app.workers.nodes",
    "radiant_app.workers.inbox",
    "radiant_core.hierarchy.edge",
    "radiant_core.hierarchy.cloud",
    "radiant_core.train.photographs",
)
ROOT = Path(__file__).parents[1]
TOLD = ("OMP_NUM_THREADS", "RADIANT_")
"""How the variables begin that a worker gets from its client; the others are the server's."""
CLIENT = f"""
import json, os, socket, sys
told = {{name: value for name, value in os.environ.items() if name.startswith({TOLD})}}
with socket.socket(socket.AF_UNIX) as server:
    server.connect(sys.argv[1])
    socket.send_fds(server, [json.dumps([told, *sys.argv[2:]]).encode()], [0, 1, 2])
    sys.exit(int(server.recv(8) or 1))
"""
_environment, _PLACE = dict(os.environ), tempfile.gettempdir()


@contextlib.contextmanager
def forked_workers(folder: Path, module: str = WORKER) -> Iterator[Callable[[NodeTask], list[str]]]:
    """The `command` of executors whose nodes run as forks; the address of their server is `folder`/workers.
    `module` has the `main` that runs a node."""
    address = folder / "workers"
    address.symlink_to(server_address(IMPORTED))
    yield lambda task: client_command(address, task, module)


def client_command(address: Path, task: NodeTask, module: str = WORKER) -> list[str]:
    """What starts a node at the server that listens at this address."""
    return client(address, module, task.kind, str(task.folder.resolve()), task.stage, task.key)


def client(address: Path, module: str, *arguments: str) -> list[str]:
    """What has a fork of that server call `main` of a module."""
    return [sys.executable, "-S", "-c", CLIENT, str(address), module, *arguments]


@cache
def server_address(names: tuple[str, ...]) -> Path:
    """Where a server listens that has imported `names`; it ends with this process."""
    folder = Path(tempfile.mkdtemp(prefix="workers-", dir=_PLACE))
    command = [sys.executable, "-m", __spec__.name, str(folder / "socket"), *names]
    server = subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=_environment)

    def end() -> None:
        server.kill()
        server.communicate()
        shutil.rmtree(folder, ignore_errors=True)

    atexit.register(end)
    assert server.stdout is not None and server.stdout.readline() == b"ready\n"
    return folder / "socket"


def serve(address: str, *names: str) -> None:
    """Fork a worker for every client that connects."""
    for name in names:
        import_module(name)
    # Forks neither look through what was imported nor copy it.
    gc.freeze()

    # Waited for rather than ignored: their CPU time is this server's then, and so a test's.
    signal.signal(signal.SIGCHLD, lambda number, frame: _collect_ended())
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(address)
        listener.listen()
        print("ready", flush=True)
        while True:
            # Standard input ends with the process that started this one.
            if sys.stdin in select.select([listener, sys.stdin], [], [])[0]:
                os._exit(0)
            client, _ = listener.accept()
            if os.fork():
                client.close()
                continue
            listener.close()
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            record, streams, _, _ = socket.recv_fds(client, 1 << 16, 3)
            for number, stream in enumerate(streams):
                os.dup2(stream, number)
            told, module, *arguments = json.loads(record)
            os.environ.update(told)
            if "torch" in sys.modules and "OMP_NUM_THREADS" in told:
                sys.modules["torch"].set_num_threads(int(told["OMP_NUM_THREADS"]))
            threading.Thread(target=_end_with, args=(client,), daemon=True).start()
            client.send(str(import_module(module).main(arguments)).encode())
            os._exit(0)


def _collect_ended() -> None:
    with contextlib.suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass


def _end_with(client: socket.socket) -> None:
    client.recv(1)
    os._exit(1)


if __name__ == "__main__":
    serve(*sys.argv[1:])
