"""The links over which machines that train together exchange messages in every optimiser step.

A star: a parent (an edge, or the cloud) has one link to each child (a device, or an edge). Each
link is a gloo process group of two ranks, so a child that dies breaks its own link alone, and one
that comes back makes a new one. How the ends find each other: `meeting`; what a link carries:
`wire`.

    child:   link = connect(meeting, "device 3", wait_s)
             link.send(gradient, step); total = link.receive(step)
    parent:  links = ParentLinks(meeting, names); links.wait_for(names, wait_s)
             links.receive_all(names, step); links.send_all({name: total}, step); links.poll()

A step costs one message each way per child. The two ends trust each other: gloo has neither keys
nor encryption here, and a peer that speaks nonsense can end the process.
"""

import contextlib
import queue
import threading
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from radiant_app.together import meeting as meeting_place
from radiant_app.together.meeting import ANSWER_S, CHILD, PARENT, Attempt
from radiant_app.together.playing import Pace
from radiant_app.together.wire import LinkLost, LinkRules, Message, Traffic, Wire

__all__ = ["ChildLink", "LinkLost", "LinkRules", "Message", "Pace", "ParentLinks", "Traffic", "connect"]

_PARENT_NAME = "the parent"
T = TypeVar("T")


class ChildLink:
    """A child's link to its parent, made by `connect`. A child whose link is lost connects
    again."""

    def __init__(self, wire: Wire, meeting: Path, name: str) -> None:
        self._wire, self._meeting, self._name = wire, meeting, name

    @property
    def traffic(self) -> Traffic:
        """What passed over this link."""
        return self._wire.traffic

    def send(self, payload: bytes | memoryview, step: int = 0) -> None:
        """Send one message of `step`; return while it travels.

        Raises `LinkLost` when the link is gone, or when the message before this one was not
        received within `limit_s`; `ValueError` for more than `most_bytes`.
        """
        self._wire.send(payload, step, self._deadline())

    def receive(self, step: int | None = None) -> Message:
        """The next message of `step`, or the very next where `step` is `None`; former steps are
        left out.

        Raises `LinkLost` when the link is gone, nothing came within `limit_s`, or a later step
        came.
        """
        return _receive(self._wire, step, self._deadline())

    def close(self) -> None:
        """Close the link, once the parent has read the last message; at most `limit_s`."""
        with contextlib.suppress(LinkLost):
            self._wire.flush(self._deadline())
        self._wire.lose("it was closed here")
        meeting_place.withdraw(self._meeting, self._name)

    def _deadline(self) -> float:
        return self._wire.rules.deadline()


def connect(meeting: Path, name: str, wait_s: float, rules: LinkRules | None = None, traffic: Traffic | None = None) -> ChildLink:
    """Link the child `name` to the parent that polls the same folder; wait for it at most `wait_s`.

    `traffic` goes on counting where it is that of a former link. A second process of the same name
    takes the first one's place. Raises `LinkLost` when no parent has taken the link by then.
    """
    rules, traffic = rules or LinkRules(), traffic or Traffic()
    with rules.work.waiting():
        group = _ask_for_group(meeting, name, wait_s, rules)
    return ChildLink(Wire(group, CHILD, _PARENT_NAME, rules, traffic), meeting, name)


def _ask_for_group(meeting: Path, name: str, wait_s: float, rules: LinkRules) -> Any:
    deadline = time.monotonic() + wait_s
    device = meeting_place.device_at(rules.address)
    while True:
        attempt = meeting_place.ask(meeting, name)
        try:
            return meeting_place.join(attempt, CHILD, device, deadline - time.monotonic())
        except (OSError, RuntimeError):
            if time.monotonic() >= deadline:
                meeting_place.withdraw(meeting, name)
                reason = f"no parent took the link that {name} asked for in {meeting} within {wait_s:g} s"
                raise LinkLost(_PARENT_NAME, reason) from None
            time.sleep(0.05)


class ParentLinks:
    """A parent's links to the children `names`, made and renewed by `poll`."""

    def __init__(
        self, meeting: Path, names: Collection[str], rules: LinkRules | None = None, paces: Mapping[str, Pace] | None = None
    ) -> None:
        """`paces`: child → that of what it is sent, where it is not that of the rules."""
        self._meeting, self._rules = meeting, rules or LinkRules()
        self._rules_of = {name: replace(self._rules, pace=pace) for name, pace in (paces or {}).items()}
        self._traffic = {name: Traffic() for name in names}
        self._device = meeting_place.device_at(self._rules.address)
        self._wires: dict[str, Wire] = {}
        self._latest: dict[str, Attempt] = {}
        self._joining: list[threading.Thread] = []
        self._joined: queue.SimpleQueue[tuple[str, Attempt, Any]] = queue.SimpleQueue()

    @property
    def linked(self) -> list[str]:
        """The children with a link that is not known to be lost, in the order of `names`."""
        return [name for name in self._traffic if name in self._wires]

    @property
    def traffic(self) -> dict[str, Traffic]:
        """What passed over the links to each child, lost ones included."""
        return dict(self._traffic)

    def poll(self) -> list[str]:
        """Take up the children that ask, without waiting for any; those linked since the last call.

        A child may ask at any time, at the start or in the middle of a run. Its new link replaces
        the one before it, and its first message decides what it is sent to catch up.
        """
        for name in self._traffic:
            for attempt in meeting_place.attempts(self._meeting, name):
                if attempt.take():
                    self._latest[name] = attempt
                    thread = threading.Thread(target=self._join, args=(name, attempt), name=f"link to {name}")
                    self._joining.append(thread)
                    thread.start()
        self._joining = [thread for thread in self._joining if thread.is_alive()]
        linked: list[str] = []
        while not self._joined.empty():
            name, attempt, group = self._joined.get()
            if self._latest.get(name) is attempt:
                self.drop(name, "a new link replaced it")
                self._wires[name] = Wire(group, PARENT, name, self._rules_of.get(name, self._rules), self._traffic[name])
                linked = [*(linked_name for linked_name in linked if linked_name != name), name]
        return linked

    def wait_for(self, names: Collection[str], wait_s: float) -> list[str]:
        """Poll until all `names` are linked, at most `wait_s`; those that are missing then."""
        deadline = time.monotonic() + wait_s
        while True:
            self.poll()
            missing = [name for name in names if name not in self._wires]
            if not missing or time.monotonic() >= deadline:
                return missing
            self.pause(0.005)

    def pause(self, seconds: float) -> None:
        """Wait, as for a message."""
        with self._rules.work.waiting():
            time.sleep(seconds)

    def receive_all(self, names: Collection[str], step: int | None = None) -> dict[str, Message | LinkLost]:
        """The next message of each child, or why its link was lost; in the order of `names`.

        All are awaited at once, `limit_s` in all; the link of a child that is late is dropped.
        `step` as in `ChildLink.receive`. Only a message of more than `wire.FIRST_BYTES` that
        arrives beside a late one takes longer.
        """
        deadline = self._rules.deadline()
        lost: dict[str, LinkLost] = {}
        for name in names:
            self._try(name, lost, lambda wire: wire.open(deadline))
        messages: dict[str, Message | LinkLost] = {}
        for name in names:
            message = None if name in lost else self._try(name, lost, lambda wire: _read_message(wire, step, deadline))
            messages[name] = lost[name] if message is None else message
        return messages

    def send_all(self, messages: Mapping[str, bytes | memoryview], step: int = 0) -> dict[str, LinkLost]:
        """Send each child its message and return while they travel; the children that were lost.

        Only a child that has not yet received the message before is waited for, `limit_s` in all;
        whoever is lost on the way is reported by the next call.

        Raises `ValueError`, before anything was sent, for a message of more than `most_bytes`.
        """
        for name, payload in messages.items():
            num_bytes = memoryview(payload).nbytes
            if num_bytes > self._rules.most_bytes:
                raise ValueError(f"A message of {num_bytes} bytes to {name} is too long: most_bytes is {self._rules.most_bytes}.")
        deadline = self._rules.deadline()
        lost: dict[str, LinkLost] = {}
        for name, payload in messages.items():
            self._try(name, lost, lambda wire, payload=payload: wire.send(payload, step, deadline))
        return lost

    def drop(self, name: str, reason: str = "it was dropped here") -> None:
        """Close the link to a child, if there is one; the child sees that at once and may ask
        again."""
        wire = self._wires.pop(name, None)
        if wire is not None:
            wire.lose(reason)

    def close(self) -> None:
        """Close all links once their children have read the last message, at most `limit_s` in
        all."""
        deadline = self._rules.deadline()
        for wire in self._wires.values():
            with contextlib.suppress(LinkLost):
                wire.flush(deadline)
        for thread in self._joining:
            thread.join()
        while not self._joined.empty():
            self._joined.get()
        for name in self.linked:
            self.drop(name, "it was closed here")

    def _join(self, name: str, attempt: Attempt) -> None:
        """Join an attempt in a thread of its own: a child that died meanwhile would hold up all
        others."""
        try:
            group = meeting_place.join(attempt, PARENT, self._device, ANSWER_S)
        except (OSError, RuntimeError):
            return  # the child gives this attempt up too, and makes another if it lives
        self._joined.put((name, attempt, group))

    def _try(self, name: str, lost: dict[str, LinkLost], work: Callable[[Wire], T]) -> T | None:
        """`work` with the link to a child; a loss is entered in `lost`, and the link is dropped."""
        if name not in self._traffic:
            raise ValueError(f"There is no child {name}; the children are {', '.join(self._traffic)}.")
        wire = self._wires.get(name)
        try:
            if wire is None:
                raise LinkLost(name, "it has not been made, or not again")
            return work(wire)
        except LinkLost as error:
            # A new error, since a traceback holds what it passed.
            lost[name] = LinkLost(error.peer, error.reason)
            self.drop(name)
        return None


def _receive(wire: Wire, step: int | None, deadline: float) -> Message:
    wire.open(deadline)
    return _read_message(wire, step, deadline)


def _read_message(wire: Wire, step: int | None, deadline: float) -> Message:
    """The message of `step`, of which `wire` has opened the first."""
    while True:
        message = wire.read_message(deadline)
        if step is None or message.step == step:
            return message
        if message.step > step:
            raise wire.lose(f"it speaks of step {message.step} where step {step} is due")
        wire.traffic.stale_messages += 1
        wire.open(deadline)
