"""Nodes that are silent, revoked, late or planned anew, as the executor of a run sees them; by a clock of the test."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from radiant_app.events import Event, StageDone, StageSkipped, Warned
from radiant_app.executors.fold import RetryPolicy
from radiant_app.executors.protocol import NodeTask
from radiant_app.network import executor as network
from radiant_app.network.executor import LEASE_S, NetworkExecutor, Stopped
from radiant_core.aggregate.tree import Tree
from radiant_core.io.run_store import seal
from tests.app.test_network_reception import RUN, World

NODE = Tree(id="edges/north/count", tier="edge")
KEY = "key"


class Conducted:
    """A fold with the edge of a `World` as its one leaf, in a thread; a clock that the test moves."""

    def __init__(self, world: World) -> None:
        self.world, self.now_s, self.events = world, 0.0, list[Event]()
        self.executor = NetworkExecutor(
            hub=world.hub, run=RUN, clock=lambda: self.now_s, retry_policy=RetryPolicy(may_fail=lambda node, error: True)
        )
        world.hub.heard_of = world.reception.heard_of
        world.reception.heard = world.hub.hear
        self.thread = threading.Thread(target=self._fold, daemon=True)

    def _fold(self) -> None:
        task = NodeTask(kind="edge_count", stage=NODE.id, folder=self.world.place, key=KEY)
        tree = Tree(id="count", tier="cloud", children=(NODE,))
        with suppress(Stopped):
            self.executor.fold(tree, lambda node: task if node.id == NODE.id else None, self.events.append)

    def pass_time(self, seconds: float, step_s: float = 4.0, *, asking: bool = False) -> None:
        """Move the clock; the fold looks at it at every step."""
        for _ in range(int(seconds / step_s)):
            if not self.thread.is_alive():
                return
            if asking:
                self.world.reception.heard_of["edges/north"] = self.world.reception.heard_of.get("edges/north", 0) + 1
            self.now_s += step_s
            self.look()

    def look(self) -> None:
        """Wait until the fold has looked twice."""
        for _ in range(2):
            self.looked.clear()
            self.looked.wait(0.5)

    looked = threading.Event()

    def warnings(self) -> list[str]:
        return [event.message for event in self.events if isinstance(event, Warned)]


@pytest.fixture
def conducted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Conducted]:
    monkeypatch.setattr(network, "CHECK_S", 0.0005)
    check = network._Machines._check_leases

    def checked(machines: network._Machines) -> None:
        check(machines)
        Conducted.looked.set()

    monkeypatch.setattr(network._Machines, "_check_leases", checked)
    conducted = Conducted(World(tmp_path))
    conducted.thread.start()
    conducted.look()
    yield conducted
    conducted.executor.stopping.set()
    conducted.thread.join(10)
    assert not conducted.thread.is_alive()


def test_a_node_that_asks_for_nothing_is_given_up_after_its_lease_and_not_before(conducted: Conducted) -> None:
    conducted.pass_time(LEASE_S - 60)
    assert conducted.thread.is_alive() and conducted.warnings() == []
    conducted.pass_time(120)
    conducted.thread.join(5)
    assert conducted.warnings() == ["nothing was heard of it for 15 minutes; --resume waits for it again."]
    assert conducted.world.ask("POST", f"/results/{conducted.world.task.digest}", conducted.world.announcement())[0] == 410


def test_any_request_extends_the_lease(conducted: Conducted) -> None:
    conducted.pass_time(2 * LEASE_S, asking=True)
    assert conducted.thread.is_alive() and conducted.warnings() == []


def test_neither_a_clock_that_is_set_nor_a_sleep_of_this_machine_ends_a_lease(
    conducted: Conducted, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("time.time", lambda: 4e9)
    conducted.now_s += 7 * 24 * 3600
    conducted.pass_time(120)
    assert conducted.thread.is_alive() and conducted.warnings() == []


def test_a_revoked_node_is_given_up_soon(conducted: Conducted) -> None:
    assert conducted.world.store.revoke("edges/north")
    conducted.pass_time(60)
    conducted.thread.join(5)
    assert conducted.warnings() == ["it is revoked; --resume waits for it again."]


def test_what_a_node_made_before_it_was_given_up_is_taken_when_the_run_goes_on(conducted: Conducted) -> None:
    """It comes back a week later: its task is withdrawn, offered again as it was, and what it sends is the result of then."""
    world = conducted.world
    conducted.pass_time(2 * LEASE_S)
    conducted.thread.join(5)
    assert world.ask("POST", f"/results/{world.task.digest}", world.announcement())[0] == 410
    world.report.write_text('{"found": {}, "missing": {}}')
    again = Conducted(world)
    again.thread.start()
    again.look()
    task = world.store.task(world.task.digest)
    assert task is not None and (task.state, task.tries) == ("offered", 2)
    assert world.ask("POST", f"/results/{world.task.digest}", world.announcement())[0] == 200
    assert world.answer(world.part(0, world.report.read_bytes())).status == 200
    again.thread.join(10)
    assert not again.thread.is_alive() and [event.stage for event in again.events if isinstance(event, StageDone)] == [NODE.id]


def test_a_result_for_a_plan_that_was_replaced_is_refused_and_the_new_task_offered(conducted: Conducted) -> None:
    world = conducted.world
    old, announced = world.task, world.announcement()
    (world.place / "task.json").write_text('{"other": 1}')
    new = world.hub.offer(RUN, "edges/north", "edge_count", NODE.id, world.place)
    assert new.attempt == old.attempt + 1
    assert world.ask("POST", f"/results/{old.digest}", announced)[0] == 410 and world.kept() == 0


def test_a_result_that_was_sealed_and_not_said_to_be_is_settled_by_the_next_fold(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.report.write_text('{"found": {}, "missing": {}}')
    world.ask("POST", f"/results/{world.task.digest}", world.announcement())
    world.answer(world.part(0, world.report.read_bytes()))
    seal(world.place, KEY, [*world.hub.install(world.task.digest)])
    after = Conducted(world)
    after.thread.start()
    after.thread.join(10)
    task = world.store.task(world.task.digest)
    assert task is not None and task.state == "accepted"
    assert [type(event) for event in after.events] == [StageSkipped]


def test_a_task_that_is_carried_by_hand_has_no_lease(conducted: Conducted) -> None:
    conducted.world.store.carry(conducted.world.task.digest)
    conducted.pass_time(4 * LEASE_S, 60.0)
    assert conducted.thread.is_alive() and conducted.warnings() == []


def test_a_result_that_another_process_of_this_machine_took_is_found(conducted: Conducted, monkeypatch: pytest.MonkeyPatch) -> None:
    """As `radiant node unpack` does: nothing is said to the process of the run."""
    monkeypatch.setattr(network, "LOOK_S", 0.01)
    world = conducted.world
    world.report.write_text('{"found": {}, "missing": {}}')
    world.reception.heard = lambda said: None
    assert world.ask("POST", f"/results/{world.task.digest}", world.announcement())[0] == 200
    assert world.answer(world.part(0, world.report.read_bytes())).status == 200
    conducted.thread.join(10)
    assert not conducted.thread.is_alive() and [event.stage for event in conducted.events if isinstance(event, StageDone)] == [NODE.id]
