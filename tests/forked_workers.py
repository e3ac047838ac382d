"""Worker processes as forks of one that has imported everything: what they compute is a worker's,
without the seconds of its imports.

An executor starts CLIENT for each node. It hands its standard streams to the server, whose fork
runs the worker's own `main`, and ends with the fork's exit code; the fork ends with it.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

from radiant_app.executors.protocol import NodeTask

IMPORTED = (
    "radiant_app.workers.nodes",
    "radiant_app.workers.inbox",
    "radiant_core.hierarchy.edge",
    "radiant_core.hierarchy.cloud",
    "radiant_core.train.photographs",
)
ROOT = Path(__file__).parents[1]
WORKER = "radiant_app.workers.worker"
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


@contextmanager
def forked_workers(folder: Path, module: str = WORKER) -> Iterator[Callable[[NodeTask], list[str]]]:
    """The `command` of executors whose nodes run as forks, and the server behind it until the end of
    the block. `module` has the `main` that runs a node."""
    address = folder / "workers"
    server = subprocess.Popen([sys.executable, "-m", __spec__.name, str(address), module], cwd=ROOT, stdout=subprocess.PIPE)
    try:
        assert server.stdout is not None and server.stdout.readline() == b"ready\n"
        yield lambda task: client_command(address, task)
    finally:
        server.kill()
        server.communicate()


def client_command(address: Path, task: NodeTask) -> list[str]:
    """What starts a node at the server that listens at this address."""
    return [sys.executable, "-S", "-c", CLIENT, str(address), task.kind, str(task.folder.resolve()), task.stage, task.key]


def serve(address: str, module: str) -> None:
    """Fork a worker for every client that connects."""
    import torch

    main = import_module(module).main
    for name in IMPORTED:
        import_module(name)

    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(address)
        listener.listen()
        print("ready", flush=True)
        while True:
            client, _ = listener.accept()
            if os.fork():
                client.close()
                continue
            listener.close()
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            record, streams, _, _ = socket.recv_fds(client, 1 << 16, 3)
            for number, stream in enumerate(streams):
                os.dup2(stream, number)
            told, *arguments = json.loads(record)
            os.environ.update(told)
            torch.set_num_threads(int(told["OMP_NUM_THREADS"]))
            threading.Thread(target=_end_with, args=(client,), daemon=True).start()
            client.send(str(main(arguments)).encode())
            os._exit(0)


def _end_with(client: socket.socket) -> None:
    client.recv(1)
    os._exit(1)


if __name__ == "__main__":
    serve(*sys.argv[1:])
