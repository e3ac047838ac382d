"""Nodes of a run as forks of the run's own process, itself a fork (`run_code.py`): what it has imported is not imported once more."""

from __future__ import annotations

import atexit
import os
import signal
import socket
from typing import Any

from radiant_app.executors import fork_server, local
from radiant_app.executors.fork_server import READY, ForkServer


class _Fork:
    """A process that serves until the other end closes, as far as `ForkServer` asks."""

    def __init__(self, requests: socket.socket, other_end: socket.socket) -> None:
        self.pid = os.fork()
        if not self.pid:
            other_end.close()
            os.setsid()
            fork_server.serve(requests)
        requests.close()

    def kill(self) -> None:
        os.kill(self.pid, signal.SIGKILL)

    def wait(self) -> None:
        os.waitpid(self.pid, 0)


class OwnServer(ForkServer):
    """What this process has imported so far, to be forked; made before it starts threads."""

    def __init__(self) -> None:
        self._asking, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._process: Any = _Fork(theirs, self._asking)
        self.answer = self._asking.recv(len(READY)) == READY


def fork_nodes() -> None:
    """Nodes that this process runs from here on are forks of what it is now."""
    server, own = OwnServer(), os.getpid()
    atexit.register(lambda: server.close() if os.getpid() == own else None)
    for name in ("open_server", "start_server"):
        setattr(local, name, lambda names, environment: server)
