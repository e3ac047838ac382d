"""Nodes of a gang on Ray: all at once on fewer CPUs than members, each where its machine is named,
started again by itself, and the places are free afterwards.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest

from radiant_app.events import Event, StageDone, StageStarted, Warned
from radiant_app.executors.fold import RetryPolicy
from radiant_app.executors.protocol import NodeTask
from radiant_app.executors.ray_cluster import RayExecutor
from radiant_core.aggregate.tree import Tree, with_gangs
from tests.contract.ray_machines import Cluster, ray_cluster
from tests.contract.test_executors import SEAL, preparer

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
WAIT_S = 180.0


def meet(run: Path, tree: Tree, node: Tree, before: str = "") -> str:
    """A script that ends once all of the node's gang are there."""
    others = [other.id for other in tree if other.gang == node.gang] if node.gang else []
    return f"""
import os, pathlib, sys, threading, time
# As a worker, it ends with its machine.
threading.Thread(target=lambda: (sys.stdin.read(), os._exit(1)), daemon=True).start()
pathlib.Path('pid').write_text(str(os.getpid()))
{before}
pathlib.Path('alive').touch()
until_s = time.monotonic() + {WAIT_S}
while not all((pathlib.Path({str(run)!r}) / other / 'alive').exists() for other in {others!r}):
    if time.monotonic() > until_s: raise SystemExit('alone')
    time.sleep(0.05)
{SEAL}
"""


def fold(
    run: Path, address: str, tree: Tree, befores: dict[str, str] | None = None, listen: Callable[[Event], None] = lambda event: None
) -> tuple[list[Event], dict[str, tuple[float, float]]]:
    """The events of a fold, and when each node began and ended."""
    scripts = {node.id: meet(run, tree, node, (befores or {}).get(node.id, "")) for node in tree}

    def command(task: NodeTask) -> list[str]:
        return [sys.executable, "-S", "-c", f"import os; os.chdir({str(task.folder)!r})\n{scripts[task.stage]}"]

    events: list[Event] = []

    def tell(event: Event) -> None:
        events.append(event)
        listen(event)

    executor = RayExecutor(address=address, log=run / "ray.log", command=command, retry_policy=RetryPolicy(max_attempts=3))
    times = executor.fold(tree, preparer(run, []), tell)
    assert {event.stage for event in events if isinstance(event, StageDone)} == {node.id for node in tree}
    return events, {node_id: (each.started_s, each.ended_s) for node_id, each in times.items()}


def test_seven_members_run_at_once_on_two_cpus_one_that_is_killed_starts_again_and_a_second_fold_has_the_places_again(
    address: str, tmp_path: Path
) -> None:
    once = "if not pathlib.Path('once').exists():\n    pathlib.Path('once').touch()\n    time.sleep(0.5)\n    os.kill(os.getpid(), 9)"
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
    events, times = fold(tmp_path / "one", address, ALL, {"devices/b1": once})
    assert max(begun for begun, _ in times.values()) < min(ended for _, ended in times.values())
    starts = Counter(event.stage for event in events if isinstance(event, StageStarted))
    assert starts == Counter([*NODES, "devices/b1"])
    (warning,) = (event for event in events if isinstance(event, Warned))
    assert warning.stage == "devices/b1" and "killed by signal 9" in warning.message
    # Gangs of two edges, and then the cloud.
    _, times = fold(tmp_path / "two", address, EDGES)
    for gang in "ab":
        span = [times[node.id] for node in EDGES if node.gang == gang]
        assert max(begun for begun, _ in span) < min(ended for _, ended in span)
    assert times["cloud"][0] >= max(ended for node_id, (_, ended) in times.items() if node_id != "cloud")


def test_two_members_meet_on_a_cluster_of_this_machine_alone(tmp_path: Path) -> None:
    if find_spec("ray") is None:
        pytest.skip("Ray is not installed: the extra `cluster` brings it")
    pair = Tree(id="edges/x", tier="edge", gang="x", children=(Tree(id="devices/x1", tier="device", gang="x"),))
    _, times = fold(tmp_path, "local", pair)
    assert times["edges/x"][0] < times["devices/x1"][1] and times["devices/x1"][0] < times["edges/x"][1]


@pytest.fixture
def machines() -> Iterator[Cluster]:
    if find_spec("ray") is None:
        pytest.skip("Ray is not installed: the extra `cluster` brings it")
    with ray_cluster() as cluster:
        cluster.start("head", num_cpus=1, offers=["device:a2", "edge:a"])
        cluster.start("one", num_cpus=1, offers=["device:a1"])
        yield cluster


@pytest.mark.stress
def test_members_whose_machine_dies_go_on_elsewhere_while_the_others_wait(machines: Cluster, tmp_path: Path) -> None:
    killed_s: list[float] = []
    started: set[str] = set()
    # The killed device meets the others only in its second life.
    held = "if not pathlib.Path('once').exists():\n    pathlib.Path('once').touch()\n    time.sleep(300)"

    def listen(event: Event) -> None:
        if isinstance(event, StageStarted):
            started.add(event.stage)
        if started == set(NODES) and not killed_s:
            until_s = time.monotonic() + WAIT_S
            while not (tmp_path / "devices/a1/once").exists() and time.monotonic() < until_s:
                time.sleep(0.05)
            machines.kill("one")
            killed_s.append(time.monotonic())

    events, _ = fold(tmp_path, machines.address, ALL, {"devices/a1": held}, listen)
    assert killed_s, "the machine died while its members ran"
    warned = {event.stage for event in events if isinstance(event, Warned)}
    starts = Counter(event.stage for event in events if isinstance(event, StageStarted))
    assert not [event for event in events if isinstance(event, Warned) and "waited" in event.message], "nobody waits for a lost machine"
    assert "devices/a1" in warned and all(starts[node_id] == 1 for node_id in set(NODES) - warned)
    print(f"gone on {time.monotonic() - killed_s[0]:.0f} s later; again: {sorted(warned)}")
