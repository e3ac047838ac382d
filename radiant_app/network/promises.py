"""How much room of a node's disk is kept for results that were announced and are not there yet. Per
announcement and part.

    budget     what is free and what has arrived of results that go on to arrive
    share      budget / number of members that such results are of
    kept(m)    min(announced − arrived, share − arrived of m), of announcements that are alive

An announcement needs room beside what is kept for other members, so that one member's keep nobody
out. Of those that were let in a part is taken where, after it, its result can still be finished:
now, or when others are that can be, and have been taken away (the banker's algorithm, Dijkstra
1965). So a disk is never filled with halves of all.

An announcement is alive for `PROMISE_S` from when it was first made, and from each `RENEWED_BYTES`
that arrived since; repeating it changes nothing.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

PROMISE_S = 120.0
"""So long room is kept for a result of which nothing arrives."""
RENEWED_BYTES = 1 << 18
"""So much has to arrive that it is kept for as long again: 2 kB/s."""


@dataclass(frozen=True, kw_only=True)
class Arriving:
    """A result that was announced and is not whole."""

    task: str
    member: str
    num_bytes: int
    arrived_bytes: int

    @property
    def missing_bytes(self) -> int:
        """What is still to come."""
        return max(0, self.num_bytes - self.arrived_bytes)

    def grown(self, num_bytes: int) -> Arriving:
        """The same with so many bytes more."""
        return replace(self, arrived_bytes=self.arrived_bytes + num_bytes)


@dataclass(kw_only=True)
class _Promise:
    since_s: float
    counted_bytes: int = 0
    """Of what arrived, those that have renewed it."""


@dataclass(kw_only=True)
class Promises:
    """Which announcements are alive, as far as this process has seen them."""

    clock: Callable[[], float] = time.monotonic
    _alive: dict[str, _Promise] = field(default_factory=dict)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def announced(self, task: str, arrived_bytes: int) -> None:
        """A result was announced, of which so much is there; again: nothing."""
        with self._lock:
            self._alive.setdefault(task, _Promise(since_s=self.clock(), counted_bytes=arrived_bytes))

    def arrived(self, task: str, arrived_bytes: int) -> None:
        """So much of a result is there now."""
        with self._lock:
            promise = self._alive.setdefault(task, _Promise(since_s=self.clock(), counted_bytes=arrived_bytes))
            # Fewer than before: they were others than announced, and are to come once more.
            promise.counted_bytes = min(promise.counted_bytes, arrived_bytes)
            if arrived_bytes - promise.counted_bytes >= RENEWED_BYTES:
                promise.since_s, promise.counted_bytes = self.clock(), arrived_bytes

    def forget_all_but(self, tasks: Sequence[Arriving]) -> None:
        """Only these are arriving."""
        with self._lock:
            for task in {*self._alive} - {result.task for result in tasks}:
                del self._alive[task]

    def reserved_bytes(self, task: str, member: str, arriving: Sequence[Arriving], free_bytes: int) -> int:
        """Bytes to leave free beside all that is missing of a result that is announced; other
        results of the same member count in full, which is its own concern."""
        promised_bytes = self._promised(member, [result for result in arriving if result.task != task])
        return promised_bytes + self._kept_for_others(member, arriving, free_bytes)

    def may_grow(self, task: str, num_bytes: int, arriving: Sequence[Arriving], free_bytes: int) -> bool:
        """Whether a result may take so many bytes more: it, and those that are alive, can be
        finished one after another from what is then free."""
        grown = [
            result.grown(num_bytes) if result.task == task else result
            for result in arriving
            if result.task == task or self._is_alive(result.task)
        ]
        free_bytes -= num_bytes
        for result in sorted(grown, key=lambda result: result.missing_bytes):
            if result.missing_bytes > free_bytes:
                return False
            if result.task == task:
                return True
            free_bytes += result.arrived_bytes
        return free_bytes >= 0

    def _kept_for_others(self, member: str, arriving: Sequence[Arriving], free_bytes: int) -> int:
        share = _share(member, arriving, free_bytes)
        others = {result.member for result in arriving} - {member}
        return sum(min(self._promised(other_member, arriving), max(0, share - _arrived(other_member, arriving))) for other_member in others)

    def _promised(self, member: str, arriving: Sequence[Arriving]) -> int:
        return sum(result.missing_bytes for result in arriving if result.member == member and self._is_alive(result.task))

    def _is_alive(self, task: str) -> bool:
        with self._lock:
            promise = self._alive.get(task)
            return promise is not None and self.clock() - promise.since_s <= PROMISE_S


def _share(member: str, arriving: Sequence[Arriving], free_bytes: int) -> int:
    """Bytes of the disk that each member may count on, this one among them."""
    members = {member} | {result.member for result in arriving}
    return (free_bytes + sum(result.arrived_bytes for result in arriving)) // len(members)


def _arrived(member: str, arriving: Sequence[Arriving]) -> int:
    return sum(result.arrived_bytes for result in arriving if result.member == member)
