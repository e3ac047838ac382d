"""What travels over a link, and a parent's view of its children. Once per message.

    up      START      of a device, or of all devices below an edge: their files, by name
            GRADIENTS  of the next step; of an edge with what it remembers of its devices
    down    BEGIN      where the training stands, for devices that sent a start; what it began with,
                       where it has gone on since; whose start is refused, and why
            TOTAL      of a step
            END        there is no further step; in place of BEGIN: the start is refused

A child that is linked sends START first, whenever that is: at the beginning, or when it is back.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from radiant_app.together.links import LinkLost, ParentLinks
from radiant_app.together.places import is_done
from radiant_core.errors import BadInput, StageFailed
from radiant_core.train.together.roles import MOST_STATE_BYTES

START, GRADIENTS, BEGIN, TOTAL, END = b"S", b"G", b"B", b"T", b"E"
GONE_S = 300.0
"""One whose link is lost is waited for so long: its process may be started again."""
MOST_LATE = 3
"""One that was late so often in a row, each time over a new link, is too slow to take part."""
RELAY_STATE = "relay"
"""The part of BEGIN with what an edge remembered of its devices."""
_COUNT, _PART = struct.Struct("<I"), struct.Struct("<HQ")
_MOST_PARTS = 10_000


def pack(kind: bytes, parts: Mapping[str, bytes]) -> bytes:
    """A message of named files."""
    chunks = [kind, _COUNT.pack(len(parts))]
    for name, data in parts.items():
        encoded = name.encode()
        chunks += [_PART.pack(len(encoded), len(data)), encoded, data]
    return b"".join(chunks)


def unpack(payload: bytes) -> dict[str, bytes]:
    """The files of a message, whatever its kind; BadInput where it has none."""
    try:
        (count,), at = _COUNT.unpack_from(payload, 1), 1 + _COUNT.size
        parts: dict[str, bytes] = {}
        for _ in range(min(count, _MOST_PARTS)):
            num_name, num_data = _PART.unpack_from(payload, at)
            at += _PART.size
            if at + num_name + num_data > len(payload):
                raise BadInput("a message ends before its files do: its sender has another version.")
            parts[payload[at : at + num_name].decode()] = payload[at + num_name : at + num_name + num_data]
            at += num_name + num_data
    except (struct.error, UnicodeDecodeError) as error:
        raise BadInput(f"a message holds no files ({error}): its sender has another version.") from error
    if len(parts) != count or at != len(payload):
        raise BadInput(f"a message holds {len(parts)} files, expected {count}: its sender has another version.")
    return parts


def pack_sum(message: bytes, state: bytes) -> bytes:
    """GRADIENTS of an edge: the sum of a step, and what the edge remembers of its devices."""
    return b"".join((GRADIENTS, _COUNT.pack(len(state)), state, message))


def unpack_sum(payload: bytes) -> tuple[bytes, bytes]:
    """The sum and the state of `pack_sum`, without its kind; what is damaged is a sum that nobody
    can read."""
    if len(payload) < _COUNT.size:
        return b"", b""
    end = _COUNT.size + _COUNT.unpack_from(payload)[0]
    if end > min(len(payload), _COUNT.size + MOST_STATE_BYTES):
        return b"", b""
    return payload[end:], payload[_COUNT.size : end]


Answer = Callable[[str, Mapping[str, bytes]], bytes]
"""Makes BEGIN for a child of what it sent in START; BadInput where that cannot be used."""


def begin_anew(name: str, parts: Mapping[str, bytes]) -> bytes:
    """The answer to a child that comes back under masks: LinkLost, since all of its sum need keys
    that no step was masked with."""
    raise LinkLost(name, "it came back with a new key for masks")


@dataclass(kw_only=True)
class Children:
    """The children of a parent: who takes part in a step, who is waited for, who is left out."""

    links: ParentLinks
    names: Sequence[str]
    meeting: Path
    warn: Callable[[str], None]
    clock: Callable[[], float] = time.monotonic
    gone_s: float = GONE_S
    needs_all: bool = False
    """Whether no step is taken without a child, as under masks."""
    present: set[str] = field(default_factory=set)
    """They have the model of the step."""
    left_out: dict[str, str] = field(default_factory=dict)
    """Child → why steps go on without it."""
    num_missed: dict[str, int] = field(default_factory=dict)
    """Child → steps without it."""
    num_late: dict[str, int] = field(default_factory=dict)
    """Child → links that were lost since it said nothing, after its last gradients."""
    _lost_s: dict[str, float] = field(default_factory=dict)

    def starts(self) -> dict[str, dict[str, bytes]]:
        """What each child begins with; without those that are gone. StageFailed without any."""
        begun_s, sent = self.clock(), dict[str, dict[str, bytes]]()
        while missing := [name for name in self.names if name not in sent and name not in self.left_out]:
            self.links.poll()
            for name, kind, payload in self._receive([name for name in missing if name in self.links.linked]):
                if kind != START:
                    self._lose(name, "it did not begin with a start")
                    continue
                if self._is_too_late(name):
                    continue
                try:
                    sent[name] = unpack(payload)
                except BadInput as error:
                    self.refuse(name, str(error))
            self._leave_out([name for name in missing if name not in self.links.linked], begun_s, patient=not sent)
            self._require_all()
            self.links.pause(0.01)
        if not sent:
            raise StageFailed(f"none of {', '.join(self.names)} came to train: look at their messages above.")
        return sent

    def restart(self, reason: str) -> dict[str, dict[str, bytes]]:
        """What each child begins with over a new link, after all were dropped for a reason."""
        for name in list(self.links.linked):
            self.links.drop(name, reason)
        self.present.clear()
        self._lost_s.clear()
        return self.starts()

    def begin(self, answers: Mapping[str, bytes]) -> None:
        """Send BEGIN to children, which take part from now on."""
        self.links.send_all(answers)
        self.present |= set(answers)

    def refuse(self, name: str, reason: str) -> None:
        """Let a child end whose start cannot be used."""
        self.links.send_all({name: END})
        self.present.discard(name)
        self.left_out[name] = reason
        self.warn(f"steps go on without {name}: its start is refused: {reason}")

    def gradients(self, answer: Answer) -> dict[str, bytes]:
        """What all children send for a step; one that comes back is answered first."""
        begun_s, got = self.clock(), dict[str, bytes]()
        while True:
            self.links.poll()
            waiting = [name for name in self.names if name not in got and name in self.links.linked]
            for name, kind, payload in self._receive(waiting):
                if kind == START:
                    self._answer(name, payload, answer)
                elif kind == GRADIENTS and name in self.present:
                    got[name] = payload[1:]
                    self.num_late.pop(name, None)
                else:
                    self._lose(name, "it sent what was not asked for")
            missing = [name for name in self.names if name not in got and name not in self.left_out]
            if not missing:
                break
            if not waiting:
                self._leave_out([name for name in missing if name not in self.links.linked], begun_s)
                self.links.pause(0.005)
            self._require_all()
        if not got:
            raise StageFailed(f"none of {', '.join(self.names)} sends gradients any more: look at their messages above.")
        for name in self.left_out:
            self.num_missed[name] = self.num_missed.get(name, 0) + 1
        return got

    def send(self, kind: bytes, payload: bytes = b"") -> None:
        """Send a message to all that take part."""
        message = kind + payload
        for name, lost in self.links.send_all({name: message for name in self.names if name in self.present}).items():
            self._lose(name, lost.reason)

    def finish(self, answer: Answer) -> None:
        """Send END to all, and serve those that come back for it, until each has written what the
        training ended with."""
        self.send(END)
        begun_s = self.clock()
        while missing := [name for name in self.names if name not in self.left_out and not is_done(self.meeting, name)]:
            self.present -= set(self.links.poll())
            for name, kind, payload in self._receive([name for name in missing if name in self.links.linked and name not in self.present]):
                if kind == START:
                    self._answer(name, payload, answer)
                    self.links.send_all({name: END})
            # That a link is lost shows when it is waited for, which nobody does here.
            for name in filter(self._is_gone, missing):
                self.links.drop(name, "it has ended")
            self._leave_out([name for name in missing if name not in self.links.linked], begun_s)
            self.links.pause(0.01)

    def _receive(self, names: Sequence[str]) -> list[tuple[str, bytes, bytes]]:
        """Child, kind and payload of a message of each child; lost ones are noted."""
        arrived = []
        for name, message in (self.links.receive_all(names) if names else {}).items():
            if isinstance(message, LinkLost):
                if message.is_late:
                    self.num_late[name] = self.num_late.get(name, 0) + 1
                self._lose(name, message.reason)
            else:
                arrived.append((name, message.payload[:1], message.payload))
        return arrived

    def _answer(self, name: str, payload: bytes, answer: Answer) -> None:
        if self._is_too_late(name):
            return
        try:
            reply = answer(name, unpack(payload))
        except BadInput as error:
            self.refuse(name, str(error))
            return
        self.links.send_all({name: reply})
        self.present.add(name)
        if self._lost_s.pop(name, None) is not None or name in self.left_out:
            self.warn(f"{name} is back and takes part again.")
        self.left_out.pop(name, None)

    def _is_too_late(self, name: str) -> bool:
        """Whether a child that starts was late too often: then it is refused."""
        if self.num_late.get(name, 0) < MOST_LATE:
            return False
        self.refuse(name, f"it was late {MOST_LATE} times in a row, which is longer for a step than others wait")
        return True

    def _require_all(self) -> None:
        if self.needs_all and self.left_out:
            name, reason = next(iter(self.left_out.items()))
            raise StageFailed(
                f"a masked training cannot go on without {name} ({reason}): run again with --resume once it is back, or without masks."
            )

    def _lose(self, name: str, reason: str) -> None:
        self.links.drop(name, reason)
        self.present.discard(name)
        if name not in self._lost_s and name not in self.left_out:
            self._lost_s[name] = self.clock()
            self.warn(f"the link to {name} is lost ({reason}); the group waits for it up to {self.gone_s:.0f} s.")

    def _leave_out(self, names: Sequence[str], begun_s: float, *, patient: bool = False) -> None:
        """Leave out who is gone, or was waited for long enough; at the start the first to come is
        waited for without a limit."""
        for name in names:
            gone = self._is_gone(name)
            waited_s = self.clock() - max(begun_s, self._lost_s.get(name, begun_s))
            if gone or (not patient and waited_s > self.gone_s):
                self.left_out[name] = "it has ended" if gone else f"it did not come back within {self.gone_s:.0f} s"
                self.warn(f"steps go on without {name}: {self.left_out[name]}. From now on its photographs are missing.")

    def _is_gone(self, name: str) -> bool:
        return (self.meeting / f"{name}.gone").is_file()
