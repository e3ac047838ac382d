"""Python processes forked from one that has loaded their libraries. Once per node of a run.

A worker spends some 3 s of CPU time on imports before its work begins, in a small run more than on
the work: `sample_scenes/make_runs.py` (12 photographs, 30 nodes) took 59 s of CPU time in place of
132, and made the same bytes. A server imports them once; each `python -m MODULE ARGUMENTS` that is
asked of it is a fork with a session, streams, an environment and a working folder of its own, which
receives signals and is waited for like any process. There is a server for each set of the variables
that libraries read when they are loaded. It ends with the process that started it, or when it is
not asked for some time.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import IO, Any

READ_WHEN_LOADED = ("GOMP_SPINCOUNT", "LD_PRELOAD", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "PYTHONPATH")
"""Variables that a library or the interpreter reads once."""
IDLE_S = 60.0
MAX_REQUEST_BYTES = 1 << 18
CAN_FORK = sys.platform == "linux"
"""Libraries of macOS break in a fork; Windows has none."""


class ForkedProcess:
    """What a server forked, as far as `subprocess.Popen` is needed here."""

    def __init__(self, ended: int) -> None:
        self._ended = ended
        self._waiting = threading.Lock()
        self.returncode: int | None = None
        self.stdin: IO[str] | None = None
        self.stdout: IO[str] | None = None
        if not (told := self._line()):
            os.close(ended)
            raise ConnectionError("the server of processes has ended")
        self.pid = int(told)

    def poll(self) -> int | None:
        """The exit code, below 0 for a signal, or None while the process runs."""
        return self._waited(0)

    def wait(self, timeout: float | None = None) -> int:
        """The exit code; TimeoutExpired after `timeout` seconds."""
        code = self._waited(timeout)
        if code is None:
            raise subprocess.TimeoutExpired("a forked process", timeout or 0)
        return code

    def _waited(self, timeout_s: float | None) -> int | None:
        # An executor waits in a thread of its own and, when it stops, in the main one.
        if self._waiting.acquire(timeout=-1 if timeout_s is None else timeout_s):
            try:
                if self.returncode is None and select.select([self._ended], [], [], timeout_s)[0]:
                    self.returncode = int(self._line() or self._orphaned())
                    os.close(self._ended)
            finally:
                self._waiting.release()
        return self.returncode

    def _orphaned(self) -> int:
        """End a process whose server is gone, so that nobody will tell how it ended."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        return -signal.SIGKILL

    def _line(self) -> bytes:
        line = b""
        while not line.endswith(b"\n") and (byte := os.read(self._ended, 1)):
            line += byte
        return line


class ForkServer:
    """A server that has imported `names`, in an environment and with its variables."""

    def __init__(self, names: Sequence[str], environment: Mapping[str, str], idle_s: float = IDLE_S) -> None:
        self._asking, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        command = [sys.executable, "-m", __spec__.name, str(theirs.fileno()), str(idle_s), *names]
        variables = {**environment, "PYTHONUNBUFFERED": "1"}
        # Where a name cannot be imported it ends, and whoever asked starts processes anew.
        self._process = subprocess.Popen(
            command, pass_fds=[theirs.fileno()], env=variables, stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
        )
        theirs.close()
        atexit.register(self.close)

    def start(self, command: Sequence[str], fds: Sequence[int], environment: Mapping[str, str], cwd: Path | None = None) -> ForkedProcess:
        """Fork `python -m COMMAND` with three streams; ConnectionError if the server has ended."""
        ended, tell = os.pipe()
        request = {"command": [*command], "environment": {**environment}, "cwd": str(cwd or Path.cwd())}
        try:
            socket.send_fds(self._asking, [json.dumps(request).encode()], [*fds, tell])
        except ConnectionError:
            os.close(ended)
            raise
        finally:
            os.close(tell)
        return ForkedProcess(ended)

    def close(self) -> None:
        """End the server and wait for it: its CPU time, and that of its forks, is the caller's."""
        atexit.unregister(self.close)
        self._asking.close()
        self._process.wait()


_servers: dict[tuple[object, ...], ForkServer] = {}
_starting = threading.Lock()


def fork_module(
    command: Sequence[str], log: IO[str], environment: Mapping[str, str], names: Sequence[str], idle_s: float = IDLE_S
) -> ForkedProcess:
    """`python -m COMMAND` with pipes as standard input and output and `log` for errors, forked by a
    server that has imported `names`; OSError where none can be had."""
    stdin, to_stdin = os.pipe()
    from_stdout, stdout = os.pipe()
    try:
        process = fork_with_streams(command, (stdin, stdout, log.fileno()), environment, names, idle_s)
    except BaseException:
        os.close(to_stdin)
        os.close(from_stdout)
        raise
    finally:
        os.close(stdin)
        os.close(stdout)
    process.stdin, process.stdout = os.fdopen(to_stdin, "w"), os.fdopen(from_stdout)
    return process


def fork_with_streams(
    command: Sequence[str],
    fds: Sequence[int],
    environment: Mapping[str, str],
    names: Sequence[str],
    idle_s: float = IDLE_S,
    cwd: Path | None = None,
) -> ForkedProcess:
    """The same with given streams."""
    key = (*names, *((name, environment.get(name)) for name in READ_WHEN_LOADED))
    with _starting:
        if (server := _servers.get(key)) is not None:
            try:
                return server.start(command, fds, environment, cwd)
            except ConnectionError:
                _servers.pop(key).close()
        server = _servers[key] = ForkServer(names, environment, idle_s)
        return server.start(command, fds, environment, cwd)


def serve(requests: socket.socket, idle_s: float) -> None:
    """Fork a process for each request and tell how it ended, until the other end closes."""
    woken, wake = os.pipe()
    for end in (woken, wake):
        os.set_blocking(end, False)
    signal.signal(signal.SIGCHLD, lambda number, frame: None)
    signal.set_wakeup_fd(wake)
    telling: dict[int, int] = {}
    while True:
        ready = select.select([requests, woken], [], [], None if telling else idle_s)[0]
        if not ready:
            return
        if woken in ready:
            os.read(woken, 4096)
            _tell_ended(telling)
        if requests not in ready:
            continue
        request, fds, _, _ = socket.recv_fds(requests, MAX_REQUEST_BYTES, 4)
        if not request:
            return
        if not (process := os.fork()):
            signal.set_wakeup_fd(-1)
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            requests.close()
            for fd in (woken, wake, *telling.values()):
                os.close(fd)
            _run(json.loads(request), fds)
            return
        telling[process] = fds[3]
        for fd in fds[:3]:
            os.close(fd)


def _tell_ended(telling: dict[int, int]) -> None:
    while telling:
        process, status = os.waitpid(-1, os.WNOHANG)
        if not process:
            return
        tell = telling.pop(process)
        with contextlib.suppress(BrokenPipeError):
            os.write(tell, f"{os.waitstatus_to_exitcode(status)}\n".encode())
        os.close(tell)


def _run(request: dict[str, Any], fds: list[int]) -> None:
    """Become the process that was asked for."""
    os.setsid()
    os.write(fds[3], f"{os.getpid()}\n".encode())
    for number, fd in enumerate(fds):
        if number < 3:
            os.dup2(fd, number)
        os.close(fd)
    os.environ.clear()
    os.environ.update(request["environment"])
    os.chdir(request["cwd"])
    module, *arguments = request["command"]
    sys.path.insert(0, request["cwd"])
    sys.argv = [module, *arguments]

    import runpy

    runpy.run_module(module, run_name="__main__", alter_sys=True)


def main(requests: str, idle_s: str, *names: str) -> None:
    """Import and serve."""
    # The folder that the server was started in; a fork has that of its request.
    del sys.path[0]
    for name in names:
        import_module(name)
    serve(socket.socket(fileno=int(requests)), float(idle_s))


if __name__ == "__main__":
    main(*sys.argv[1:])
