"""Python processes for tests, forked from one that has imported the libraries.

A node of a tiny run takes 2 s of CPU time for imports and 0.3 s for its work. As in a run, each
process has a session, pipes, an environment and threads of its own, and receives signals; only
its interpreter does not start anew. Tests of how a process starts call `sys.executable`
themselves, and whatever a forked process starts does start anew.
"""

from __future__ import annotations

import atexit
import importlib
import json
import os
import runpy
import select
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import IO, Any

IMPORTED_BEFORE = ("zlib", "torch", "pycolmap", "cv2", "pydantic", "scipy.optimize", "scipy.spatial", "shapely", "typer", "rich.progress")
"""Libraries alone: what the project's modules import, and when, is as in a process that starts anew."""
READ_WHEN_LOADED = ("GOMP_SPINCOUNT", "LD_PRELOAD", "OMP_NUM_THREADS", "PYTHONPATH")
"""Variables that a library or the interpreter reads once: there is a server for each set of their values."""
MAX_REQUEST_BYTES = 1 << 18


class ForkedProcess:
    """`python -m MODULE ARGUMENTS` in a process that a server forks; what the local executor uses of subprocess.Popen."""

    def __init__(self, command: Sequence[str], fds: Sequence[int], environment: Mapping[str, str], cwd: Path | None = None) -> None:
        self._ended, tell = os.pipe()
        request = {"command": [*command], "environment": {**environment}, "cwd": str(cwd or Path.cwd())}
        server = _server(tuple((name, environment[name]) for name in READ_WHEN_LOADED if name in environment))
        socket.send_fds(server, [json.dumps(request).encode()], [*fds, tell])
        os.close(tell)
        self._waiting = threading.Lock()
        self.pid = int(self._line())
        self.returncode: int | None = None
        self.stdin: IO[str] | None = None
        self.stdout: IO[str] | None = None

    def poll(self) -> int | None:
        """The exit code, or None while the process runs."""
        return self._waited(0)

    def wait(self, timeout: float | None = None) -> int:
        """The exit code; TimeoutExpired after `timeout` seconds."""
        code = self._waited(timeout)
        if code is None:
            raise subprocess.TimeoutExpired("a forked process", timeout or 0)
        return code

    def _waited(self, timeout_s: float | None) -> int | None:
        # The executor waits in a thread of its own and, when it stops, in the main one.
        if self._waiting.acquire(timeout=-1 if timeout_s is None else timeout_s):
            try:
                if self.returncode is None and select.select([self._ended], [], [], timeout_s)[0]:
                    self.returncode = int(self._line() or -signal.SIGKILL)
                    os.close(self._ended)
            finally:
                self._waiting.release()
        return self.returncode

    def _line(self) -> bytes:
        line = b""
        while not line.endswith(b"\n") and (byte := os.read(self._ended, 1)):
            line += byte
        return line


def popen(command: Sequence[str], *, stderr: IO[str], env: Mapping[str, str], **options: Any) -> Any:
    """subprocess.Popen as the local executor calls it, but a Python module is forked."""
    if sys.platform != "linux" or list(command[:2]) != [sys.executable, "-m"]:
        return subprocess.Popen(command, stderr=stderr, env=env, **options)
    stdin, to_stdin = os.pipe()
    from_stdout, stdout = os.pipe()
    process = ForkedProcess(command[2:], (stdin, stdout, stderr.fileno()), env)
    os.close(stdin)
    os.close(stdout)
    process.stdin, process.stdout = os.fdopen(to_stdin, "w"), os.fdopen(from_stdout)
    return process


def start_module(*arguments: object, log: IO[Any], cwd: Path, environment: Mapping[str, str]) -> Any:
    """`python -m ARGUMENTS` with all that it prints in a log; what Popen and ForkedProcess have alike."""
    command = [*map(str, arguments)]
    if sys.platform != "linux":
        starting = [sys.executable, "-m", *command]
        return subprocess.Popen(starting, cwd=cwd, env=environment, stdout=log, stderr=log, start_new_session=True)
    with Path(os.devnull).open() as nothing:
        return ForkedProcess(command, (nothing.fileno(), log.fileno(), log.fileno()), environment, cwd)


def run_module(
    *arguments: object, cwd: Path | None = None, timeout_s: float = 300, environment: Mapping[str, str] = os.environ
) -> subprocess.CompletedProcess[str]:
    """What `python -m ARGUMENTS` prints, and its exit code."""
    command = [*map(str, arguments)]
    if sys.platform != "linux":
        starting = [sys.executable, "-m", *command]
        return subprocess.run(starting, capture_output=True, text=True, cwd=cwd, env=environment, timeout=timeout_s, check=False)
    with Path(os.devnull).open() as nothing, tempfile.TemporaryFile("w+") as output, tempfile.TemporaryFile("w+") as errors:
        process = ForkedProcess(command, (nothing.fileno(), output.fileno(), errors.fileno()), environment, cwd)
        try:
            code = process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            raise
        output.seek(0)
        errors.seek(0)
        return subprocess.CompletedProcess(command, code, output.read(), errors.read())


@cache
def _server(environment: tuple[tuple[str, str], ...]) -> socket.socket:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    others = {name: value for name, value in os.environ.items() if name not in READ_WHEN_LOADED}
    variables = {**others, **dict(environment), "PYTHONUNBUFFERED": "1"}
    command = [sys.executable, __file__, str(theirs.fileno())]
    server = subprocess.Popen(command, pass_fds=[theirs.fileno()], env=variables, stdin=subprocess.DEVNULL, start_new_session=True)
    theirs.close()

    def end() -> None:
        ours.close()
        server.wait(timeout=10)

    atexit.register(end)
    return ours


def serve(requests: socket.socket) -> None:
    """Fork a process for each request, until the other end closes."""
    for name in IMPORTED_BEFORE:
        importlib.import_module(name)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    while True:
        request, fds, _, _ = socket.recv_fds(requests, MAX_REQUEST_BYTES, 4)
        if not request:
            return
        if not os.fork():
            requests.close()
            _keep(json.loads(request), fds)
            return
        for fd in fds:
            os.close(fd)


def _keep(request: dict[str, Any], fds: list[int]) -> None:
    """Start the process that was asked for, and tell its end: only a parent learns it."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    process = os.fork()
    if process:
        for fd in fds[:3]:
            os.close(fd)
        _, status = os.waitpid(process, 0)
        os.write(fds[3], f"{os.waitstatus_to_exitcode(status)}\n".encode())
        os._exit(0)
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
    runpy.run_module(module, run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    # This file's folder: its `core` and `app` hold tests.
    del sys.path[0]
    serve(socket.socket(fileno=int(sys.argv[1])))
