"""Python processes forked from one that has loaded their libraries. Once per node of a run.

A worker spends some 3 s of CPU time on imports before its work begins, in a small run more than on
the work: that of `sample_scenes/make_runs.py` (12 photographs, 30 nodes) took 23 s of CPU time and
14 s in place of 74 and 43 (`RADIANT_FORK=0`), and made the same bytes of the same structure from
motion. A server imports them once; each `python -m MODULE ARGUMENTS` that is asked of it is a fork
with a session, streams, an environment and a working folder of its own, which receives signals and
is waited for like any process. There is a server for each set of the variables that libraries read
when they are loaded, but for the number of threads, which torch is told; it imports while the run
plans, and ends with it. Where none can be had, or one is killed, processes start anew, and those
that it has forked go on.

    to the server     REQUEST with descriptors: three streams, a pipe to tell by, a file in memory
                      that holds what to run, in which environment: of any size
    by that pipe      "pid N" of the fork itself, before anything else of it; then "code N" of its
                      server. What ends without the first was never a process of a run.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import gc
import json
import os
import re
import select
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import IO, Any, NoReturn

from radiant_app.executors.sessions import FIRST_PID
from radiant_app.interrupts import defer_interrupts
from radiant_core.garbage import without_garbage_search

READ_WHEN_LOADED = ("GOMP_SPINCOUNT", "LD_PRELOAD", "OPENBLAS_NUM_THREADS", "PYTHONPATH")
"""Variables that a library or the interpreter reads once."""
THREADS = "OMP_NUM_THREADS"
"""Read once as well, but torch can be told another number, and tells the native module. numpy's
linear algebra keeps that of the server."""
START_S = 60.0
"""So long imports, or a fork, may take before nodes start anew."""
READY, REQUEST = b"ready", b"fork"
NUM_FDS = 5
"""Descriptors of a request."""
_LINE = re.compile(rb"(pid|code) (-?[0-9]{1,10})\n")
SWITCH = "RADIANT_FORK"
"""Variable that is "0" where every process is to start anew, as tracing tools need it."""


def _can_fork() -> bool:
    # Libraries of macOS break in a fork; Windows has none; Linux before 5.3 has no such waiting.
    if sys.platform != "linux":
        return False
    try:
        os.close(os.pidfd_open(os.getpid()))
        os.close(os.memfd_create("radiant"))
    except (AttributeError, OSError):
        return False
    return True


CAN_FORK = _can_fork()
"""Whether this machine can fork processes that have loaded libraries, and wait for them."""


class ForkedProcess:
    """What a server forked, as far as `subprocess.Popen` is needed here."""

    def __init__(self, pipe: int) -> None:
        self._pipe = pipe
        self._waiting = threading.Lock()
        self.returncode: int | None = None
        self.stdin: IO[str] | None = None
        self.stdout: IO[str] | None = None
        try:
            self.pid = self._begun()
        except OSError:
            os.close(pipe)
            raise
        self._alive: int | None = None
        # It may have ended already; it runs in any case, and must not be started once more.
        with contextlib.suppress(OSError):
            self._alive = os.pidfd_open(self.pid)

    def _begun(self) -> int:
        if not _is_readable(self._pipe, START_S):
            raise TimeoutError(f"the server of processes forked none within {START_S:.0f} s")
        mark, number = self._line()
        if mark == "code":
            raise ConnectionError(f"a forked process ended with code {number} before it began")
        if mark != "pid" or number < FIRST_PID:
            raise ConnectionError("the server of processes forked none")
        return number

    def poll(self) -> int | None:
        """The exit code, below 0 for a signal, or None while the process runs."""
        return self._waited(0)

    def wait(self, timeout: float | None = None) -> int:
        """The exit code; TimeoutExpired after `timeout` seconds. 0 where its server is gone, which
        alone would know: what the process has made says how it ended."""
        code = self._waited(timeout)
        if code is None:
            raise subprocess.TimeoutExpired("a forked process", timeout or 0)
        return code

    def _waited(self, timeout_s: float | None) -> int | None:
        # An executor waits in a thread of its own and, when it stops, in the main one.
        if self._waiting.acquire(timeout=-1 if timeout_s is None else timeout_s):
            try:
                if self.returncode is None and _is_readable(self._pipe if self._alive is None else self._alive, timeout_s):
                    # Its server tells before it lets the process go, or is gone itself.
                    self.returncode = self._line()[1]
                    for fd in {self._pipe, self._alive} - {None}:
                        os.close(fd)
            finally:
                self._waiting.release()
        return self.returncode

    def _line(self) -> tuple[str, int]:
        """The mark of the next line and its number; "" and 0 where its server is gone."""
        line = b""
        while not line.endswith(b"\n") and (byte := os.read(self._pipe, 1)):
            line += byte
        match = _LINE.fullmatch(line)
        return (match[1].decode(), int(match[2])) if match else ("", 0)


class ForkServer:
    """A server that has imported `names`, in an environment and with its variables."""

    def __init__(self, names: Sequence[str], environment: Mapping[str, str]) -> None:
        self.answer: bool | None = None
        """Whether it is ready; None: not asked yet."""
        self._asking, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        command = [sys.executable, "-m", __spec__.name, str(theirs.fileno()), *names]
        variables, nothing = {**environment, "PYTHONUNBUFFERED": "1"}, subprocess.DEVNULL
        try:
            with theirs:
                self._process = subprocess.Popen(
                    command,
                    pass_fds=[theirs.fileno()],
                    env=variables,
                    stdin=nothing,
                    stdout=nothing,
                    stderr=nothing,
                    start_new_session=True,
                )
        except BaseException:
            self._asking.close()
            raise

    def is_ready(self, timeout_s: float = START_S) -> bool:
        """Whether it has imported all within so long from the first question on."""
        if self.answer is None:
            self.answer = _is_readable(self._asking.fileno(), timeout_s) and self._asking.recv(len(READY)) == READY
            if not self.answer:
                self._process.kill()
        return self.answer

    def start(self, command: Sequence[str], fds: Sequence[int], environment: Mapping[str, str], cwd: Path | None = None) -> ForkedProcess:
        """Fork `python -m COMMAND` with three streams; OSError where that fails."""
        request = {"command": [*command], "environment": {**environment}, "cwd": str(cwd or Path.cwd())}
        pipe, tell = os.pipe()
        try:
            # A message is limited to 200 kB. An environment is not, and is longer as JSON.
            with _in_memory(json.dumps(request).encode()) as written:
                socket.send_fds(self._asking, [REQUEST], [*fds, tell, written.fileno()])
        except BaseException:
            os.close(pipe)
            raise
        finally:
            os.close(tell)
        try:
            return ForkedProcess(pipe)
        except TimeoutError:
            # What it may fork yet finds nobody to tell its number to, and ends before its work.
            self._process.kill()
            raise

    def start_piped(self, command: Sequence[str], log: IO[str], environment: Mapping[str, str]) -> ForkedProcess:
        """The same with pipes as standard input and output, and `log` for errors."""
        stdin, to_stdin = os.pipe()
        from_stdout, stdout = os.pipe()
        try:
            process = self.start(command, (stdin, stdout, log.fileno()), environment)
        except BaseException:
            os.close(to_stdin)
            os.close(from_stdout)
            raise
        finally:
            os.close(stdin)
            os.close(stdout)
        process.stdin, process.stdout = os.fdopen(to_stdin, "w"), os.fdopen(from_stdout)
        return process

    def close(self) -> None:
        """End the server and wait for it: its CPU time, and that of its forks, is the caller's."""
        if not self.answer:
            self._process.kill()
        self._asking.close()
        self._process.wait()


class _OpenServers:
    """The servers of this process, and how many runs keep them."""

    num_runs: int = 0
    servers: dict[tuple[object, ...], ForkServer]
    lock = threading.Lock()

    def __init__(self) -> None:
        self.servers = {}


_open_servers = _OpenServers()


@contextlib.contextmanager
def keep_servers() -> Iterator[None]:
    """Servers are there to be opened within the block, and ended where no other such block runs."""
    with _open_servers.lock:
        _open_servers.num_runs += 1
    try:
        yield
    finally:
        with _open_servers.lock:
            _open_servers.num_runs -= 1
            ended = [] if _open_servers.num_runs else [*_open_servers.servers.values()]
            if not _open_servers.num_runs:
                _open_servers.servers.clear()
        for server in ended:
            server.close()


def start_server(names: Sequence[str], environment: Mapping[str, str]) -> ForkServer | None:
    """Start the server that `open_server` will be asked for, whose imports take seconds; None as
    there, but for its imports, and where the system starts no process."""
    if not CAN_FORK or not _open_servers.num_runs or environment.get(SWITCH) == "0":
        return None
    key = _key(names, environment)
    with _open_servers.lock:
        if key not in _open_servers.servers:
            with defer_interrupts(), contextlib.suppress(OSError):
                _open_servers.servers[key] = ForkServer(names, environment)
        return _open_servers.servers.get(key)


def open_server(names: Sequence[str], environment: Mapping[str, str]) -> ForkServer | None:
    """The server that has imported `names` and fits to the environment; None where no run keeps
    servers, none can be forked from here, `SWITCH` forbids it, or its imports failed."""
    server = start_server(names, environment)
    if server is None:
        return None
    with _open_servers.lock:
        return server if server.is_ready() else None


def started_server(names: Sequence[str], environment: Mapping[str, str]) -> ForkServer | None:
    """The server that `open_server` has answered with for such nodes; None where there was none."""
    with _open_servers.lock:
        server = _open_servers.servers.get(_key(names, environment))
    return server if server is not None and server.answer and environment.get(SWITCH) != "0" else None


def _key(names: Sequence[str], environment: Mapping[str, str]) -> tuple[object, ...]:
    return (*names, *((name, environment.get(name)) for name in READ_WHEN_LOADED), _num_threads(environment) is None)


def _num_threads(environment: Mapping[str, str]) -> int | None:
    value = environment.get(THREADS, "")
    return int(value) if value.isdecimal() and int(value) else None


def _is_readable(fd: int, timeout_s: float | None) -> bool:
    poll = select.poll()
    poll.register(fd, select.POLLIN)
    return bool(poll.poll(None if timeout_s is None else 1000 * timeout_s))


def _in_memory(data: bytes) -> IO[bytes]:
    """A file without a place that holds `data`."""
    file = os.fdopen(os.memfd_create("radiant"), "wb")
    try:
        file.write(data)
        file.flush()
    except BaseException:
        file.close()
        raise
    return file


def serve(requests: socket.socket) -> None:
    """Fork a process for each request and tell how it ended, until the other end closes."""
    woken, wake = os.pipe()
    for end in (woken, wake):
        os.set_blocking(end, False)
    signal.signal(signal.SIGCHLD, lambda number, frame: None)
    signal.set_wakeup_fd(wake)
    telling: dict[int, int] = {}
    requests.send(READY)
    while True:
        ready = select.select([requests, woken], [], [])[0]
        if woken in ready:
            os.read(woken, 4096)
            _tell_ended(telling)
        if requests not in ready:
            continue
        request, fds, flags, _ = socket.recv_fds(requests, len(REQUEST) + 1, NUM_FDS)
        if not request:
            # Nothing of its own is left to be done, and tearing its libraries down takes seconds.
            os._exit(0)
        process = -1
        if _is_whole(request, fds, flags):
            with contextlib.suppress(OSError):
                process = os.fork()
        if not process:
            signal.set_wakeup_fd(-1)
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            requests.close()
            for fd in (woken, wake, *telling.values()):
                os.close(fd)
            return _run(fds)
        if process > 0:
            telling[process] = fds.pop(3)
        # Where nothing was forked, the end of this pipe tells it.
        for fd in fds:
            os.close(fd)


def _is_whole(request: bytes, fds: Sequence[int], flags: int) -> bool:
    # Of a process that may open no more files the kernel cuts the descriptors off.
    return request == REQUEST and len(fds) == NUM_FDS and not flags & (socket.MSG_TRUNC | socket.MSG_CTRUNC)


def _tell_ended(telling: dict[int, int]) -> None:
    while telling and (ended := os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)) is not None:
        # Told before it is reaped: until then its number is no other's that somebody might signal.
        tell = telling.pop(ended.si_pid)
        code = ended.si_status if ended.si_code == os.CLD_EXITED else -ended.si_status
        with contextlib.suppress(BrokenPipeError):
            os.write(tell, f"code {code}\n".encode())
        os.close(tell)
        os.waitpid(ended.si_pid, 0)


def _run(fds: list[int]) -> None:
    """Become the process that was asked for."""
    os.setsid()
    # First of all: whatever fails from here on is the end of a process that is waited for.
    os.write(fds[3], f"pid {os.getpid()}\n".encode())
    for number, fd in enumerate(fds[:3]):
        os.dup2(fd, number)
    request: dict[str, Any] = json.loads(_content(fds[4]))
    for fd in fds:
        os.close(fd)
    os.environ.clear()
    os.environ.update(request["environment"])
    os.chdir(request["cwd"])
    module, *arguments = request["command"]
    sys.path.insert(0, request["cwd"])
    sys.argv = [module, *arguments]
    # Kernels that are emulated tell less.
    with contextlib.suppress(OSError, ValueError):
        _name([sys.executable, "-m", module, *arguments])
    if "torch" in sys.modules and (threads := _num_threads(os.environ)) is not None:
        sys.modules["torch"].set_num_threads(threads)

    import runpy

    try:
        runpy.run_module(module, run_name="__main__", alter_sys=True)
    except SystemExit as ended:
        if not isinstance(ended.code, int | None):
            raise
        _end(ended.code or 0)
    _end(0)


def _end(code: int) -> NoReturn:
    """End as Python does, with libraries left as they are: taking them apart in a fork copies them,
    0.3 s of CPU time."""
    threading._shutdown()  # pyright: ignore[reportAttributeAccessIssue]
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    # What libraries of C have printed.
    ctypes.CDLL(None).fflush(None)
    os._exit(code & 0xFF)


def _name(command: Sequence[str]) -> None:
    """What `ps` and `top` call this process: its command, in the place of its server's, as far as
    that goes."""
    Path("/proc/self/comm").write_text(" ".join([*command[3:4], "radiant"]))
    # Where its arguments begin and end in memory; see proc(5).
    start, end = map(int, Path("/proc/self/stat").read_text().rpartition(")")[2].split()[45:47])
    if start:
        words = "\0".join(command).encode(errors="surrogateescape")[: end - start - 1]
        ctypes.memmove(start, words.ljust(end - start, b"\0"), end - start)


def _content(fd: int) -> bytes:
    with os.fdopen(fd, "rb", closefd=False) as file:
        file.seek(0)
        return file.read()


def main(requests: str, *names: str) -> None:
    """Import and serve."""
    # The folder that the server was started in; a fork has that of its request.
    del sys.path[0]
    with without_garbage_search():
        for name in names:
            import_module(name)
        # A fork copies every page that it writes to, and collecting garbage writes to all of them.
        gc.freeze()
    serve(socket.socket(fileno=int(requests)))


if __name__ == "__main__":
    main(*sys.argv[1:])
