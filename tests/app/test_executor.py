"""The local executor: order, limits, skipping, failure and time, with small processes in place of real work."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from radiant_app.events import (
    Decided,
    Event,
    Failed,
    StageDone,
    StageProgress,
    StageSkipped,
    StageStarted,
    Warned,
    decode,
    encode,
)
from radiant_app.executors import local
from radiant_app.executors.local import LocalExecutor
from radiant_app.executors.protocol import NodeTask
from radiant_app.reporting import EventReporter
from radiant_app.workers.memory import EDGES_AT_ONCE
from radiant_app.workers.training import make_machine
from radiant_core.aggregate.tree import Tree
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput, CannotWrite, StageFailed
from radiant_core.hierarchy.join_limits import limit_of_machine
from radiant_core.io.run_store import SEAL_NAME, seal

DEVICES = tuple(Tree(id=f"devices/{number}", tier="device") for number in "123")
TREE = Tree(id="cloud", tier="cloud", children=(Tree(id="edges/a", tier="edge", children=DEVICES),))
SEAL = f"import os; os.rename('sealed', {SEAL_NAME!r})"
"""Without the imports of the project: `preparer` seals the product beforehand and the process only says so."""


def commands(scripts: dict[str, str]) -> Callable[[NodeTask], list[str]]:
    def command(task: NodeTask) -> list[str]:
        return [sys.executable, "-S", "-c", f"import os; os.chdir({str(task.folder)!r})\n{scripts.get(task.stage, SEAL)}"]

    return command


def executor(scripts: dict[str, str], num_workers: int = 2) -> LocalExecutor:
    return LocalExecutor(num_workers=num_workers, command=commands(scripts))


def preparer(run: Path, order: list[str]):
    def prepare(node: Tree) -> NodeTask:
        order.append(node.id)
        folder = run / node.id
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / SEAL_NAME).exists():
            (folder / "made").write_text("x")
            seal(folder, "key", ["made"])
            (folder / SEAL_NAME).rename(folder / "sealed")
        return NodeTask(kind=node.tier, stage=node.id, folder=folder, key="key")

    return prepare


def test_children_run_before_parents_and_a_second_fold_skips_all(tmp_path: Path) -> None:
    order: list[str] = []
    events: list[Event] = []
    times = executor({}).fold(TREE, preparer(tmp_path, order), events.append)
    assert order[-2:] == ["edges/a", "cloud"] and len(order) == 5
    assert times["edges/a"].started_s >= max(times[f"devices/{d}"].ended_s for d in "123")
    again: list[Event] = []
    executor({"cloud": "raise SystemExit(1)"}).fold(TREE, preparer(tmp_path, []), again.append)
    assert [type(event) for event in again] == [StageSkipped] * 5


def test_never_more_processes_than_workers(tmp_path: Path) -> None:
    running, most = 0, 0

    def listen(event: Event) -> None:
        nonlocal running, most
        running += isinstance(event, StageStarted) - isinstance(event, StageDone)
        most = max(most, running)

    executor({}, num_workers=2).fold(TREE, preparer(tmp_path, []), listen)
    assert most == 2


@pytest.mark.parametrize(("num_workers", "at_once"), [(1, 1), (2, 2), (8, 3)])
def test_a_worker_is_told_how_many_edges_may_share_its_machine(num_workers: int, at_once: int, tmp_path: Path) -> None:
    edges = tuple(Tree(id=f"edges/{name}", tier="edge", children=(Tree(id=f"devices/{name}", tier="device"),)) for name in "abc")
    tell = f"open('told', 'w').write(os.environ[{EDGES_AT_ONCE!r}])\n{SEAL}"
    tree = Tree(id="cloud", tier="cloud", children=edges)
    executor({"edges/b": tell}, num_workers).fold(tree, preparer(tmp_path, []), lambda event: None)
    assert (tmp_path / "edges/b/told").read_text() == str(at_once)


def test_a_node_divides_free_memory_among_these_edges(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reporter = EventReporter(stage="edges/a", emit=lambda event: None)
    assert make_machine(tmp_path, 10.0, reporter).num_edges == 1
    monkeypatch.setenv(EDGES_AT_ONCE, "3")
    machine = make_machine(tmp_path, 10.0, reporter)
    assert machine.num_edges == 3 and 0 < machine.held_bytes() < 1e12
    limit = limit_of_machine(replace(machine, free_bytes=lambda: 3e9), machine.num_edges)
    assert limit.num_bytes == pytest.approx(machine.held_bytes() + 0.8e9, rel=0.2)


def test_events_of_a_worker_reach_the_listener(tmp_path: Path) -> None:
    line = encode(StageProgress(stage="devices/1", done=1, total=2, note="half"))
    seen: list[Event] = []
    executor({"devices/1": f"print({line!r})\n{SEAL}"}).fold(TREE, preparer(tmp_path, []), seen.append)
    assert StageProgress(stage="devices/1", done=1, total=2, note="half") in seen


def test_a_failed_worker_is_named_with_its_reason_and_the_others_are_stopped(tmp_path: Path) -> None:
    line = encode(Failed(stage="devices/2", message="no photographs: take some.", exit_code=2))
    scripts = {"devices/1": "import time; time.sleep(60)", "devices/2": f"print({line!r}); raise SystemExit(2)"}
    with pytest.raises(BadInput, match=r"devices/2: no photographs: take some\."):
        executor(scripts).fold(TREE, preparer(tmp_path, []), lambda event: None)
    assert not (tmp_path / "devices" / "1" / "done.json").exists()


def test_a_disk_that_is_full_is_no_bad_input_of_a_worker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    line = encode(Failed(stage="devices/2", message="cannot write model: No space left.", exit_code=2, cannot_write=True))
    with pytest.raises(CannotWrite, match="No space left"):
        executor({"devices/2": f"print({line!r}); raise SystemExit(2)"}).fold(TREE, preparer(tmp_path, []), lambda event: None)
    monkeypatch.setattr(local, "disk_is_full", lambda folder: True)
    with pytest.raises(CannotWrite, match="is full"):
        # In a folder of its own: the first fold may have sealed this device before the other failed.
        executor({"devices/3": "import os; os.kill(os.getpid(), 7)"}).fold(TREE, preparer(tmp_path / "full", []), lambda event: None)


def test_a_worker_says_whether_the_disk_or_its_input_is_at_fault(tmp_path: Path) -> None:
    for error, cannot_write in (("OSError(28, 'full')", True), ("CannotWrite('full')", True), ("FileNotFoundError(2, 'x')", False)):
        work = "from radiant_core.errors import CannotWrite; from radiant_app.workers import nodes, worker\n"
        fails = f"{work}def fail(*_): raise {error}\nnodes.run_node = fail\n"
        mend = f"{fails}worker.main(['device', {str(tmp_path)!r}, 'devices/1', 'key'])"
        ended = subprocess.run([sys.executable, "-c", mend], capture_output=True, text=True, check=False)
        event = decode(ended.stdout.splitlines()[-1])
        assert isinstance(event, Failed) and event.exit_code == 2 and event.cannot_write == cannot_write


def test_a_killed_worker_is_named_and_resuming_finishes(tmp_path: Path) -> None:
    with pytest.raises(
        StageFailed, match=r"devices/3: its process was killed by signal 9 \(as systems do where memory runs out\) before .* --resume"
    ):
        executor({"devices/3": "import os; os.kill(os.getpid(), 9)"}).fold(TREE, preparer(tmp_path, []), lambda event: None)
    times = executor({}).fold(TREE, preparer(tmp_path, []), lambda event: None)
    assert set(times) == {"cloud", "edges/a", "devices/1", "devices/2", "devices/3"}


def test_a_worker_ends_when_its_executor_is_gone(tmp_path: Path) -> None:
    sleeper = "import time; from radiant_app.workers import nodes, worker\n"
    sleeper += "nodes.run_node = lambda *_: print('here', flush=True) or time.sleep(60)\n"
    command = [sys.executable, "-c", sleeper + f"worker.main(['device', {str(tmp_path)!r}, 'devices/1', 'key'])"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None and process.stderr is not None
        assert process.stderr.readline() == "here\n"
        process.stdin.close()
        assert process.wait(timeout=10) == 1


def test_a_worker_that_forgets_to_seal_is_not_believed(tmp_path: Path) -> None:
    with pytest.raises(StageFailed, match="ended with code 0 before it was done"):
        executor({"devices/1": "pass"}).fold(TREE, preparer(tmp_path, []), lambda event: None)


def test_the_injected_clock_decides_the_times(tmp_path: Path) -> None:
    ticks = iter(range(100, 200))
    one = executor({}, num_workers=1)
    one.clock = lambda: float(next(ticks))
    times = one.fold(TREE, preparer(tmp_path, []), lambda event: None)
    assert times["devices/1"].started_s == 1.0 and times["cloud"].ended_s == 10.0


DECISION = Decision(stage="plan", topic="method", choice="paper", figure=None, unit="", reason="asked for", forced=True)


@pytest.mark.parametrize(
    "event",
    [
        StageStarted(stage="sfm"),
        StageProgress(stage="sfm", done=1.5, total=3, note="ü"),
        StageDone(stage="sfm", seconds=1.25),
        StageSkipped(stage="sfm"),
        Warned(stage="sfm", message="line\nbreak"),
        Decided(decision=DECISION),
        Failed(stage="sfm", message="x", exit_code=2),
    ],
)
def test_events_survive_the_wire(event: Event) -> None:
    assert "\n" not in encode(event)
    assert decode(encode(event)) == event


NO_EVENTS = ["", "hello", "[]", "{}", '{"event": "Nope"}', '{"event": "StageDone"}', '{"event": "Decided", "decision": 3}']


@pytest.mark.parametrize("line", NO_EVENTS)
def test_a_line_that_is_no_event_is_refused(line: str) -> None:
    with pytest.raises(StageFailed, match="no event"):
        decode(line)


def test_a_worker_ends_as_it_is_with_its_code_and_all_that_it_printed() -> None:
    printing = "import atexit, sys; atexit.register(print, 'torn down'); sys.stdout.write('a figure'); sys.stderr.write('a warning')"
    ending = "from radiant_app.workers.worker import end_process; end_process(3)"
    ended = subprocess.run([sys.executable, "-c", f"{printing}; {ending}"], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (3, "a figure", "a warning")
