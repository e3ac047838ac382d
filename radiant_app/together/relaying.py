"""An edge between devices that train together and the root above: its process, once per run.

    START of its devices ─→ up      BEGIN ─→ down
    GRADIENTS of its devices ─ sum ─→ up      TOTAL ─→ down

It has no model: a link that is lost to the root is made anew, and its devices begin anew from where
the root stands. What it remembers of its devices goes up with each sum and comes back then, so that
an edge that is back refuses whom it refused before.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from radiant_app.reporting import EventReporter
from radiant_app.together.exchange import (
    BEGIN,
    END,
    GONE_S,
    RELAY_STATE,
    START,
    TOTAL,
    Children,
    begin_anew,
    pack,
    pack_sum,
    unpack,
)
from radiant_app.together.holding import CONNECT_S
from radiant_app.together.links import ChildLink, LinkLost, LinkRules, ParentLinks, Traffic, connect
from radiant_app.together.places import ENDED_NAME, GROUP_FOLDER, LATE_S, mark_done, meeting_of
from radiant_app.together.playing import play_machine
from radiant_core import __version__
from radiant_core.errors import BadInput, StageFailed
from radiant_core.hierarchy.group_codec import load_begin
from radiant_core.hierarchy.groups import GroupTraining
from radiant_core.io.run_store import content_key, read_json, write_json
from radiant_core.train.together.roles import Relay

_RECORD = ("key", "begun", "refused", "num_refused")


@dataclass(frozen=True, kw_only=True)
class Relayed:
    """What an edge summed: which of its devices took part, who was refused and why, and figures."""

    begun: set[str] = field(default_factory=set)
    refused: dict[str, str] = field(default_factory=dict)
    summary: dict[str, float | int] = field(default_factory=dict)


def relay(folder: Path, plan: GroupTraining, reporter: EventReporter) -> Relayed:
    """Sum the gradients of this edge's devices in every step.

    Args:
        folder: the edge's folder in its run.
        plan: the group below the cloud, of this edge's devices alone.
        reporter: hears warnings.

    Returns:
        Who took part, and figures of its messages.

    Raises:
        StageFailed: the root does not answer, or no device is left.
    """
    names = list(plan.of_devices)
    meeting = meeting_of(folder, f"edges/{folder.name}")
    meeting.mkdir(parents=True, exist_ok=True)
    with play_machine() as played:
        links = ParentLinks(meeting, names, LinkRules(limit_s=LATE_S, work=played.work), played.down)
        up = LinkRules(limit_s=GONE_S + LATE_S, pace=played.up, work=played.work)
        relaying = _Relaying(folder=folder, plan=plan, links=links, up=up, reporter=reporter, key=content_key(__version__, plan))
        try:
            return relaying.run()
        finally:
            links.close()


class _Relaying:
    def __init__(self, *, folder: Path, plan: GroupTraining, links: ParentLinks, up: LinkRules, reporter: EventReporter, key: str) -> None:
        self._folder, self._plan, self._links, self._up, self._reporter = folder, plan, links, up, reporter
        self._children = self._new_children({})
        self._traffic = Traffic()
        self._relayed, self._num_refused = Relayed(), 0
        self._record, self._key = folder / GROUP_FOLDER / ENDED_NAME, key

    def _new_children(self, num_late: dict[str, int]) -> Children:
        return Children(
            links=self._links,
            names=list(self._plan.of_devices),
            meeting=meeting_of(self._folder, f"edges/{self._folder.name}"),
            warn=self._reporter.warn,
            needs_all=self._plan.masked,
            num_late=num_late,
        )

    def run(self) -> Relayed:
        """Steps until the root ends them, over as many links as it takes."""
        while True:
            try:
                if self._has_ended:
                    self._finish()
                else:
                    starts = self._children.starts()
                    self._steps(self._connect(), starts)
            except LinkLost as lost:
                if "no parent took" in lost.reason:
                    raise StageFailed(f"{self._plan.root} does not answer: {lost.reason}.") from lost
                self._reporter.warn(f"the link to {self._plan.root} is lost ({lost.reason}); it opens another one; its devices begin anew.")
                for name in list(self._links.linked):
                    self._links.drop(name, f"the link to {self._plan.root} was lost")
                self._children = self._new_children(self._children.num_late)
                time.sleep(0.2)
            else:
                mark_done(meeting_of(self._folder, self._plan.root), self._folder.name)
                traffic = [self._traffic, *self._links.traffic.values()]
                self._relayed.summary["sent_bytes"] = sum(link_traffic.sent_bytes for link_traffic in traffic)
                self._relayed.summary["received_bytes"] = sum(link_traffic.received_bytes for link_traffic in traffic)
                self._relayed.summary["num_refused"] = self._num_refused
                return self._relayed

    def _steps(self, up: ChildLink, starts: Mapping[str, Mapping[str, bytes]]) -> None:
        begin, state = self._ask(up, {device: data for parts in starts.values() for device, data in parts.items()})
        place = self._folder / GROUP_FOLDER
        place.mkdir(exist_ok=True)
        parts = unpack(begin)
        (place / "begin.safetensors").write_bytes(parts["begin"])
        stands = load_begin(place / "begin.safetensors")
        relay = Relay(self._plan.of_devices, stands.layout, stands.group)
        # Where steps overlap devices have sent already what is in the total that they take next.
        first = stands.step + ("total" in parts)
        knows_size = "total" not in parts or not stands.group.edits(stands.step)
        relay.begin(first, len(stands.splats) if knows_size else None, state)
        self._note_refused(starts, begin)
        self._children.begin({name: begin for name in starts if name not in self._relayed.refused})
        for name in starts:
            if name in self._relayed.refused:
                self._children.refuse(name, self._relayed.refused[name])

        def answer(name: str, parts: Mapping[str, bytes]) -> bytes:
            return self._answer(up, name, parts)

        num_steps = stands.group.stepping.num_steps
        for step in range(first, num_steps):
            try:
                sent = self._children.gradients(begin_anew if self._plan.masked else answer)
            except LinkLost:
                up.close()
                raise
            message = relay.message(sent)
            up.send(pack_sum(message, relay.state()))
            for warning in relay.inbox.take_warnings():
                self._reporter.warn(warning)
            payload = up.receive().payload
            if payload[:1] != TOTAL:
                raise LinkLost(self._plan.root, f"it sent {payload[:1]!r} at step {step + 1} where a sum was due")
            relay.follow(payload[1:])
            self._children.send(TOTAL, payload[1:])
        _require_end(up, self._plan.root)
        self._num_refused = relay.inbox.num_refused
        record = {"key": self._key, "begun": sorted(self._relayed.begun), "refused": self._relayed.refused}
        write_json(self._record, {**record, "num_refused": self._num_refused})
        for warning in relay.inbox.refusals():
            self._reporter.warn(warning)
        # The root listens to whoever comes back for the end, over a new link.
        up.close()
        self._finish()

    def _finish(self) -> None:
        """Let devices end; one that comes back for it is answered by the root."""
        link: ChildLink | None = None

        def answer(name: str, parts: Mapping[str, bytes]) -> bytes:
            nonlocal link
            link = link or self._connect()
            begin = self._answer(link, name, parts)
            _require_end(link, self._plan.root)
            return begin

        self._children.finish(answer)
        if link is not None:
            link.close()

    @property
    def _has_ended(self) -> bool:
        """Whether all steps were summed before this process was started again."""
        if not self._record.is_file() or (record := read_json(self._record, _RECORD))["key"] != self._key:
            return False
        self._relayed, self._num_refused = Relayed(begun=set(record["begun"]), refused=record["refused"]), record["num_refused"]
        return True

    def _connect(self) -> ChildLink:
        return connect(meeting_of(self._folder, self._plan.root), self._folder.name, CONNECT_S, self._up, self._traffic)

    def _answer(self, up: ChildLink, name: str, parts: Mapping[str, bytes]) -> bytes:
        """BEGIN for a device that comes back."""
        begin, _ = self._ask(up, {name: parts[name]} if name in parts else {})
        self._note_refused([name], begin)
        if name in self._relayed.refused:
            raise BadInput(self._relayed.refused[name])
        return begin

    def _note_refused(self, names: Iterable[str], begin: bytes) -> None:
        """Note which of these devices the root takes, by its BEGIN for them."""
        refused: dict[str, str] = json.loads(unpack(begin).get("refused", b"{}"))
        for name in names:
            if name in refused:
                self._relayed.refused[name] = str(refused[name])
            else:
                self._relayed.refused.pop(name, None)
                self._relayed.begun.add(name)

    def _ask(self, up: ChildLink, starts: Mapping[str, bytes]) -> tuple[bytes, bytes]:
        """BEGIN for devices that sent these starts, and what this edge remembered of all of them
        after the step before, which is not for devices."""
        if not starts:
            raise BadInput("a device sent another one's start")
        up.send(pack(START, starts))
        payload = up.receive().payload
        if payload[:1] != BEGIN:
            raise LinkLost(self._plan.root, f"it answered a start with {payload[:1]!r}")
        if RELAY_STATE not in (parts := unpack(payload)):
            return payload, b""
        state = parts.pop(RELAY_STATE)
        return pack(BEGIN, parts), state


def _require_end(up: ChildLink, root: str) -> None:
    if up.receive().payload[:1] != END:
        raise LinkLost(root, "it did not end the training after the last step")
