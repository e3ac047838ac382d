"""Room on a node's disk: who announces without sending keeps nobody from sending, and results that fit one after
another never fill the disk with halves of all."""

from __future__ import annotations

import random

import pytest

from radiant_app.network.promises import PROMISE_S, RENEWED_BYTES, Arriving, Promises

MB = 10**6


class Disk:
    """A disk with so much room, members that announce to it and send parts, as the reception asks for both."""

    def __init__(self, free: int) -> None:
        self.free, self.now_s = free, 0.0
        self.promises = Promises(clock=lambda: self.now_s)
        self.arriving: dict[str, Arriving] = {}

    def announce(self, task: str, member: str, num_bytes: int) -> bool:
        known = self.arriving.get(task)
        missing = num_bytes - (known.arrived_bytes if known else 0)
        if self.free < missing + self.promises.reserved_bytes(task, member, [*self.arriving.values()], self.free):
            return False
        self.promises.announced(task, num_bytes - missing)
        self.arriving[task] = known or Arriving(task=task, member=member, num_bytes=num_bytes, arrived_bytes=0)
        return True

    def send(self, task: str, num_bytes: int) -> bool:
        before = self.arriving[task]
        part = min(num_bytes, before.missing_bytes)
        if self.free < part or not self.promises.may_grow(task, part, [*self.arriving.values()], self.free):
            return False
        self.free -= part
        self.arriving[task] = before.grown(part)
        self.promises.arrived(task, before.arrived_bytes + part)
        return True

    def is_whole(self, task: str) -> bool:
        return not self.arriving[task].missing_bytes

    def take(self, task: str) -> None:
        """The conductor moves a whole result to another disk."""
        self.free += self.arriving.pop(task).arrived_bytes
        self.promises.forget_all_but([*self.arriving.values()])


def test_an_announcement_of_nearly_all_keeps_no_other_member_out() -> None:
    disk = Disk(336 * MB)
    assert disk.announce("big", "edges/north", 329 * MB)
    assert disk.announce("small", "edges/south", 20 * MB), "half of the room is for each of two"
    for _ in range(5):
        assert disk.send("small", 4 * MB)
    assert disk.is_whole("small")


def test_what_a_member_was_promised_is_kept_while_it_sends_and_lapses_when_it_does_not() -> None:
    disk = Disk(100 * MB)
    assert disk.announce("first", "edges/north", 45 * MB)
    assert not disk.announce("second", "edges/south", 60 * MB), "together they do not fit"
    for _ in range(5):
        disk.now_s += 0.9 * PROMISE_S
        assert disk.send("first", MB)
        assert not disk.announce("second", "edges/south", 60 * MB)
    disk.now_s += 1.1 * PROMISE_S
    assert disk.announce("second", "edges/south", 60 * MB)


@pytest.mark.parametrize("drip_bytes", [0, 1, RENEWED_BYTES // 1000])
def test_neither_repeating_an_announcement_nor_dripping_keeps_it_alive(drip_bytes: int) -> None:
    disk = Disk(100 * MB)
    assert disk.announce("idle", "edges/north", 45 * MB)
    for _ in range(10):
        disk.now_s += PROMISE_S / 8
        assert disk.announce("idle", "edges/north", 45 * MB)
        assert drip_bytes == 0 or disk.send("idle", drip_bytes)
    assert disk.announce("second", "edges/south", 60 * MB)


def test_who_comes_back_after_a_lapse_goes_on() -> None:
    disk = Disk(100 * MB)
    assert disk.announce("first", "edges/north", 45 * MB) and disk.send("first", 10 * MB)
    disk.now_s += 10 * PROMISE_S
    assert disk.send("first", 4 * MB) and disk.announce("first", "edges/north", 45 * MB)


@pytest.mark.parametrize("seed", range(40))
def test_results_that_each_fit_arrive_all_whoever_is_how_fast(seed: int) -> None:
    """Members that were let in send by turns in any order; whatever is whole is taken away. One that never sends is among them."""
    rng = random.Random(seed)
    disk = Disk(100 * MB)
    sizes = {f"task {number}": rng.randrange(5, 95) * MB for number in range(6)}
    disk.announce("idle", "edges/idle", 90 * MB)
    waiting, steps = dict(sizes), 0
    while waiting:
        steps += 1
        assert steps < 20_000, f"nothing goes on: {disk.arriving}"
        disk.now_s += 1.0
        task = rng.choice(sorted(waiting))
        if task not in disk.arriving:
            disk.announce(task, f"edges/{task[-1]}", sizes[task])
        elif disk.send(task, 4 * MB) and disk.is_whole(task):
            disk.take(task)
            del waiting[task]
    assert disk.free == 100 * MB
