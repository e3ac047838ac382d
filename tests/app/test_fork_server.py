"""Processes that a server forks behave as those that start anew, and their server may vanish at any time."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from radiant_app.executors import fork_server, local
from radiant_app.executors.fork_server import CAN_FORK, ForkedProcess, ForkServer, fork_module
from radiant_app.executors.local import LocalExecutor
from radiant_app.executors.protocol import NodeTask
from radiant_core.aggregate.tree import Tree
from radiant_core.io.run_store import SEAL_NAME, seal

pytestmark = pytest.mark.skipif(not CAN_FORK, reason="processes are forked on Linux alone")
NAMES = ("json",)
Start = Callable[..., ForkedProcess]


@pytest.fixture
def start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Start]:
    """Start the lines of a module; servers end with the test."""
    monkeypatch.setattr(fork_server, "_servers", servers := {})
    started: list[ForkedProcess] = []
    with (tmp_path / "log.txt").open("w+") as log:

        def start(lines: str, *arguments: str, names: tuple[str, ...] = NAMES, idle_s: float = 60.0, **variables: str) -> ForkedProcess:
            (tmp_path / "played.py").write_text(lines)
            environment = {**os.environ, "PYTHONPATH": str(tmp_path), **variables}
            started.append(fork_module(["played", *arguments], log, environment, names, idle_s))
            return started[-1]

        yield start
    for process in started:
        assert process.stdin is not None and process.stdout is not None
        process.stdin.close()
        process.stdout.close()
    for server in servers.values():
        server.close()


def children_cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def only_server() -> ForkServer:
    (server,) = fork_server._servers.values()
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


def test_an_error_and_a_signal_end_it_as_they_end_any_process(start: Start, tmp_path: Path) -> None:
    assert start("raise ValueError('played')").wait() == 1
    assert "ValueError: played" in (tmp_path / "log.txt").read_text()
    process = start("import time; time.sleep(60)")
    assert process.poll() is None
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(timeout=0.1)
    os.killpg(process.pid, signal.SIGTERM)
    assert process.wait(timeout=20) == -signal.SIGTERM


def test_what_forks_compute_counts_for_the_process_that_asked(start: Start) -> None:
    before_s = children_cpu_s()
    assert start("import time\nend = time.process_time() + 0.5\nwhile time.process_time() < end: pass").wait() == 0
    only_server().close()
    fork_server._servers.clear()
    assert children_cpu_s() - before_s > 0.45


def test_who_loses_the_server_loses_the_process_and_the_next_has_a_new_one(start: Start) -> None:
    process = start("import time; time.sleep(60)")
    only_server()._process.kill()
    assert process.wait(timeout=20) == -signal.SIGKILL
    waited_until = time.monotonic() + 20
    while Path(f"/proc/{process.pid}").exists() and "State:\tZ" not in Path(f"/proc/{process.pid}/status").read_text():
        assert time.monotonic() < waited_until, "it goes on without its server"
        time.sleep(0.05)
    assert start("import sys; sys.exit(4)").wait() == 4


def test_a_server_that_nobody_asks_ends_but_not_before_its_processes(start: Start) -> None:
    process = start("import sys, time; time.sleep(1); sys.exit(5)", idle_s=0.2)
    server = only_server()
    assert process.wait() == 5
    assert server._process.wait(timeout=20) == 0
    assert start("import sys; sys.exit(6)", idle_s=0.2).wait() == 6 and only_server() is not server


def test_variables_that_libraries_read_once_have_a_server_of_their_own(start: Start) -> None:
    for threads in ("1", "2"):
        process = start("import os; print(os.environ['OMP_NUM_THREADS'])", OMP_NUM_THREADS=threads)
        assert process.stdout is not None and process.stdout.read() == f"{threads}\n"
    assert len(fork_server._servers) == 2


def test_where_no_server_can_be_had_a_node_starts_anew(start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConnectionError):
        start("pass", names=("no_such_module_anywhere",))
    monkeypatch.setattr(local, "fork_module", lambda command, log, environment, names: start("pass", names=("no_such_module_anywhere",)))
    (tmp_path / "played_node.py").write_text(f"import os; os.chdir({str(tmp_path)!r}); os.rename('sealed', {SEAL_NAME!r})")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (tmp_path / "made").write_text("x")
    seal(tmp_path, "key", ["made"])
    (tmp_path / SEAL_NAME).rename(tmp_path / "sealed")
    task = NodeTask(kind="cloud", stage="cloud", folder=tmp_path, key="key", module="played_node")
    executor = LocalExecutor(num_workers=1, command=lambda task: [sys.executable, "-m", task.module])
    times = executor.fold(Tree(id="cloud", tier="cloud"), lambda node: task, lambda event: None)
    assert times["cloud"].ended_s > times["cloud"].started_s
