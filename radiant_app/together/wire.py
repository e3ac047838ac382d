"""One link: messages of any length between two processes over a gloo process group of two ranks.

A message is a header of 24 bytes (payload bytes, step, when it is due) and its payload. Every end
keeps a receive of `FIRST_BYTES` posted, so a message leaves at once and costs one way of the
link, not three; what is longer follows in a second part, which costs a round trip more. A receive
is posted again when its message was read: a second message waits at its sender until then.

A byte of its own (`_END`) follows every part, and the receiver waits for that byte alone: so it
learns at once that its sender was lost, where gloo took its whole limit. A connection keeps the
order of its messages, so the part is there when the byte is. For the same reason nobody waits for a
send: its receiver answers with a byte (`_RECEIPT`), for which the sender waits before its next
message.

gloo closes a connection for good when somebody waits in vain, or when the other process ends.
Then the link is lost (`LinkLost`), and the two ends make a new one (`meeting`).
"""

import struct
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from datetime import timedelta
from typing import Any, NamedTuple

import torch

from radiant_app.together.playing import Pace, Work
from radiant_core.errors import StageFailed

FIRST_BYTES = 32 << 20 if sys.platform == "linux" else 4 << 10
"""Bytes that a posted receive has room for. Pages that no message touches take no memory."""

PADDED = sys.platform != "linux"
"""Whether first parts are filled up to `FIRST_BYTES`: gloo's transport over libuv (macOS,
Windows) takes only messages of the posted length, that of Linux shorter ones too. Longer ones never
reach it."""

_HEADER = struct.Struct("<QqQ")
_FIRST, _REMAINDER, _END, _RECEIPT = 0, 1, 2, 3  # tags
_LATE = "no answer within"


class LinkLost(StageFailed):
    """The link to `peer` is gone, for `reason`; a new one has to be made."""

    def __init__(self, peer: str, reason: str) -> None:
        super().__init__(f"The link to {peer} is lost: {reason}.")
        self.peer = peer
        self.reason = reason

    @property
    def is_late(self) -> bool:
        """Whether the peer said nothing for too long, and did not end."""
        return self.reason.startswith(_LATE)


class Message(NamedTuple):
    """What one end sent: the step it belongs to, and its bytes."""

    step: int
    payload: bytes


@dataclass(frozen=True)
class LinkRules:
    """What holds for every message of a link. Both ends need the same `most_bytes`."""

    limit_s: float = 60.0
    """Seconds after which a peer that has not answered, or not taken a message, is lost."""
    most_bytes: int = 1 << 30
    """The longest payload that is sent or taken: a training that a device joins is some 290 bytes a
    Gaussian with harmonics of degree 1, so this is that of 3.7 million."""
    address: str = ""
    """IP address of this machine to listen at; empty: see `meeting.device_at`."""
    pace: Pace = field(default_factory=Pace)
    """The slower link that is emulated in what this end sends."""
    work: Work = field(default_factory=Work, compare=False)
    """That of the emulated machine of this end, which a wait ends."""

    def __post_init__(self) -> None:
        if not 0 < self.limit_s < 1e6:
            raise ValueError(f"limit_s is {self.limit_s}; it must be above 0 and below a million seconds.")
        if self.most_bytes < 0:
            raise ValueError(f"most_bytes is {self.most_bytes}; it must be 0 or more.")

    def deadline(self) -> float:
        """Until when a peer is waited for from now on, once this end's work has taken its time."""
        self.work.settle()
        return time.monotonic() + self.limit_s


@dataclass
class Traffic:
    """What passed over the links to one peer, headers included, whatever became of them."""

    sent_bytes: int = 0
    received_bytes: int = 0
    sent_messages: int = 0
    received_messages: int = 0
    stale_messages: int = 0
    """Messages of former steps, which were received and left out."""
    waited_s: float = 0.0
    """Seconds in which this end waited for the peer, to send or to receive."""


class Wire:
    """One end of a link: `rank` of the gloo process group `group`, to the process called `peer`.

    Every method raises `LinkLost` when the link is gone and closes its own end then.
    Deadlines are of `time.monotonic`.
    """

    def __init__(self, group: Any, rank: int, peer: str, rules: LinkRules, traffic: Traffic) -> None:
        self._group: Any = group
        self._peer_rank, self.peer, self.rules, self.traffic = 1 - rank, peer, rules, traffic
        self._inbox = torch.empty(FIRST_BYTES, dtype=torch.uint8)
        self._outbox = torch.empty(FIRST_BYTES if PADDED else 0, dtype=torch.uint8)
        self._remainder = torch.empty(0, dtype=torch.uint8)
        self._end_in, self._end_out = torch.zeros(1, dtype=torch.uint8), torch.zeros(1, dtype=torch.uint8)
        self._coming: list[Any] = []
        self._read_in, self._read_out = torch.zeros(1, dtype=torch.uint8), torch.zeros(1, dtype=torch.uint8)
        self._going: list[Any] = []  # first the receive of `_RECEIPT`
        self._answer: Any = None
        self._free_at = 0.0
        self._lost = ""
        self._post()

    def send(self, payload: bytes | memoryview, step: int, deadline: float) -> None:
        """Hand a message to gloo, once the one before it was read. `ValueError`: it is too long."""
        body = memoryview(payload).cast("B")
        if len(body) > self.rules.most_bytes:
            raise ValueError(f"A message of {len(body)} bytes is too long for a link of at most {self.rules.most_bytes} bytes a message.")
        self._check()
        self.flush(deadline)
        total = _HEADER.size + len(body)
        if len(self._outbox) < total:
            self._outbox = torch.empty(total, dtype=torch.uint8)
        view = _view(self._outbox)
        _HEADER.pack_into(view, 0, len(body), step, self._due_ns(total))
        view[_HEADER.size : total] = body
        first = FIRST_BYTES if PADDED else min(total, FIRST_BYTES)
        with self._loss(0.0):
            self._going = [self._group.recv([self._read_in], self._peer_rank, _RECEIPT)]
            self._put(self._outbox[:first], _FIRST)
            if total > first:
                self._put(self._outbox[first:total], _REMAINDER)
        self.traffic.sent_bytes += total
        self.traffic.sent_messages += 1

    def flush(self, deadline: float) -> None:
        """Wait until the peer has read the last message of `send`."""
        with self._loss(deadline):
            for work in self._going:
                work.wait(_time_left(deadline))
        self._going = []

    def open(self, deadline: float) -> None:
        """Wait for the first part of the next message, check its length and post the rest's
        receive."""
        self._check()
        self._arrive(deadline)
        length, _, _ = self._header()
        if length > self.rules.most_bytes:
            raise self.lose(f"it announced a message of {length} bytes; at most {self.rules.most_bytes} are taken")
        num_remaining = _HEADER.size + length - FIRST_BYTES
        if num_remaining > 0:
            self._remainder = torch.empty(num_remaining, dtype=torch.uint8)
            with self._loss(0.0):
                self._expect(self._remainder, _REMAINDER)

    def read_message(self, deadline: float) -> Message:
        """The message that `open` began, when it is due. A second part has `limit_s` of its own."""
        length, step, due_ns = self._header()
        if len(self._remainder):
            deadline = max(deadline, time.monotonic() + self.rules.limit_s)
            self._arrive(deadline)
        self._hold(due_ns / 1e9, deadline)
        payload = bytes(_view(self._inbox)[_HEADER.size : min(_HEADER.size + length, FIRST_BYTES)])
        if len(self._remainder):
            payload += self._remainder.numpy().tobytes()
            self._remainder = torch.empty(0, dtype=torch.uint8)
        self.traffic.received_bytes += _HEADER.size + length
        self.traffic.received_messages += 1
        self._post()
        self._answer_read()
        return Message(step, payload)

    def lose(self, reason: str) -> LinkLost:
        """Close this end for `reason`; the other end sees that at once. The error to raise."""
        self._lost = self._lost or reason
        self._going, self._coming, self._answer, self._group = [], [], None, None
        return LinkLost(self.peer, self._lost)

    def _post(self) -> None:
        """Post the receive of the next message; that the link is gone shows when it is waited
        for."""
        try:
            self._expect(self._inbox, _FIRST)
        except RuntimeError as error:
            self.lose(_reason(str(error), self.rules.limit_s))

    def _answer_read(self) -> None:
        """Say that a message was read; the peer waits for that before its next, so the last has
        left."""
        if self._group is not None:
            try:
                self._answer = self._group.send([self._read_out], self._peer_rank, _RECEIPT)
            except RuntimeError as error:
                self.lose(_reason(str(error), self.rules.limit_s))

    def _put(self, part: torch.Tensor, tag: int) -> None:
        """Send a part and the byte after it."""
        self._going.append(self._group.send([part], self._peer_rank, tag))
        self._going.append(self._group.send([self._end_out], self._peer_rank, _END))

    def _expect(self, part: torch.Tensor, tag: int) -> None:
        """Post the receives of a part and of the byte after it, in the order in which they are
        sent."""
        self._coming = [self._group.recv([part], self._peer_rank, tag)]
        self._coming.append(self._group.recv([self._end_in], self._peer_rank, _END))

    def _arrive(self, deadline: float) -> None:
        """Wait for the byte after a part, then for the part, which is there."""
        with self._loss(deadline):
            for work in reversed(self._coming):
                work.wait(_time_left(deadline))

    def _header(self) -> tuple[int, int, int]:
        return _HEADER.unpack_from(_view(self._inbox))

    def _check(self) -> None:
        if self._group is None:
            raise LinkLost(self.peer, self._lost)

    def _due_ns(self, num_bytes: int) -> int:
        """When an emulated link would have carried a message, in ns of the monotonic clock; 0: at
        once."""
        pace = self.rules.pace
        if pace.bytes_per_s is None and pace.latency_s == 0:
            return 0
        self._free_at = max(self._free_at, self.rules.work.settle()) + pace.carry_s(num_bytes)
        return int((self._free_at + pace.latency_s) * 1e9)

    def _hold(self, due: float, deadline: float) -> None:
        begun = time.monotonic()
        if due == 0.0:
            return
        with self.rules.work.waiting(until_s=due):
            time.sleep(max(0.0, min(due, deadline) - time.monotonic()))
        self.traffic.waited_s += time.monotonic() - begun
        if due > max(deadline, begun):
            raise self.lose(f"{_LATE} {self.rules.limit_s:g} s")

    @contextmanager
    def _loss(self, deadline: float) -> Iterator[None]:
        """Count the seconds that pass, which are a wait where there is a deadline, and turn gloo's
        errors into `LinkLost`. What comes is there when it is due, whenever it arrives here."""
        with self.rules.work.waiting(until_s=0.0) if deadline else nullcontext():
            start = time.monotonic()
            try:
                yield
            except RuntimeError as error:
                raise self.lose(_reason(str(error), self.rules.limit_s)) from None
            finally:
                self.traffic.waited_s += time.monotonic() - start if deadline else 0.0


def _view(tensor: torch.Tensor) -> memoryview:
    array: Any = tensor.numpy()
    return memoryview(array)


def _time_left(deadline: float) -> timedelta:
    """What is left until a deadline, at least 1 ms: gloo takes 0 for no limit."""
    return timedelta(seconds=max(0.001, deadline - time.monotonic()))


def _reason(error: str, limit_s: float) -> str:
    if "Timed out" in error:
        return f"{_LATE} {limit_s:g} s"
    if "closed by peer" in error or "reset by peer" in error or "Broken pipe" in error:
        return "the other process ended or closed it"
    return f"gloo says {error.splitlines()[0][:200]}"
