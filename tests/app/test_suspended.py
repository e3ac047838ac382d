"""A run that stands still for a while, with its nodes or without them, gives nobody up: time that it did not see counts against nobody."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from radiant_app.events import Event, StageDone, StageStarted, TimeLeft, Warned
from radiant_app.executors import fold
from radiant_app.executors.fold import Fold, NodeEnded, RetryPolicy
from radiant_app.executors.local import LocalExecutor
from radiant_app.executors.protocol import NodeTask
from radiant_app.executors.ray_cluster import _Cluster
from radiant_app.executors.sessions import signal_session
from radiant_app.run.time_left import TimeLeftListener
from radiant_core.aggregate.tree import Tree
from radiant_core.io.run_store import seal
from tests.app.test_faults import planned

DEVICES = tuple(Tree(id=f"devices/{number}", tier="device") for number in "12")
TREE = Tree(id="cloud", tier="cloud", children=(Tree(id="edges/a", tier="edge", children=DEVICES),))
WORK = """
import json, os, signal, time
from pathlib import Path
Path('pid').write_text(str(os.getpid()))
def finish(*_):
    # As `seal` writes it, without the start of numpy.
    Path('done.json').write_text(json.dumps({'version': 1, 'key': 'key', 'files': {}}))
"""
PATIENCE_S = 1.0


@dataclass
class Watcher:
    """Waits `PATIENCE_S` for the second device, and remembers of what pauses it was told."""

    pauses: list[tuple[list[str], float]] = field(default_factory=list)

    def overdue_reason(self, node_id: str, ran_s: float) -> str | None:
        return None

    def timeout_reason(self, node_id: str, ran_s: float) -> str | None:
        return f"it has run for {ran_s:.0f} s" if node_id == "devices/2" and ran_s > PATIENCE_S else None

    def exclude_pause(self, node_ids: Collection[str], seconds: float) -> None:
        self.pauses.append((list(node_ids), seconds))


@pytest.fixture(autouse=True)
def _in_small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Looks every 50 ms, so that seconds stand for minutes."""
    monkeypatch.setattr(fold, "CHECK_INTERVAL_S", 0.05)


def preparer(run: Path) -> Callable[[Tree], NodeTask]:
    def prepare(node: Tree) -> NodeTask:
        (run / node.id).mkdir(parents=True, exist_ok=True)
        return NodeTask(kind=node.tier, stage=node.id, folder=run / node.id, key="key")

    return prepare


def folded(run: Path, second: str, pause: Callable[[], None] = lambda: None) -> tuple[list[Event], list[str]]:
    """Fold the tree; while the second device runs, `pause` happens to the conductor. What it told, and who was lost."""
    events: list[Event] = []
    lost: list[str] = []

    def command(task: NodeTask) -> list[str]:
        work = second if task.stage == "devices/2" else "finish()"
        return [sys.executable, "-c", f"import os; os.chdir({str(task.folder)!r})\n{WORK}{work}"]

    def listen(event: Event) -> None:
        events.append(event)
        if isinstance(event, StageDone) and event.stage == "devices/1":
            pause()

    retry_policy = RetryPolicy(
        may_fail=lambda node, error: node.tier == "device", deadlines=Watcher(), on_given_up=lambda node, begun: lost.append(node.id)
    )
    LocalExecutor(num_workers=2, command=command, retry_policy=retry_policy).fold(TREE, preparer(run), listen)
    return events, lost


def done(events: list[Event]) -> set[str]:
    return {event.stage for event in events if isinstance(event, StageDone)}


def pid_of(folder: Path) -> int:
    deadline_s = time.monotonic() + 20
    while not (folder / "pid").exists() or not (folder / "pid").read_text():
        assert time.monotonic() < deadline_s
        time.sleep(0.01)
    return int((folder / "pid").read_text())


@pytest.mark.parametrize("silent_s", [fold.SILENT_S, PATIENCE_S])
def test_a_run_that_is_suspended_with_its_nodes_gives_nobody_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, silent_s: float) -> None:
    monkeypatch.setattr(fold, "SILENT_S", silent_s)

    def suspend() -> None:
        second = pid_of(tmp_path / "devices/2")
        signal_session(second, signal.SIGSTOP)
        time.sleep(1.5 * PATIENCE_S)
        signal_session(second, signal.SIGCONT)

    events, lost = folded(tmp_path, "time.sleep(0.4)\nfinish()", suspend)
    assert lost == [] and done(events) == {node.id for node in TREE}


def test_a_device_that_ended_while_the_conductor_alone_stood_still_is_done(tmp_path: Path) -> None:
    events, lost = folded(tmp_path, "time.sleep(0.4)\nfinish()", lambda: time.sleep(1.5 * PATIENCE_S))
    assert lost == [] and done(events) == {node.id for node in TREE}


def test_a_device_that_was_given_up_and_is_sealed_is_done(tmp_path: Path) -> None:
    finish = "signal.signal(signal.SIGTERM, lambda *_: (finish(), os.kill(os.getpid(), 9)))\nwhile True: time.sleep(1)"
    events, lost = folded(tmp_path, finish)
    assert lost == [] and "devices/2" in done(events)
    assert not [event for event in events if isinstance(event, Warned)]


class Sleeper:
    """A runner of two devices; in its first wait the whole process stands still, and both have ended by then."""

    def __init__(self, run: Path, pause_s: float) -> None:
        self.run, self.pause_s, self.ends = run, pause_s, list[str]()

    def has_room(self, num_nodes: int = 1) -> bool:
        return True

    def open_gang(self, gang: str, members: Sequence[tuple[Tree, NodeTask]]) -> None:
        raise AssertionError("its tree has no gang")

    def close_gang(self, gang: str) -> None:
        raise AssertionError("its tree has no gang")

    def start(self, node: Tree, task: NodeTask) -> bool:
        self.ends.append(node.id)
        return True

    def wait(self, timeout_s: float) -> tuple[str, NodeEnded] | None:
        time.sleep(self.pause_s)
        self.pause_s = 0.0
        if not self.ends:
            return None
        node_id = self.ends.pop(0)
        seal(self.run / node_id, "key", [])
        return node_id, NodeEnded()

    def stop(self, node_id: str) -> None:
        raise AssertionError(f"{node_id} was given up")

    def stop_all(self) -> None:
        pass


def test_a_pause_is_told_to_those_who_run_and_to_the_watch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fold, "PAUSE_S", 0.3)
    watch, events = Watcher(), list[Event]()
    runner = Sleeper(tmp_path, 0.5)
    Fold(
        runner=runner, prepare=preparer(tmp_path), listen=events.append, clock=time.monotonic, retry_policy=RetryPolicy(deadlines=watch)
    ).run(TREE)
    ((nodes, seconds),) = watch.pauses
    assert set(nodes) == {"devices/1", "devices/2"} and seconds >= 0.5
    warned = [event for event in events if isinstance(event, Warned)]
    assert [event.stage for event in warned] == nodes and all("stood still" in event.message for event in warned)


def test_messages_are_all_heard_before_anybody_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fold, "SILENT_S", -1.0)
    events: list[Event] = []
    runner = Sleeper(tmp_path, 0.0)
    times = Fold(runner=runner, prepare=preparer(tmp_path), listen=events.append, clock=time.monotonic, retry_policy=RetryPolicy()).run(
        TREE
    )
    assert set(times) == done(events) == {node.id for node in TREE}
    assert not [event for event in events if isinstance(event, Warned)]


def test_a_message_of_a_node_that_is_gone_hides_none_that_came_after_it(tmp_path: Path) -> None:
    cluster = _Cluster(address="local", log=tmp_path / "ray.log", command=lambda task: [], tree=TREE)
    cluster.running["devices/2"] = preparer(tmp_path)(DEVICES[1])
    for message in ({"node": "devices/1", "line": ""}, {"node": "devices/2", "lost": "its machine is gone."}):
        cluster.messages.put(message)
    heard = cluster.wait(0.0)
    assert heard is not None and heard[0] == "devices/2" and isinstance(heard[1], NodeEnded)


def test_the_time_of_a_node_that_stood_still_says_nothing_of_others(tmp_path: Path) -> None:
    dealer, tree = planned(tmp_path)
    now_s, told = 0.0, list[Event]()
    watch = TimeLeftListener(
        listen=told.append,
        system=dealer.recipe.system,
        edge_plans=dealer.recipe.edge_plans,
        num_workers=4,
        emulated=False,
        clock=lambda: now_s,
        deadline_factor=10.0,
    )
    first, second, *_ = [node.id for node in tree if node.tier == "device"]
    for node in (first, second):
        watch(StageStarted(stage=node))
    watch.exclude_pause([first], 3600.0)
    now_s = 3700.0
    watch(StageDone(stage=first, seconds=3700.0))
    (left,) = (event for event in told if isinstance(event, TimeLeft))
    assert left.correction == 1.0 and watch.timeout_reason(second, 1e9) is None, "no device was measured"
