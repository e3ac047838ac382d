"""Devices that train as one model, in one process, as local processes and on Ray: the same scene bit for bit, also where one is killed."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from radiant_app.events import Event, StageProgress, Warned
from radiant_app.executors.fold import RetryPolicy
from radiant_app.executors.local import LocalExecutor
from radiant_app.executors.protocol import Executor, NodeTask
from radiant_app.executors.ray_cluster import RayExecutor
from radiant_app.files.system_file import even_system
from radiant_app.run.groups import end_groups, prepare_meetings, with_groups
from radiant_core.aggregate.config import AggregateConfig, Join, Refine
from radiant_core.errors import StageFailed
from radiant_core.hierarchy.groups import GroupTraining
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.io.ply import load_ply
from radiant_core.io.run_store import read_json
from tests.contract.test_hierarchy import Oracle, World, assert_same, ground, hamlet_of_two_tiers
from tests.forked_workers import forked_workers

NUM_SHOWN = 240
"""Photographs that a group trains on, some 40 steps: a training goes on after three machines were killed."""


def grouped(recipe: Recipe, roots: tuple[str, ...], **changes: object) -> Recipe:
    """The recipe whose devices below these roots train as one model, the first of each edge with two views a step."""
    groups = {}
    for root in roots:
        plans = [plan for plan in recipe.edge_plans if root in ("cloud", f"edges/{plan.edge_id}")]
        views = {
            plan.edge_id: {device: 1 + (index == 0) for index, device in enumerate(plan.device_ids) if len(plan.cameras_of(device))}
            for plan in plans
        }
        groups[root] = replace(GroupTraining(root=root, views=views, num_steps=NUM_SHOWN), **changes)
    return replace(recipe, groups=groups)


def all_of_the_hamlet(folder: Path) -> World:
    """Two edges of two devices each, all of which train one model."""
    world = hamlet_of_two_tiers(folder)
    return replace(world, recipe=grouped(world.recipe, ("cloud",)))


def overlapping_hamlet(folder: Path) -> World:
    """The same, and devices render for the next step while the sum of this one is on its way."""
    world = hamlet_of_two_tiers(folder)
    return replace(world, recipe=grouped(world.recipe, ("cloud",), overlaps=True, form="blocks"))


def overlapping_ground(folder: Path) -> World:
    """One edge of two devices, which render for the next step while the sum of this one is on its way; 8 bits."""
    world = ground(folder, even_system(1, 2), AggregateConfig(edge=Join(epochs=1), refine=Refine(epochs=0)))
    return replace(world, recipe=grouped(world.recipe, ("edges/edge-1",), overlaps=True, form="blocks"))


def one_edge_of_two(folder: Path) -> World:
    """Two edges, of which one trains a model with its devices; the cloud joins and devices refine."""
    world = ground(folder, even_system(2, 2), AggregateConfig(cloud=Join(epochs=1), edge=Join(epochs=1), refine=Refine(epochs=1, rounds=1)))
    return replace(world, recipe=grouped(world.recipe, ("edges/edge-1",)))


def masked_hamlet(folder: Path) -> World:
    """Two edges of two devices each that train one model; each edge sums under masks."""
    world = hamlet_of_two_tiers(folder)
    return replace(world, recipe=grouped(world.recipe, ("cloud",), masked=True))


def masked_ground(folder: Path) -> World:
    """One edge of three devices that sums under masks, while they render for the next step."""
    world = ground(folder, even_system(1, 3), AggregateConfig(edge=Join(epochs=1), refine=Refine(epochs=0)))
    return replace(world, recipe=grouped(world.recipe, ("edges/edge-1",), overlaps=True, masked=True))


Command = Callable[[NodeTask], list[str]]
STEPS = 3
WORLDS: dict[str, Callable[[Path], World]] = {
    "all of the hamlet": all_of_the_hamlet,
    "overlapping hamlet": overlapping_hamlet,
    "overlapping ground": overlapping_ground,
    "one edge of two": one_edge_of_two,
    "masked hamlet": masked_hamlet,
    "masked ground": masked_ground,
}


@pytest.fixture(scope="module")
def worlds(tmp_path_factory: pytest.TempPathFactory) -> dict[str, World]:
    return {name: world_of(tmp_path_factory.mktemp("world")) for name, world_of in WORLDS.items()}


@pytest.fixture(scope="module")
def oracle(worlds: dict[str, World]) -> dict[str, Oracle]:
    return {name: Oracle(world) for name, world in worlds.items()}


@pytest.fixture(scope="module")
def command(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Command]:
    with forked_workers(tmp_path_factory.mktemp("server")) as start:
        yield start


@pytest.fixture(scope="module")
def telling(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Command]:
    """Workers that tell of every step."""
    with forked_workers(tmp_path_factory.mktemp("server"), "tests.contract.telling_worker") as start:
        yield start


def fold(world: World, run: Path, executor: Executor, listen: Callable[[Event], None] = lambda event: None) -> Path:
    """Fold the tree of a world in a folder; the cloud's folder."""
    dealer = world.dealer(run)
    prepare_meetings(run, world.recipe)
    executor.fold(with_groups(world.tree, world.recipe.groups), dealer.prepare, listen)
    end_groups(run, world.recipe)
    return run / "cloud"


# Ray starts the same processes, whose links are their own: one world with relays is enough.
@pytest.mark.parametrize(("name", "kind"), [*((name, "local") for name in WORLDS), ("overlapping hamlet", "ray")])
def test_processes_make_the_model_of_the_fold_in_one_process(
    name: str,
    kind: str,
    request: pytest.FixtureRequest,
    worlds: dict[str, World],
    oracle: dict[str, Oracle],
    command: Command,
    tmp_path: Path,
) -> None:
    executor: Executor = LocalExecutor(num_workers=2, command=command)
    if kind == "ray":
        executor = RayExecutor(address=request.getfixturevalue("address"), log=tmp_path / "ray.log", command=command)
    cloud = fold(worlds[name], tmp_path / "run", executor)
    joined = oracle[name].run.joined.splats
    assert joined is not None and len(joined) > 100
    assert_same(joined, load_ply(cloud / "scene.ply"))
    for root, trained in oracle[name].run.groups.items():
        summary = read_json(tmp_path / "run" / root / "summary.json")
        assert summary["num_steps"] == trained.result.num_steps and summary["num_refused"] == 0
        assert summary["received_bytes"] > sum(map(sum, (trained.cost.bytes_up[name] for name in trained.plan.of_senders)))
        ours = [(one.topic, one.choice, one.figure) for one in oracle[name].recorders[root].decisions]
        theirs = [(one["topic"], one["choice"], one["figure"]) for one in read_json(tmp_path / "run" / root / "notes.json")["decisions"]]
        assert ours == theirs


@dataclass
class Kills:
    """A listener of a fold that kills machines of a group in turn, the root as the last: each once the root has gone on by
    `STEPS` since the one before it was started again."""

    run: Path
    root: str
    victims: tuple[str, ...]
    killed: list[str] = field(default_factory=list)
    warned: list[str] = field(default_factory=list)
    furthest: float = 0.0
    """Step of the root when the last victim was started again, which its group had to wait for."""

    @property
    def num_back(self) -> int:
        """Victims that were started again."""
        return sum("tried again" in message for message in self.warned)

    def __call__(self, event: Event) -> None:
        if isinstance(event, Warned):
            self.warned.append(event.message)
        if not isinstance(event, StageProgress) or event.stage != self.root:
            return
        if self.num_back < len(self.killed):
            self.furthest = event.done
        elif event.done >= self.furthest + STEPS and len(self.killed) < len(self.victims):
            self.furthest = event.done
            self.killed.append(self.victims[len(self.killed)])
            for pid in pids_of(self.run / self.killed[-1]):
                os.kill(pid, signal.SIGKILL)


@pytest.mark.parametrize(
    ("name", "victims"),
    [
        pytest.param("all of the hamlet", ("devices/edge-1-1", "edges/edge-2", "cloud"), marks=pytest.mark.stress),
        ("overlapping hamlet", ("devices/edge-1-1", "edges/edge-2", "cloud")),
        pytest.param("masked hamlet", ("devices/edge-1-1", "edges/edge-2", "cloud"), marks=pytest.mark.stress),
        ("masked ground", ("devices/edge-1-2", "edges/edge-1")),
    ],
)
def test_machines_that_are_killed_one_after_another_come_back_and_nothing_changes(
    name: str, victims: tuple[str, ...], worlds: dict[str, World], oracle: dict[str, Oracle], telling: Command, tmp_path: Path
) -> None:
    """Under masks all of the sum of the one that came back begin anew."""
    world, ((root, trained),) = worlds[name], oracle[name].run.groups.items()
    kills = Kills(run=tmp_path / "run", root=root, victims=victims)
    executor = LocalExecutor(num_workers=2, command=telling, retry_policy=RetryPolicy(max_attempts=4))
    cloud = fold(world, tmp_path / "run", executor, kills)
    assert_same(oracle[name].run.scene.splats, load_ply(cloud / "scene.ply"))
    assert tuple(kills.killed) == victims and kills.num_back == len(victims), kills.warned
    summary = read_json(tmp_path / "run" / root / "summary.json")
    # The sum of keys that do not fit each other is noise, and refused.
    assert (summary["num_steps"], summary["num_refused"]) == (trained.result.num_steps, 0)
    assert all(read_json(path)["num_refused"] == 0 for path in (tmp_path / "run").glob("edges/*/summary.json"))
    if trained.plan.masked:
        assert any("it came back with a new key" in message for message in kills.warned), kills.warned


def test_a_masked_training_stops_without_one_of_its_devices_and_resumes_with_it(
    worlds: dict[str, World], command: Command, tmp_path: Path
) -> None:
    world, run, killed = worlds["masked ground"], tmp_path / "run", threading.Event()

    def listen(event: Event) -> None:
        if isinstance(event, StageProgress) and event.stage == "edges/edge-1" and event.done >= 3 and not killed.is_set():
            killed.set()
            for pid in pids_of(run / "devices" / "edge-1-3"):
                os.kill(pid, signal.SIGKILL)

    from radiant_app.run.groups import tell_parents

    gone = tell_parents(run, world.recipe, lambda node, begun: None)
    policy = RetryPolicy(may_fail=lambda node, error: node.tier == "device", on_given_up=gone)
    dealer, tree = world.dealer(run), with_groups(world.tree, world.recipe.groups)
    prepare_meetings(run, world.recipe)
    with pytest.raises(StageFailed, match="a masked training cannot go on without edge-1-3"):
        LocalExecutor(num_workers=2, command=command, retry_policy=policy).fold(tree, dealer.prepare, listen)
    assert killed.is_set() and not (run / "cloud" / "scene.ply").exists()
    prepare_meetings(run, world.recipe)
    LocalExecutor(num_workers=2, command=command).fold(tree, dealer.prepare, lambda event: None)
    assert len(load_ply(run / "cloud" / "scene.ply")) > 100
    assert read_json(run / "edges" / "edge-1" / "summary.json")["num_refused"] == 0


def pids_of(folder: Path) -> list[int]:
    """The processes whose command names a folder."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and int(entry.name) != os.getpid():
            try:
                words = (entry / "cmdline").read_bytes().split(b"\0")
            except OSError:
                continue
            if str(folder).encode() in words:
                found.append(int(entry.name))
    return found


def test_a_device_that_never_comes_is_named_and_the_others_train(worlds: dict[str, World], command: Command, tmp_path: Path) -> None:
    world, warned = worlds["all of the hamlet"], list[str]()
    dead = "devices/edge-2-2"

    def broken(task: NodeTask) -> list[str]:
        return ["false"] if task.stage == dead else command(task)

    def listen(event: Event) -> None:
        if isinstance(event, Warned):
            warned.append(event.message)

    from radiant_app.run.groups import tell_parents

    gone = tell_parents(tmp_path / "run", world.recipe, lambda node, begun: None)
    policy = RetryPolicy(may_fail=lambda node, error: node.tier == "device", on_given_up=gone)
    begun_s = time.monotonic()
    cloud = fold(world, tmp_path / "run", LocalExecutor(num_workers=2, command=broken, retry_policy=policy), listen)
    assert any("steps go on without edge-2-2" in message for message in warned), warned
    assert len(load_ply(cloud / "scene.ply")) > 100 and time.monotonic() - begun_s < 120
