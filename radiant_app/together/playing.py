"""The emulated machine that a process of a group plays, under `--emulate`: a share of a core, and
links. Loads no torch.

    work     t += CPU seconds / speed, and the process sleeps until then before it sends or waits
    message  due at t + bytes / bytes_per_s + latency; who waited for it has t = max(t, due)

t is the machine's own time, on this machine's monotonic clock, so what it computes between two
waits takes its share, and waiting gives no credit and costs nothing. Where other work delays the
process, t goes on as if it had not: who is late sleeps less until it has caught up.

Until its first link is opened, and after its last, the share is kept from outside
(`executors/emulated_node.py`), with which the process agrees on both moments over a socket. A
process with links and no share, the cloud, has a core of this machine.
"""

from __future__ import annotations

import json
import math
import os
import socket
import struct
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

LINKS, SHARE = "RADIANT_EMULATED_LINKS", "RADIANT_EMULATED_SHARE"
"""Variables of a process that plays a machine: `links_variable`, and "DESCRIPTOR SPEED", the socket
to who keeps its share otherwise."""
KEEPS, AGREED = b"k", b"a"
"""What a process says that keeps to its share itself from now on, and the answer."""
WORKED = struct.Struct("<dd")
"""What it says in the end: CPU seconds of its work, and how long that took."""


@dataclass(frozen=True)
class Pace:
    """A slower link to emulate between processes of one machine, in each direction.

    A message of n bytes may be read n / `bytes_per_s` + `latency_s` after it was sent, and n /
    `bytes_per_s` after the message before it. The sender goes on at once, as over a real link.
    """

    bytes_per_s: float | None = None
    """Bytes that the link carries in a second; `None`: as many as it can."""
    latency_s: float = 0.0
    """Seconds that a byte travels."""

    def __post_init__(self) -> None:
        if self.bytes_per_s is not None and not 0 < self.bytes_per_s < math.inf:
            raise ValueError(f"bytes_per_s is {self.bytes_per_s}; it must be above 0 and finite, or None for no bound.")
        if not 0 <= self.latency_s < math.inf:
            raise ValueError(f"latency_s is {self.latency_s}; it must be 0 or more and finite.")

    def carry_s(self, num_bytes: int) -> float:
        """Seconds for which `num_bytes` occupy the link."""
        return 0.0 if self.bytes_per_s is None else num_bytes / self.bytes_per_s


class Work:
    """The time of a machine whose work takes its CPU seconds / `speed`; None: its process's."""

    def __init__(
        self,
        speed: float | None = None,
        *,
        now: Callable[[], float] = time.monotonic,
        cpu: Callable[[], float] = time.process_time,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._speed, self._now, self._cpu, self._sleep = speed, now, cpu, sleep
        self._at_s, self._counted_cpu_s = now(), cpu()
        self.cpu_s, self._late_s = 0.0, 0.0
        """CPU seconds of its work; s that it was late where a wait of no known end began."""

    def settle(self) -> float:
        """Sleep until the work since the last wait has taken its time; t, monotonic s."""
        if self._speed is None:
            return self._now()
        cpu_s = self._cpu()
        self.cpu_s += cpu_s - self._counted_cpu_s
        self._at_s += (cpu_s - self._counted_cpu_s) / self._speed
        self._counted_cpu_s = cpu_s
        if (ahead_s := self._at_s - self._now()) > 0:
            self._sleep(ahead_s)
        return self._at_s

    @contextmanager
    def waiting(self, until_s: float | None = None) -> Iterator[None]:
        """What is done inside is a wait, and no work: for what is there at `until_s`, monotonic s,
        None: when the wait is over."""
        self.settle()
        if until_s is None:
            self._late_s += max(0.0, self._now() - self._at_s)
        try:
            yield
        finally:
            self._at_s = max(self._at_s, self._now() if until_s is None else until_s)
            self._counted_cpu_s = self._cpu()

    @property
    def seconds(self) -> float:
        """How long its work took: more than its share of a core says by what it is late."""
        return self.cpu_s / (self._speed or 1.0) + self._late_s + max(0.0, self._now() - self._at_s)


@dataclass(frozen=True, kw_only=True)
class PlayedMachine:
    """What a process plays; by default the machine that it runs on."""

    work: Work = field(default_factory=Work)
    up: Pace = field(default_factory=Pace)
    """Of what it sends to its parent."""
    down: Mapping[str, Pace] = field(default_factory=dict[str, Pace])
    """Child → that of what it is sent."""


def links_variable(up: Pace, down: Mapping[str, Pace]) -> dict[str, str]:
    """The variable that tells a process of its links."""
    links = {name: (pace.bytes_per_s, pace.latency_s) for name, pace in down.items()}
    return {LINKS: json.dumps({"up": (up.bytes_per_s, up.latency_s), "down": links})}


@contextmanager
def play_machine() -> Iterator[PlayedMachine]:
    """The machine that this process plays, from now until the end of the context."""
    links = json.loads(os.environ.get(LINKS, '{"up": [], "down": {}}'))
    up, down = Pace(*links["up"]), {name: Pace(*pace) for name, pace in links["down"].items()}
    if SHARE not in os.environ:
        yield PlayedMachine(work=Work(1.0 if down else None), up=up, down=down)
        return
    descriptor, speed = os.environ[SHARE].split()
    with socket.socket(fileno=int(descriptor)) as keeper:
        _agree(keeper, KEEPS)
        work = Work(float(speed))
        try:
            yield PlayedMachine(work=work, up=up, down=down)
        finally:
            work.settle()
            _agree(keeper, WORKED.pack(work.cpu_s, work.seconds))


def _agree(keeper: socket.socket, words: bytes) -> None:
    keeper.sendall(words)
    keeper.recv(len(AGREED))
