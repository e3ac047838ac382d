"""Nodes of a gang run at the same time: when they start, what happens to the others when one is
killed or given up, on `local`, with small processes in place of real work.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import pytest

from radiant_app.events import Event, Failed, StageDone, StageSkipped, StageStarted, Warned, encode
from radiant_app.executors import local
from radiant_app.executors.fold import RetryPolicy
from radiant_app.executors.local import LocalExecutor
from radiant_app.executors.protocol import NodeTask
from radiant_core.aggregate.tree import Tree, with_gangs
from radiant_core.errors import BadInput, StageFailed
from radiant_core.io.run_store import SEAL_NAME
from tests.app.test_executor import SEAL, commands, preparer

WAIT_S = 60.0
PLAIN = Tree(
    id="cloud",
    tier="cloud",
    children=tuple(
        Tree(id=f"edges/{edge}", tier="edge", children=tuple(Tree(id=f"devices/{edge}{number}", tier="device") for number in "12"))
        for edge in "ab"
    ),
)
NODES = [node.id for node in PLAIN]
ALL = with_gangs(PLAIN, lambda node_id: "all")
EDGES = with_gangs(PLAIN, lambda node_id: None if node_id == "cloud" else node_id.split("/")[1][0])
SLEEP = "import time; time.sleep(60)"


def meet(run: Path, others: Sequence[str]) -> str:
    """A script that is done once the processes of `others` are there too."""
    return f"""
import pathlib, time
pathlib.Path('alive').touch()
until_s = time.monotonic() + {WAIT_S}
while not all((pathlib.Path({str(run)!r}) / other / 'alive').exists() for other in {[*others]!r}):
    if time.monotonic() > until_s: raise SystemExit('alone')
    time.sleep(0.01)
{SEAL}
"""


def fold(
    run: Path, tree: Tree, scripts: dict[str, str], num_workers: int = 2, policy: RetryPolicy | None = None
) -> tuple[list[Event], dict[str, tuple[float, float]]]:
    """The events of a fold, and when each node began and ended."""

    events: list[Event] = []
    executor = LocalExecutor(num_workers=num_workers, command=commands(scripts), retry_policy=policy or RetryPolicy())
    times = executor.fold(tree, preparer(run, []), events.append)
    return events, {node_id: (each.started_s, each.ended_s) for node_id, each in times.items()}


def stages(events: Sequence[Event], kind: type[StageStarted] | type[StageDone] | type[StageSkipped]) -> list[str]:
    return [event.stage for event in events if isinstance(event, kind)]


def warnings(events: Sequence[Event]) -> dict[str, str]:
    return {event.stage: event.message for event in events if isinstance(event, Warned)}


@pytest.mark.parametrize("num_workers", [1, 3, 8])
def test_cloud_edges_and_devices_in_one_gang_run_at_once_with_any_number_of_workers(num_workers: int, tmp_path: Path) -> None:
    events, times = fold(tmp_path, ALL, dict.fromkeys(NODES, meet(tmp_path, NODES)), num_workers)
    assert sorted(stages(events, StageDone)) == sorted(NODES)
    assert max(begun for begun, _ in times.values()) < min(ended for _, ended in times.values())
    again, _ = fold(tmp_path, ALL, dict.fromkeys(NODES, "raise SystemExit(1)"), num_workers)
    assert [type(event) for event in again] == [StageSkipped] * len(NODES)


def test_a_gang_of_each_edge_ends_before_the_cloud_begins(tmp_path: Path) -> None:
    scripts = {node.id: meet(tmp_path, [other.id for other in EDGES if other.gang == node.gang]) for node in EDGES if node.gang}
    events, times = fold(tmp_path, EDGES, scripts, num_workers=3)
    assert stages(events, StageDone)[-1] == "cloud"
    assert times["cloud"][0] >= max(ended for node_id, (_, ended) in times.items() if node_id != "cloud")
    spans = [[times[node.id] for node in EDGES if node.gang == gang] for gang in "ab"]
    for span in spans:
        assert max(begun for begun, _ in span) < min(ended for _, ended in span)
    first, second = sorted((min(begun for begun, _ in span), max(ended for _, ended in span)) for span in spans)
    assert first[1] <= second[0], "three workers are no room for two gangs of three"


def test_a_gang_starts_when_all_children_outside_it_are_done_and_all_members_are_prepared(tmp_path: Path) -> None:
    tree = with_gangs(PLAIN, lambda node_id: "g" if node_id in ("edges/a", "devices/a1", "cloud") else None)
    story: list[str] = []
    prepare = preparer(tmp_path, [])

    def tell(node: Tree) -> NodeTask:
        story.append(f"prepare {node.id}")
        return prepare(node)

    def listen(event: Event) -> None:
        story.extend(f"{type(event).__name__} {event.stage}" for event in [event] if isinstance(event, StageStarted | StageDone))

    LocalExecutor(num_workers=2, command=commands({})).fold(tree, tell, listen)
    begun = story.index("prepare devices/a1")
    assert story[begun : begun + 6] == [
        *(f"prepare {name}" for name in ("devices/a1", "edges/a", "cloud")),
        *(f"StageStarted {name}" for name in ("devices/a1", "edges/a", "cloud")),
    ]
    assert {f"StageDone {name}" for name in ("devices/a2", "devices/b1", "devices/b2", "edges/b")} <= set(story[:begun])


def test_a_gang_without_room_waits_until_nothing_else_runs(tmp_path: Path) -> None:
    tree = with_gangs(PLAIN, lambda node_id: "g" if node_id in ("edges/b", "devices/b1", "devices/b2") else None)
    _, times = fold(tmp_path, tree, {"edges/b": meet(tmp_path, ["devices/b1"]), "devices/b1": meet(tmp_path, ["edges/b"])}, num_workers=2)
    begun = min(times[node_id][0] for node_id in ("edges/b", "devices/b1", "devices/b2"))
    assert begun >= max(times[node_id][1] for node_id in ("devices/a1", "devices/a2"))


def test_a_sealed_member_begins_anew_with_the_others_and_one_without_work_does_not(tmp_path: Path) -> None:
    """What one of them began anew the others cannot have finished."""
    prepare = preparer(tmp_path, [])
    for node in ALL:
        if node.id == "devices/a1":
            shutil.copy(prepare(node).folder / "sealed", tmp_path / node.id / SEAL_NAME)
    working = [node_id for node_id in NODES if node_id != "devices/b2"]
    events: list[Event] = []

    executor = LocalExecutor(num_workers=1, command=commands(dict.fromkeys(working, meet(tmp_path, working))))
    times = executor.fold(ALL, lambda node: None if node.id == "devices/b2" else prepare(node), events.append)
    assert not stages(events, StageSkipped) and sorted(stages(events, StageDone)) == sorted(working)
    assert times["devices/b2"].started_s == times["devices/b2"].ended_s


def test_a_member_that_crashes_is_started_again_by_itself_while_the_others_go_on(tmp_path: Path) -> None:
    waits = meet(tmp_path, ["devices/a2"])
    crash = (
        f"import os, pathlib\nif not pathlib.Path('once').exists():\n    pathlib.Path('once').touch()\n    os.kill(os.getpid(), 9)\n{SEAL}"
    )
    scripts = {**dict.fromkeys(NODES, waits), "devices/a2": f"{crash}\npathlib.Path('alive').touch()"}
    events, _ = fold(tmp_path, ALL, scripts, policy=RetryPolicy(max_attempts=2))
    assert Counter(stages(events, StageStarted)) == Counter([*NODES, "devices/a2"])
    assert list(warnings(events)) == ["devices/a2"] and "tried again" in warnings(events)["devices/a2"]
    assert sorted(stages(events, StageDone)) == sorted(NODES)


@pytest.mark.parametrize("seed", range(6))
def test_any_member_may_be_killed_at_any_moment(seed: int, tmp_path: Path) -> None:
    choose = random.Random(seed)
    victim, moment_s = choose.choice(NODES), choose.uniform(0.0, 0.6)
    work = f"import pathlib, time\npathlib.Path('pid').write_text(str(os.getpid()))\ntime.sleep(0.5)\n{meet(tmp_path, NODES)}"
    events: list[Event] = []
    killed: list[int] = []

    def kill() -> None:
        until_s = time.monotonic() + WAIT_S
        while not (pid := (file.read_text() if (file := tmp_path / victim / "pid").exists() else "")) and time.monotonic() < until_s:
            time.sleep(0.005)
        time.sleep(moment_s)
        # It may have ended by now, and its number is not reused so soon.
        try:
            os.kill(int(pid), signal.SIGKILL)
        except ProcessLookupError:
            return
        killed.append(int(pid))

    killer = local.threading.Thread(target=kill)
    killer.start()
    executor = LocalExecutor(num_workers=2, command=commands(dict.fromkeys(NODES, work)), retry_policy=RetryPolicy(max_attempts=2))
    executor.fold(ALL, preparer(tmp_path, []), events.append)
    killer.join()
    assert sorted(stages(events, StageDone)) == sorted(NODES)
    starts = Counter(stages(events, StageStarted))
    assert all(count == 1 for node_id, count in starts.items() if node_id != victim)
    assert starts[victim] == 1 + (victim in warnings(events)) and set(warnings(events)) <= {victim}
    assert killed or not warnings(events)


def test_members_below_an_edge_that_is_given_up_are_stopped_for_it_and_others_go_on(tmp_path: Path) -> None:
    refusal = encode(Failed(stage="edges/a", message="its disk broke.", exit_code=1))
    fails = f"{meet(tmp_path, ['devices/a1', 'devices/a2']).replace(SEAL, '')}\nprint({refusal!r}); raise SystemExit(1)"
    alive = f"import pathlib; pathlib.Path('alive').touch()\n{SLEEP}"
    scripts = {"edges/a": fails, "devices/a1": alive, "devices/a2": alive}
    rest = [node_id for node_id in NODES if node_id not in scripts]
    scripts |= dict.fromkeys(rest, meet(tmp_path, rest))
    given_up: list[str] = []
    policy = RetryPolicy(
        may_fail=lambda node, error: node.tier == "edge",
        max_attempts=3,
        on_given_up=lambda node, begun: given_up.append(node.id),
    )
    begun_s = time.monotonic()
    events, times = fold(tmp_path, ALL, scripts, policy=policy)
    assert time.monotonic() - begun_s < 30, "nobody slept to the end"
    assert sorted(stages(events, StageDone)) == sorted(rest) and set(times) == set(NODES)
    assert warnings(events)["edges/a"] == "its disk broke."
    for device in ("devices/a1", "devices/a2"):
        assert warnings(events)[device] == "it was stopped and given up, since edges/a failed, with which it ran together."
    assert given_up[0] == "edges/a" and sorted(given_up) == ["devices/a1", "devices/a2", "edges/a"]
    assert max(Counter(stages(events, StageStarted)).values()) == 1, "what was stopped is not started again"


def test_all_of_a_gang_end_with_a_cloud_that_crashed_too_often(tmp_path: Path) -> None:
    scripts = dict.fromkeys(NODES, SLEEP) | {"cloud": "import os; os.kill(os.getpid(), 9)"}
    with pytest.raises(StageFailed, match="cloud: its process was killed by signal 9"):
        fold(tmp_path / "a", ALL, scripts, policy=RetryPolicy(max_attempts=2))
    events, _ = fold(tmp_path / "b", ALL, scripts, policy=RetryPolicy(may_fail=lambda node, error: True, max_attempts=2))
    assert stages(events, StageStarted).count("cloud") == 2 and stages(events, StageDone) == []
    assert {node_id for node_id, message in warnings(events).items() if "since cloud failed" in message} == set(NODES) - {"cloud"}


def test_an_edge_outside_the_gang_of_its_devices_stops_none_of_them(tmp_path: Path) -> None:
    tree = with_gangs(PLAIN, lambda node_id: "g" if node_id.startswith("devices/a") else None)
    scripts = {"devices/a1": "raise SystemExit(1)", "devices/a2": meet(tmp_path, ["edges/b"]), "edges/b": f"{meet(tmp_path, [])}"}
    events, _ = fold(tmp_path, tree, scripts, policy=RetryPolicy(may_fail=lambda node, error: True))
    assert list(warnings(events)) == ["devices/a1"] and sorted(stages(events, StageDone)) == sorted(set(NODES) - {"devices/a1"})


def test_a_device_that_is_given_up_stops_nobody(tmp_path: Path) -> None:
    given_up: list[str] = []
    policy = RetryPolicy(
        may_fail=lambda node, error: node.tier == "device", max_attempts=1, on_given_up=lambda node, begun: given_up.append(node.id)
    )
    rest = [node_id for node_id in NODES if node_id != "devices/b1"]
    scripts = {**dict.fromkeys(rest, meet(tmp_path, rest)), "devices/b1": "raise SystemExit(1)"}
    events, _ = fold(tmp_path, ALL, scripts, policy=policy)
    assert given_up == ["devices/b1"] == list(warnings(events)) and sorted(stages(events, StageDone)) == sorted(rest)


@pytest.mark.parametrize(("tree", "num_workers", "threads"), [(ALL, 1, 2), (EDGES, 3, 4), (EDGES, 6, 2)], ids=["all", "edge", "edges"])
def test_devices_of_a_gang_divide_the_cores(
    tree: Tree, num_workers: int, threads: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(local.os, "cpu_count", lambda: 8)
    tell = f"open('told', 'w').write(os.environ['OMP_NUM_THREADS'])\n{SEAL}"
    fold(tmp_path, tree, dict.fromkeys(NODES, tell), num_workers)
    assert {(tmp_path / node_id / "told").read_text() for node_id in NODES if node_id != "cloud"} == {str(threads)}


def test_a_gang_whose_members_would_wait_for_each_other_is_refused(tmp_path: Path) -> None:
    tree = PLAIN.map_ids(lambda node_id: node_id)
    apart = Tree(
        id="cloud",
        tier="cloud",
        gang="g",
        children=(Tree(id="edges/a", tier="edge", children=(with_gangs(tree.children[0].children[0], lambda _: "g"),)),),
    )
    with pytest.raises(BadInput, match="gang 'g' has members below"):
        fold(tmp_path, apart, {})
