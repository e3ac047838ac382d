"""Any order of cuts, duplicates, restarts, withdrawals and full disks gives the bytes that were announced, or a refusal."""

from __future__ import annotations

import random
from pathlib import Path
from unittest.mock import patch

from hypothesis import given, settings
from hypothesis import strategies as st

from radiant_app.network.arrivals import SPARE_BYTES
from radiant_app.network.hub import Hub
from radiant_app.network.reception import HttpRequest, Reception
from radiant_app.network.store import HubStore
from radiant_core.io.transport.delivery import describe_files
from tests.app.test_network_reception import World
from tests.memory_folder import memory_folder

SIZE = 5000
DATA = random.Random(1).randbytes(SIZE)
offsets, lengths = st.integers(0, SIZE), st.integers(0, SIZE)
ACTIONS = st.one_of(
    st.tuples(st.just("announce"), st.booleans()),
    st.tuples(st.just("part"), offsets, lengths, st.booleans()),
    st.tuples(st.just("next part"), lengths, st.booleans()),
    st.tuples(st.just("repeat"), st.integers(0, 5)),
    st.tuples(st.sampled_from(["cut", "restart", "withdraw", "offer", "full disk", "end in the middle of installing"])),
)


class Story:
    """One hub and one node, and whatever happens between them."""

    def __init__(self, folder: Path) -> None:
        self.world = world = World(folder)
        world.report.write_bytes(DATA)
        self.other = folder / "other.json"
        self.other.write_bytes(DATA[::-1])
        self.sent: list[HttpRequest] = []
        self.announced = DATA

    def do(self, action: tuple) -> None:
        getattr(self, action[0].replace(" ", "_"))(*action[1:])
        received = self.world.store.task(self.world.task.digest)
        assert received is not None
        if received.state == "received":
            assert self.world.arrivals.num_bytes(self.world.task.digest) in (0, SIZE)

    def ask(self, asked: HttpRequest) -> int:
        self.sent.append(asked)
        return self.world.answer(asked).status

    def announce(self, other: bool = False) -> int:
        file = self.other if other else self.world.report
        announced = self.world.announcement(files=describe_files({"report.json": file}))
        status = self.ask(self.world.sealed("POST", f"/results/{self.world.task.digest}", announced))
        self.announced = file.read_bytes() if status == 200 else self.announced
        return status

    def part(self, offset: int, length: int, wrong: bool) -> int:
        data = self.announced[offset : offset + length]
        return self.ask(self.world.part(offset, bytes(len(data)) if wrong else data))

    def next_part(self, length: int, wrong: bool) -> int:
        return self.part(self.world.arrivals.num_bytes(self.world.task.digest), length, wrong)

    def repeat(self, back: int) -> None:
        if back < len(self.sent):
            assert self.world.answer(self.sent[-1 - back]).status >= 400, "a replay"

    def cut(self) -> None:
        """The head of a request came, its body never did."""
        asked = self.world.part(0, self.announced)
        self.world.reception.admit(asked)

    def restart(self) -> None:
        world = self.world
        world.store.close()
        world.store = HubStore(folder=world.store.folder)
        world.arrivals.remove_all_but(world.store.open_digests())
        world.reception = Reception(node="cloud", key=world.home.key, store=world.store, arrivals=world.arrivals, heard=world.heard.append)
        world.hub = Hub(home=world.home, store=world.store, arrivals=world.arrivals)

    def withdraw(self) -> None:
        self.world.hub.withdraw(self.world.task.digest)

    def offer(self) -> None:
        task = self.world.task
        assert self.world.hub.offer(task.run, task.node, "edge_count", task.stage, task.folder).digest == task.digest

    def full_disk(self) -> None:
        with patch("shutil.disk_usage", lambda folder: type("Usage", (), {"free": SPARE_BYTES // 4})):
            before = self.world.kept()
            assert self.announce() in (200, 409, 410, 507)
            assert self.next_part(100, False) != 200 or self.world.kept() == before

    def end_in_the_middle_of_installing(self) -> None:
        task = self.world.store.task(self.world.task.digest)
        if task is not None and task.state == "received":
            self.world.hub.install(task.digest)
            assert (task.folder / "report.json").read_bytes() == self.announced
        self.restart()

    def finish(self) -> None:
        """What an honest node and conductor do once both are there."""
        self.offer()
        status = self.announce()
        if status == 409:
            return  # what was received first is another result of the node's own making
        assert status == 200
        for _ in range(3):
            while self.world.arrivals.num_bytes(self.world.task.digest) < SIZE and not self.is_received():
                assert self.next_part(2000, False) == 200
        assert self.is_received()
        self.world.hub.install(self.world.task.digest)
        assert (self.world.place / "report.json").read_bytes() == DATA

    def is_received(self) -> bool:
        task = self.world.store.task(self.world.task.digest)
        return task is not None and task.state == "received"


@settings(max_examples=80, deadline=None)
@given(actions=st.lists(ACTIONS, max_size=25))
def test_any_order_gives_the_same_bytes_or_a_refusal(actions: list[tuple]) -> None:
    with memory_folder() as folder:
        story = Story(folder)
        try:
            for action in actions:
                story.do(action)
            story.finish()
        finally:
            story.world.store.close()
