"""Processes that a server forks behave as those that start anew, and their server may vanish at any time."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import resource
import signal
import socket
import subprocess
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from radiant_app.events import Event, StageDone, StageSkipped, StageStarted
from radiant_app.executors import fork_server, local
from radiant_app.executors.fork_server import CAN_FORK, SWITCH, ForkedProcess, ForkServer, keep_servers, open_server, start_server
from radiant_app.executors.local import LocalExecutor
from radiant_app.executors.protocol import NodeTask
from radiant_app.executors.sessions import signal_session
from radiant_core.aggregate.tree import Tree
from radiant_core.errors import StageFailed
from radiant_core.io.run_store import SEAL_NAME, seal
from tests.forked import has_ended

pytestmark = pytest.mark.skipif(not CAN_FORK, reason="processes are forked on Linux alone")
NAMES = ("json",)
Start = Callable[..., ForkedProcess]


@pytest.fixture
def start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Start]:
    """Start the lines of a module; servers end with the test."""
    monkeypatch.setattr(fork_server, "_open_servers", type(fork_server._open_servers)())
    started: list[ForkedProcess] = []

    def start(lines: str, *arguments: str, names: tuple[str, ...] = NAMES, **variables: str) -> ForkedProcess:
        # An earlier one may be reading its lines still.
        module = f"played_{hashlib.sha256(lines.encode()).hexdigest()[:8]}"
        if not (tmp_path / f"{module}.py").exists():
            (tmp_path / f"{module}.py").write_text(lines)
        environment = {**os.environ, "PYTHONPATH": str(tmp_path), **variables}
        server = open_server(names, environment)
        assert server is not None
        started.append(server.start_piped([module, *arguments], log, environment))
        return started[-1]

    with (tmp_path / "log.txt").open("w+") as log, keep_servers():
        yield start
    for process in started:
        assert process.stdin is not None and process.stdout is not None
        process.stdin.close()
        process.stdout.close()


def children_cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def only_server() -> ForkServer:
    (server,) = fork_server._open_servers.servers.values()
    assert server is not None
    return server


def test_a_fork_has_arguments_streams_variables_and_a_session_of_its_own(start: Start, tmp_path: Path) -> None:
    lines = """
import json, os, sys
print(json.dumps([sys.argv[1:], os.environ.get('PLAYED'), sys.stdin.readline(), os.getsid(0) == os.getpid(), __name__]))
print('to the log', file=sys.stderr)
sys.exit(3)
"""
    process = start(lines, "a", "b", PLAYED="yes")
    assert process.stdin is not None and process.stdout is not None
    process.stdin.write("hello\n")
    process.stdin.flush()
    assert json.loads(process.stdout.read()) == [["a", "b"], "yes", "hello\n", True, "__main__"]
    assert process.wait() == 3 == process.poll()
    assert (tmp_path / "log.txt").read_text() == "to the log\n"
    second = start("import os, sys; sys.exit('PLAYED' in os.environ)")
    assert second.wait() == 0 and second.pid != process.pid, "a variable of one is none of the next"


def test_a_fork_is_named_by_its_command_and_ends_with_all_that_it_and_its_libraries_printed(start: Start) -> None:
    lines = """
import atexit, ctypes, sys, threading, time
from pathlib import Path
atexit.register(print, 'torn down')
threading.Thread(target=lambda: (time.sleep(0.2), print('a thread'))).start()
ctypes.CDLL(None).printf(b'of C\\n')
print(Path('/proc/self/cmdline').read_bytes().rstrip(b'\\0').split(b'\\0')[-1].decode())
sys.exit(3)
"""
    process = start(lines, "devices/d")
    assert process.stdout is not None
    assert sorted(process.stdout.read().splitlines()) == ["a thread", "devices/d", "of C", "torn down"]
    assert process.wait() == 3
    in_words = start("import sys; sys.exit('in words')")
    assert in_words.wait() == 1


def test_an_error_and_a_signal_end_it_as_they_end_any_process(start: Start, tmp_path: Path) -> None:
    assert start("raise ValueError('played')").wait() == 1
    assert "ValueError: played" in (tmp_path / "log.txt").read_text()
    process = start("import time; time.sleep(60)")
    assert process.poll() is None
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(timeout=0.1)
    signal_session(process.pid, signal.SIGTERM)
    assert process.wait(timeout=20) == -signal.SIGTERM


def test_what_forks_compute_counts_for_the_process_that_asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fork_server, "_open_servers", type(fork_server._open_servers)())
    (tmp_path / "played.py").write_text("import time\nend = time.process_time() + 0.5\nwhile time.process_time() < end: pass")
    before_s, environment = children_cpu_s(), {**os.environ, "PYTHONPATH": str(tmp_path)}
    with Path(os.devnull).open("r+") as nothing, keep_servers():
        server = open_server(NAMES, environment)
        assert server is not None and server is open_server(NAMES, environment)
        assert server.start(["played"], [nothing.fileno()] * 3, environment).wait() == 0
    assert children_cpu_s() - before_s > 0.45 and server._process.returncode == 0, "it ends with the last run"
    assert open_server(NAMES, environment) is None, "nobody would end it"
    with keep_servers():
        assert open_server(NAMES, {**environment, SWITCH: "0"}) is None


def test_a_process_whose_server_is_killed_goes_on_and_the_next_starts_anew(start: Start, tmp_path: Path) -> None:
    process = start("import sys\nfrom pathlib import Path\nPath(sys.argv[1]).write_text(sys.stdin.read())", str(tmp_path / "made"))
    only_server()._process.kill()
    assert process.poll() is None and process.stdin is not None
    process.stdin.write("finished")
    process.stdin.close()
    assert process.wait(timeout=20) == 0, "its seal decides"
    assert (tmp_path / "made").read_text() == "finished"
    with pytest.raises(OSError, match=r".+"):
        start("pass")


def test_an_interrupt_while_a_server_starts_leaves_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fork_server, "_open_servers", type(fork_server._open_servers)())
    start, started = subprocess.Popen, list[subprocess.Popen[bytes]]()

    def start_and_interrupt(*arguments: Any, **options: Any) -> subprocess.Popen[bytes]:
        started.append(start(*arguments, **options))
        signal.raise_signal(signal.SIGINT)
        return started[-1]

    monkeypatch.setattr(fork_server.subprocess, "Popen", start_and_interrupt)
    # Where a shell began the tests in the background, interrupts are ignored.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with keep_servers(), pytest.raises(KeyboardInterrupt):
            open_server(("torch",), {**os.environ})
    finally:
        signal.signal(signal.SIGINT, before)
    assert [process.returncode for process in started] == [-signal.SIGKILL]


def test_processes_that_end_at_once_are_all_told(start: Start) -> None:
    ended = [start("import os, sys; os._exit(int(sys.argv[1]))", str(code)) for code in range(40)]
    assert [process.wait(timeout=60) for process in ended] == list(range(40))


FAILING = """
import os
real, calls = os.fork, []

def fork():
    calls.append(1)
    if len(calls) == 2:
        raise BlockingIOError(11, "no more processes")
    return real()

os.fork = fork
"""


def test_a_fork_that_fails_is_one_process_alone(start: Start, tmp_path: Path) -> None:
    (tmp_path / "failing_forks.py").write_text(FAILING)
    running = start("import sys; sys.stdin.read(); sys.exit(5)", names=("failing_forks",))
    with pytest.raises(ConnectionError, match="forked none"):
        start("pass", names=("failing_forks",))
    assert running.poll() is None and running.stdin is not None
    running.stdin.close()
    assert running.wait(timeout=20) == 5
    assert start("import sys; sys.exit(6)", names=("failing_forks",)).wait() == 6


def test_variables_that_libraries_read_once_have_a_server_of_their_own(start: Start) -> None:
    for spins in ("0", "1"):
        process = start("import os; print(os.environ['GOMP_SPINCOUNT'])", GOMP_SPINCOUNT=spins)
        assert process.stdout is not None and process.stdout.read() == f"{spins}\n"
    assert len(fork_server._open_servers.servers) == 2


def test_forks_of_one_server_have_the_threads_that_each_asks_for(start: Start) -> None:
    lines = "import torch\na = torch.ones(2000, 2000) @ torch.ones(2000, 2000)\nprint(torch.get_num_threads(), bool((a == 2000).all()))"
    for threads in ("1", "3", "2"):
        process = start(lines, names=("torch",), OMP_NUM_THREADS=threads)
        assert process.stdout is not None and process.stdout.read() == f"{threads} True\n"
    assert len(fork_server._open_servers.servers) == 1
    first = only_server()
    unset = {name: value for name, value in os.environ.items() if name != "OMP_NUM_THREADS"}
    assert first is not open_server(("torch",), unset), "what libraries choose is no number to be told"


def test_a_server_that_was_started_imports_meanwhile_and_is_the_one_that_is_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fork_server, "_open_servers", type(fork_server._open_servers)())
    environment = {**os.environ}
    assert start_server(NAMES, environment) is None, "nobody would end it"
    with keep_servers():
        started = start_server(NAMES, environment)
        assert started is not None and started.answer is None, "nothing waits for it"
        assert open_server(NAMES, environment) is started and started.answer
        unused = start_server(("torch",), environment)
    assert unused is not None and started._process.returncode == 0 and unused._process.returncode == -signal.SIGKILL


def test_a_fold_in_which_all_is_finished_opens_no_server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local, "open_server", lambda *arguments: pytest.fail("nothing is to be started"))
    (tmp_path / "made").write_text("x")
    seal(tmp_path, "key", ["made"])
    tree = Tree(id="cloud", tier="cloud", children=(Tree(id="edges/a", tier="edge"),))
    task = NodeTask(kind="cloud", stage="cloud", folder=tmp_path, key="key")
    heard: list[Event] = []
    LocalExecutor(num_workers=1).fold(tree, lambda node: task, heard.append)
    assert heard == [StageSkipped(stage="cloud")] * 2, "both nodes were looked at"


@pytest.mark.parametrize("killed", [False, True])
def test_where_no_server_can_be_had_a_node_starts_anew(killed: bool, start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def open_none(names: Sequence[str], environment: Mapping[str, str]) -> ForkServer | None:
        server = open_server(NAMES if killed else ("no_such_module_anywhere",), environment)
        assert (server is None) != killed
        if server is not None:
            server._process.kill()
            server._process.wait()
        return server

    monkeypatch.setattr(local, "open_server", open_none)
    (tmp_path / "played_node.py").write_text(f"import os; os.chdir({str(tmp_path)!r}); os.rename('sealed', {SEAL_NAME!r})")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (tmp_path / "made").write_text("x")
    seal(tmp_path, "key", ["made"])
    (tmp_path / SEAL_NAME).rename(tmp_path / "sealed")
    task = NodeTask(kind="cloud", stage="cloud", folder=tmp_path, key="key", module="played_node")
    times = LocalExecutor(num_workers=1).fold(Tree(id="cloud", tier="cloud"), lambda node: task, lambda event: None)
    assert times["cloud"].ended_s > times["cloud"].started_s


@pytest.mark.parametrize(
    "variables",
    [
        {"B1": 100_000 * "a", "B2": 60_000 * "b"},
        {"B1": 21_000 * "ü"},
        {f"B{number}": 100_000 * "c" for number in range(4)},
        {f"B{number}": 40_000 * "字" for number in range(4)},
    ],
    ids=["160 kB", "42 kB of umlauts, 126 kB as JSON", "400 kB", "480 kB of other letters"],
)
def test_an_environment_of_any_size_arrives_whole(start: Start, variables: dict[str, str]) -> None:
    lines = """
import hashlib, json, os
print(json.dumps({name: hashlib.sha256(value.encode()).hexdigest() for name, value in os.environ.items()}))
"""
    process = start(lines, **variables)
    assert process.stdout is not None
    had = json.loads(process.stdout.read())
    assert process.wait(timeout=20) == 0
    assert {name: had[name] for name in variables} == {
        name: hashlib.sha256(value.encode()).hexdigest() for name, value in variables.items()
    }


BREAKING = """
import json, os

def after(number, broken):
    real, calls = broken, []
    def call(*arguments):
        calls.append(1)
        if len(calls) == number:
            raise MemoryError("played")
        return real(*arguments)
    return call
"""


def test_what_ends_a_fork_before_its_number_is_known_is_an_error_and_no_process(start: Start, tmp_path: Path) -> None:
    # A fork has a copy of the counter, so that every one of them fails.
    (tmp_path / "breaking.py").write_text(f"{BREAKING}\nos.setsid = after(1, os.setsid)")
    with pytest.raises(ConnectionError, match="ended with code 1 before it began"):
        start("pass", names=("breaking",))


def test_what_ends_a_fork_afterwards_is_its_end_and_told_in_its_log(start: Start, tmp_path: Path) -> None:
    (tmp_path / "breaking.py").write_text(f"{BREAKING}\njson.loads = after(1, json.loads)")
    assert start("pass", names=("breaking",)).wait(timeout=20) == 1
    assert "MemoryError: played" in (tmp_path / "log.txt").read_text()


def test_a_request_that_the_kernel_cut_forks_nothing_and_the_next_is_served(start: Start, tmp_path: Path) -> None:
    assert start("pass").wait(timeout=20) == 0
    server = only_server()
    for message, num_fds in ((fork_server.REQUEST + b" and more", 5), (fork_server.REQUEST, 3), (b"anything", 5), (fork_server.REQUEST, 9)):
        told, tell = os.pipe()
        socket.send_fds(server._asking, [message], [tell] * num_fds)
        os.close(tell)
        assert os.read(told, 1) == b"", "all ends of the pipe are closed"
        os.close(told)
    assert start("import sys; sys.exit(4)").wait(timeout=20) == 4


def test_a_server_without_room_for_descriptors_forks_none(start: Start, tmp_path: Path) -> None:
    (tmp_path / "few_files.py").write_text(
        "import os, resource\nresource.setrlimit(resource.RLIMIT_NOFILE, (len(os.listdir('/proc/self/fd')) + 4, 4096))"
    )
    with pytest.raises(ConnectionError, match="forked none"):
        start("pass", names=("few_files",))


@pytest.mark.parametrize("line", [b"", b"1\n", b"4321\n", b"pid 1\n", b"pid 0\n", b"pid -1\n", b"code 1\n", b"pid 12", b"pid 4321 \n"])
def test_only_a_marked_number_of_a_process_is_taken_for_one(line: bytes) -> None:
    told, tell = os.pipe()
    os.write(tell, line)
    os.close(tell)
    with pytest.raises(ConnectionError):
        ForkedProcess(told)
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(told)


def test_a_server_that_answers_nothing_is_given_up(start: Start, monkeypatch: pytest.MonkeyPatch) -> None:
    assert start("pass").wait(timeout=20) == 0
    server = only_server()
    server._process.send_signal(signal.SIGSTOP)
    monkeypatch.setattr(fork_server, "START_S", 0.3)
    with pytest.raises(TimeoutError, match="forked none within"):
        start("pass")
    assert server._process.wait(timeout=20) == -signal.SIGKILL


REMEDIES = {
    errno.E2BIG: "unset variables that are large",
    errno.EAGAIN: "end other processes, or raise their limit (ulimit -u)",
    errno.EMFILE: "raise the limit of open files (ulimit -n)",
    errno.ENOMEM: "free memory",
    errno.ENOENT: "check that its Python is there and may be run",
}


@pytest.mark.parametrize("number", REMEDIES, ids=errno.errorcode.get)
def test_a_system_that_starts_no_process_leaves_no_server_and_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    def refuse(*arguments: Any, **options: Any) -> None:
        raise OSError(number, os.strerror(number), "python")

    monkeypatch.setattr(fork_server, "_open_servers", type(fork_server._open_servers)())
    monkeypatch.setattr(fork_server.subprocess, "Popen", refuse)
    with keep_servers():
        assert start_server(NAMES, {**os.environ}) is None
    task = NodeTask(kind="cloud", stage="cloud", folder=tmp_path, key="key")
    said = f"cloud: its process cannot be started ({os.strerror(number)}): {REMEDIES[number]}, then run again with --resume."
    with pytest.raises(StageFailed, match=re.escape(said)):
        LocalExecutor(num_workers=1).fold(Tree(id="cloud", tier="cloud"), lambda node: task, lambda event: None)


@pytest.mark.parametrize("kill_after", ["the first has begun", "two have begun", "the first is done"])
def test_a_fold_whose_server_is_killed_in_its_middle_finishes(
    kill_after: str, start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nodes that run go on, those to come start anew, and nothing of either is alive afterwards."""
    monkeypatch.setattr(local, "open_server", lambda names, environment: open_server(NAMES, environment))
    lines = "import os, sys, time; from pathlib import Path; os.chdir(sys.argv[2]); Path('pid').write_text(str(os.getpid()))\n"
    (tmp_path / "played_node.py").write_text(f"{lines}time.sleep(0.5)\nos.rename('sealed', {SEAL_NAME!r})\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    devices = tuple(Tree(id=f"devices/{number}", tier="device") for number in range(4))
    tree = Tree(id="cloud", tier="cloud", children=devices)
    heard: list[Event] = []

    def prepare(node: Tree) -> NodeTask:
        folder = tmp_path / node.id
        folder.mkdir(parents=True)
        (folder / "made").write_text("x")
        seal(folder, "key", ["made"])
        (folder / SEAL_NAME).rename(folder / "sealed")
        return NodeTask(kind="device", stage=node.id, folder=folder, key="key", module="played_node")

    def listen(event: Event) -> None:
        heard.append(event)
        begun, done = (sum(isinstance(each, kind) for each in heard) for kind in (StageStarted, StageDone))
        if {"the first has begun": begun == 1, "two have begun": begun == 2, "the first is done": done == 1}[kill_after]:
            only_server()._process.kill()

    LocalExecutor(num_workers=2, num_threads=1).fold(tree, prepare, listen)
    assert only_server()._process.wait(timeout=20) == -signal.SIGKILL
    assert {event.stage for event in heard if isinstance(event, StageDone)} == {node.id for node in tree}
    for node in tree:
        pid = int((tmp_path / node.id / "pid").read_text())
        assert has_ended(pid)
