"""Emulated machines that train together: each takes what its speed and its links say in every step, and a wait gives no credit."""

from __future__ import annotations

import json
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from radiant_app.run.groups import prepare_meetings, with_groups
from radiant_app.together import holding, leading, relaying
from radiant_app.together.playing import LINKS, Pace, PlayedMachine, Work, links_variable, play_machine
from radiant_app.workers.nodes import run_node
from radiant_core.io.ply import load_ply
from radiant_core.train.together.roles import Holder, Relay, Root
from tests.contract.test_hierarchy import Oracle, World, assert_same, hamlet_of_two_tiers
from tests.contract.test_together import grouped

NUM_VIEWS = 48  # 8 steps of 6
SPEEDS = {"edge-1-1": 0.2, "edge-1-2": 0.1, "edge-2-1": 0.2, "edge-2-2": 0.1, "edge-1": 0.1, "edge-2": 0.1, "cloud": 1.0}
OF_DEVICE, OF_EDGE = Pace(2e6, 0.02), Pace(1e6, 0.03)


class Clocks:
    """A machine whose time passes as it is told."""

    def __init__(self) -> None:
        self.now_s = self.cpu_s = 0.0

    def work(self, speed: float | None) -> Work:
        return Work(speed, now=lambda: self.now_s, cpu=lambda: self.cpu_s, sleep=self.idle)

    def idle(self, seconds: float) -> None:
        self.now_s += seconds

    def burn(self, seconds: float) -> None:
        self.now_s += seconds
        self.cpu_s += seconds


def test_work_takes_its_cpu_seconds_over_the_speed_and_waiting_gives_no_credit() -> None:
    clocks = Clocks()
    work = clocks.work(0.25)
    clocks.burn(0.2)
    work.settle()
    assert clocks.now_s == pytest.approx(0.8)
    with work.waiting():
        clocks.idle(100.0)
        clocks.burn(0.1)
    clocks.burn(0.3)
    with work.waiting():
        assert clocks.now_s == pytest.approx(0.8 + 100.1 + 1.2), "as if nobody had waited"
    assert (work.cpu_s, work.seconds) == (pytest.approx(0.5), pytest.approx(2.0)), "what is done in a wait is no work"


def test_work_that_others_delay_is_caught_up_with_and_what_is_left_is_counted() -> None:
    """Three pieces of 0.2 s each; something else has the core for 0.3 s during the first."""
    clocks = Clocks()
    work = clocks.work(0.5)
    ends_s = []
    for others_s in (0.3, 0.0, 0.0):
        clocks.burn(0.1)
        clocks.idle(others_s)
        assert work.settle() == pytest.approx(0.2 * (len(ends_s) + 1)), "when it would have been done"
        ends_s.append(clocks.now_s)
    assert ends_s == pytest.approx([0.4, 0.5, 0.6])
    clocks.idle(1.0)
    assert (work.cpu_s, work.seconds) == (pytest.approx(0.3), pytest.approx(1.6))
    with work.waiting():
        clocks.idle(5.0)
    assert work.seconds == pytest.approx(1.6), "a wait is not late"


def test_what_was_due_while_a_machine_was_late_is_there_when_it_was_due() -> None:
    clocks = Clocks()
    work = clocks.work(0.5)
    clocks.idle(3.0)
    with work.waiting(until_s=2.0):
        clocks.burn(0.5)
    clocks.burn(0.25)
    assert work.settle() == pytest.approx(2.5)
    with work.waiting(until_s=9.0):
        clocks.idle(9.0 - clocks.now_s)
    assert work.settle() == pytest.approx(9.0)


def test_who_plays_no_machine_never_sleeps() -> None:
    clocks = Clocks()
    work = clocks.work(None)
    clocks.burn(1.0)
    work.settle()
    assert clocks.now_s == 1.0
    with play_machine() as played:
        assert (played.up, dict(played.down)) == (Pace(), {})


def test_a_process_is_told_of_its_links(monkeypatch: pytest.MonkeyPatch) -> None:
    ((name, value),) = links_variable(Pace(1e6, 0.5), {"a": Pace(None, 0.25)}).items()
    assert name == LINKS and json.loads(value)
    monkeypatch.setenv(name, value)
    with play_machine() as played:
        assert played.up == Pace(1e6, 0.5) and dict(played.down) == {"a": Pace(None, 0.25)}


Pieces = dict[str, list[tuple[float, int]]]
"""Method and machine → CPU seconds of each call, and bytes of what it made."""


def recorded(monkeypatch: pytest.MonkeyPatch, works: dict[str, Work]) -> tuple[Pieces, list[float]]:
    """What machines do in their steps from now on, and when the root began each sum, by its own time."""
    pieces, begun_s = defaultdict(list[tuple[float, int]]), list[float]()

    def record(role: type, method: str) -> None:
        inner: Callable = getattr(role, method)

        def outer(*arguments: object) -> object:
            if method == "total":
                begun_s.append(works["cloud"].settle())
                assert begun_s[-1] <= time.monotonic(), "never early"
            cpu_s = time.thread_time()
            made = inner(*arguments)
            data = made[0] if isinstance(made, tuple) else made
            pieces[f"{method} {threading.current_thread().name}"].append((time.thread_time() - cpu_s, len(data or b"")))
            return made

        monkeypatch.setattr(role, method, outer)

    for role, method in ((Holder, "message"), (Holder, "take"), (Relay, "message"), (Root, "total")):
        record(role, method)
    return pieces, begun_s


def play(world: World, run: Path, monkeypatch: pytest.MonkeyPatch, works: dict[str, Work]) -> Path:
    """Every machine of the group as a thread, whose CPU time is its own; the cloud's folder."""

    @contextmanager
    def machine_of_thread() -> Iterator[PlayedMachine]:
        name = threading.current_thread().name
        works[name] = Work(SPEEDS[name], cpu=time.thread_time)
        down = {f"edge-{edge}": OF_EDGE for edge in (1, 2)} | {f"{name}-{device}": OF_DEVICE for device in (1, 2)}
        yield PlayedMachine(work=works[name], up=OF_DEVICE if name.count("-") == 2 else OF_EDGE, down=down)

    for module in (holding, relaying, leading):
        monkeypatch.setattr(module, "play_machine", machine_of_thread)
    dealer = world.dealer(run)
    prepare_meetings(run, world.recipe)
    tasks = {node.name: dealer.prepare(node) for node in with_groups(world.tree, world.recipe.groups)}
    threads = [
        threading.Thread(target=run_node, args=(task.kind, task.folder, task.stage, lambda event: None), name=name, daemon=True)
        for name, task in tasks.items()
        if task is not None
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(120.0)
    return run / "cloud"


def step_s(pieces: Pieces, devices: dict[str, list[str]], step: int) -> float:
    """From one sum of the root to the next: devices learn from the last total and contribute, edges add up, the root does."""
    at_root_s, total = 0.0, pieces["total cloud"][step][1]
    for edge, names in devices.items():
        at_edge_s = 0.0
        for name in names:
            (took_s, _), (made_s, sent) = pieces[f"take {name}"][step], pieces[f"message {name}"][step + 1]
            at_edge_s = max(at_edge_s, (took_s + made_s) / SPEEDS[name] + sent / 2e6 + 0.02)
        added_s, sent = pieces[f"message {edge}"][step + 1]
        at_root_s = max(at_root_s, at_edge_s + added_s / SPEEDS[edge] + sent / 1e6 + 0.03)
    down_s = total / 1e6 + 0.03 + total / 2e6 + 0.02
    return pieces["total cloud"][step][0] + down_s + at_root_s


def test_steps_of_the_hamlet_take_what_speeds_and_links_say_and_make_the_same_model(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "world").mkdir()
    world = hamlet_of_two_tiers(tmp_path / "world")
    world = World(photographs=world.photographs, recipe=grouped(world.recipe, ("cloud",), num_steps=NUM_VIEWS))
    oracle = Oracle(world)
    works = dict[str, Work]()
    pieces, begun_s = recorded(monkeypatch, works)
    cloud = play(world, tmp_path / "run", monkeypatch, works)
    assert_same(oracle.run.joined.splats, load_ply(cloud / "scene.ply"))
    steps = range(len(begun_s) - 1)
    assert len(steps) >= 5
    devices = {f"edge-{edge}": [f"edge-{edge}-{device}" for device in (1, 2)] for edge in (1, 2)}
    foretold_s = sum(step_s(pieces, devices, step) for step in steps)
    # What is around these pieces, and waits for no core: packing, and headers of messages.
    assert begun_s[-1] - begun_s[0] == pytest.approx(foretold_s, rel=0.1)
