"""A device that trains together with others: its process, once per run.

    photographs ─ prepare ─ START ─→ BEGIN ─ ( GRADIENTS ─→ TOTAL ─ step )… ─ END ─ its model

Where the link to its edge is lost it asks for another one, sends START again and goes on from where
the others stand.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from radiant_app.reporting import EventReporter
from radiant_app.together.exchange import BEGIN, END, GONE_S, GRADIENTS, START, TOTAL, pack, unpack
from radiant_app.together.links import ChildLink, LinkLost, LinkRules, Traffic, connect
from radiant_app.together.places import ENDED_NAME, GROUP_FOLDER, INITIAL, LATE_S, mark_done, meeting_of
from radiant_app.together.playing import PlayedMachine, play_machine
from radiant_core import __version__
from radiant_core.errors import BadInput, StageFailed
from radiant_core.hierarchy.codec import task_key
from radiant_core.hierarchy.device import training_summary
from radiant_core.hierarchy.group_codec import load_begin, save_begin, save_start
from radiant_core.hierarchy.messages import DeviceModel, DeviceTask, Seat
from radiant_core.hierarchy.reporter import Machine
from radiant_core.hierarchy.together import PreparedShare, ShareStart, join_share, prepare_share
from radiant_core.io.records import load_splats, save_splats
from radiant_core.io.run_store import content_key, read_json, write_json
from radiant_core.splats import Splats
from radiant_core.train.together.roles import Holder
from radiant_core.train.views import TrainingViews

CONNECT_S = 600.0
"""So long a device waits for its edge, which may be waiting for others."""


def hold(folder: Path, task: DeviceTask, views: TrainingViews, reporter: EventReporter, machine: Machine) -> DeviceModel:
    """Train together with the devices that meet at the same edge.

    Args:
        folder: the device's folder in its run.
        task: with a seat.
        views: its photographs.
        reporter: hears decisions, warnings and progress.
        machine: memory and clock.

    Returns:
        The model of all, as this device has it after the last step.

    Raises:
        StageFailed: no edge answers.
    """
    seat = task.seat
    assert seat is not None
    prepared = prepare_share(task, views, reporter, machine)
    place = folder / GROUP_FOLDER
    place.mkdir(exist_ok=True)
    key = content_key(__version__, task_key(task), _packed(place / "start.safetensors", prepared.start))
    with play_machine() as played:
        member = _Member(folder=folder, seat=seat, prepared=prepared, key=key, reporter=reporter, played=played)
        holder = member.run()
    result = holder.replica.outcome()
    summary = {**training_summary(result), "num_photographs": len(prepared.views), "num_points": len(prepared.scene.points)}
    summary |= {"sent_bytes": member.traffic.sent_bytes, "received_bytes": member.traffic.received_bytes}
    return DeviceModel(splats=result.splats, cameras=task.scene.cameras, initial=member.initial, summary=summary)


class _Member:
    def __init__(
        self, *, folder: Path, seat: Seat, prepared: PreparedShare, key: str, reporter: EventReporter, played: PlayedMachine
    ) -> None:
        self._folder, self._seat, self._prepared, self._reporter = folder, seat, prepared, reporter
        # A parent waits for others before it answers.
        self._rules = LinkRules(limit_s=GONE_S + 2 * LATE_S, pace=played.up, work=played.work)
        self.traffic = Traffic()
        self.initial: Splats | None = None
        place = folder / GROUP_FOLDER
        self._first, self._final, self._record = place / INITIAL, place / "end.safetensors", place / ENDED_NAME
        self._key = key

    def run(self) -> Holder:
        """Take all steps, over as many links as it takes; none where that was done before this
        process was started again."""
        if (ended := self._ended()) is not None:
            return ended
        lost_s: float | None = None
        while True:
            try:
                link = connect(meeting_of(self._folder, self._seat.parent), self._folder.name, CONNECT_S, self._rules, self.traffic)
                holder = self._steps(link)
            except LinkLost as lost:
                now_s = time.monotonic()
                if lost_s is not None and now_s - lost_s < 1.0:
                    time.sleep(1.0)
                if "no parent took" in lost.reason:
                    raise StageFailed(f"{self._seat.parent} does not answer: {lost.reason}.") from lost
                self._reporter.warn(f"the link to {self._seat.parent} is lost ({lost.reason}); it opens another one.")
                lost_s = now_s
            else:
                link.close()
                return holder

    def _steps(self, link: ChildLink) -> Holder:
        # A step may be repeated over a new link: with the same masks, two messages of it would
        # tell a gradient.
        private = self._new_key()
        public = b"" if private is None else private.public_key().public_bytes_raw()
        link.send(_packed(self._folder / GROUP_FOLDER / "start.safetensors", replace(self._prepared.start, public_key=public)))
        kind, payload = _received(link)
        if kind == END:
            raise StageFailed(f"{self._seat.parent} refuses what this device begins with: its warnings say why.")
        if kind != BEGIN:
            raise BadInput(f"{self._seat.parent} answered a start with {kind!r}, expected the state of a training: give both one version.")
        place, parts = self._folder / GROUP_FOLDER / "begin.safetensors", unpack(payload)
        place.write_bytes(parts["begin"])
        begin = load_begin(place)
        if "initial" in parts:
            self._first.write_bytes(parts["initial"])
        else:
            save_splats(self._first, begin.splats)
        self.initial = load_splats(self._first)
        if begin.public_keys.get(self._folder.name, b"") != public:
            raise LinkLost(self._seat.parent, "it answered a start that was sent over an earlier link")
        holder = join_share(self._prepared, self._folder.name, begin, self._seat, private)
        num_steps, last_total = holder.num_steps, parts.get("total")
        if last_total is not None:
            holder.skip_message()
        while holder.replica.step < num_steps:
            if holder.num_sent < num_steps and not holder.waits_for_total:
                link.send(GRADIENTS + holder.message())
                if begin.group.overlaps and not holder.waits_for_total:
                    continue
            holder.take(_expect(link, TOTAL) if last_total is None else last_total)
            last_total = None
        _expect(link, END)
        if failed := holder.replica.failed_views:
            self._reporter.warn(f"{len(failed)} views or steps of this device failed, the first: {failed[0]}")
        save_begin(self._final, replace(begin, state=holder.replica.state()))
        write_json(self._record, {"key": self._key})
        self._say_done()
        return holder

    def _ended(self) -> Holder | None:
        """The holder as it was after the last step of this training."""
        if not self._record.is_file() or read_json(self._record, ("key",))["key"] != self._key:
            return None
        begin = load_begin(self._final)
        self.initial = load_splats(self._first)
        self._say_done()
        return join_share(self._prepared, self._folder.name, begin, self._seat, self._new_key())

    def _new_key(self) -> X25519PrivateKey | None:
        return X25519PrivateKey.generate() if self._seat.masked else None

    def _say_done(self) -> None:
        mark_done(meeting_of(self._folder, self._seat.parent), self._folder.name)


def _packed(path: Path, start: ShareStart) -> bytes:
    """START, by way of a file named `path` in a folder of the device's."""
    save_start(path, start)
    return pack(START, {path.parent.parent.name: path.read_bytes()})


def _received(link: ChildLink) -> tuple[bytes, bytes]:
    payload = link.receive().payload
    return payload[:1], payload


def _expect(link: ChildLink, kind: bytes) -> memoryview:
    got, payload = _received(link)
    if got != kind:
        raise LinkLost("its edge", f"it sent {got!r} where {kind!r} was due")
    return memoryview(payload)[1:]
