"""The root of machines that train together: its process, once per run.

    START of all ─ begin ─→ BEGIN ─ ( GRADIENTS of all ─ sum ─→ TOTAL ─ step )… ─ END ─ the model

It alone saves checkpoints: a machine that comes back is sent its state, and so are all where the
root itself was started again.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from radiant_app.reporting import EventReporter
from radiant_app.together.exchange import BEGIN, GONE_S, RELAY_STATE, TOTAL, Answer, Children, begin_anew, pack, unpack_sum
from radiant_app.together.links import LinkLost, LinkRules, ParentLinks
from radiant_app.together.places import ENDED_NAME, GROUP_FOLDER, INITIAL, LATE_S, meeting_of
from radiant_app.together.playing import play_machine
from radiant_core import __version__
from radiant_core.errors import BadInput, RadiantError
from radiant_core.hierarchy.codec import task_key
from radiant_core.hierarchy.device import report_result
from radiant_core.hierarchy.group_codec import load_start, save_begin
from radiant_core.hierarchy.groups import GroupTraining
from radiant_core.hierarchy.messages import Training
from radiant_core.hierarchy.reporter import Machine, fit_options
from radiant_core.hierarchy.together import Begun, GroupStart, ShareStart, begin_group, check_start
from radiant_core.io.records import save_splats
from radiant_core.io.run_store import content_key, read_json, write_json
from radiant_core.train.results import TrainResult
from radiant_core.train.together.replica import Replica
from radiant_core.train.together.roles import Root
from radiant_core.train.trainer import Checkpoints, FitOptions


@dataclass(frozen=True, kw_only=True, eq=False)
class Led:
    """The training of a group: what devices began with, by name, and what was refused of whom, and
    why; figures of its messages."""

    starts: Mapping[str, ShareStart]
    result: TrainResult
    refused: Mapping[str, str]
    summary: Mapping[str, float | int]


def lead(folder: Path, plan: GroupTraining, task: Training, num_dealt: Mapping[str, int], reporter: EventReporter, machine: Machine) -> Led:
    """Train the model of a group with all devices that come.

    Args:
        folder: the root's folder in its run.
        plan: the group.
        task: settings of training.
        num_dealt: photographs of each device, at most as many cameras may it send.
        reporter: hears decisions, warnings and progress.
        machine: checkpoints and clock.

    Returns:
        The model.

    Raises:
        StageFailed: no device comes, or none is left.
    """
    meeting = meeting_of(folder, plan.root)
    meeting.mkdir(parents=True, exist_ok=True)
    # An edge waits for its devices before it sends.
    limit_s = GONE_S + LATE_S if plan.has_relays else LATE_S
    # Edges have taken off the masks of their devices.
    needs_all = plan.masked and not plan.has_relays
    with play_machine() as played:
        links = ParentLinks(meeting, list(plan.of_senders), LinkRules(limit_s=limit_s, work=played.work), played.down)
        children = Children(links=links, names=list(plan.of_senders), meeting=meeting, warn=reporter.warn, needs_all=needs_all)
        leader = _Leader(folder=folder, plan=plan, task=task, num_dealt=num_dealt, reporter=reporter, children=children)
        try:
            return leader.run(machine)
        finally:
            links.close()


class _Leader:
    def __init__(
        self,
        *,
        folder: Path,
        plan: GroupTraining,
        task: Training,
        num_dealt: Mapping[str, int],
        reporter: EventReporter,
        children: Children,
    ) -> None:
        self._place, self._plan, self._task, self._num_dealt = folder / GROUP_FOLDER, plan, task, num_dealt
        self._reporter, self._children = reporter, children
        self._place.mkdir(exist_ok=True)
        self._record, self._task_key = self._place / ENDED_NAME, content_key(__version__, task_key(task), dict(num_dealt))
        self.refused: dict[str, str] = {}
        self._public_keys: dict[str, bytes] = {}

    def run(self, machine: Machine) -> Led:
        ended = self._sent_before()
        sent = self._children.starts() if ended is None else ended
        starts = self._admitted({device: data for parts in sent.values() for device, data in parts.items()})
        start = begin_group(starts, self._plan, self._task.train, self._reporter)
        options = fit_options(self._task.backend, self._reporter, machine, lambda: "")
        replica = Replica(start.initial, start.group, options)
        checkpoints: Checkpoints = machine.checkpoints(lambda: self._key(start))
        before = Replica(start.initial, start.group, FitOptions(backend=self._task.backend)) if start.group.overlaps else None
        senders, relays = self._plan.of_senders, self._plan.has_relays
        root = Root(replica, senders, start.camera_centers, start.group, sums_edges=relays, before=before)
        if (state := checkpoints.load()) is not None:
            root.restore(state)

        def answer(name: str, parts: Mapping[str, bytes]) -> bytes:
            if not self._admitted(parts) and not self._plan.has_relays:
                raise BadInput(self.refused.get(name, "it is another one's"))
            return self._begin(start, root, name, parts)

        if ended is None:
            usable = {name: parts for name, parts in sent.items() if self._plan.has_relays or any(device in starts for device in parts)}
            self._children.begin({name: self._begin(start, root, name, parts) for name, parts in usable.items()})
            for name in sorted(set(sent) - set(usable)):
                self._children.refuse(name, self.refused.get(name, "it is another one's"))
            self._take_steps(root, answer, checkpoints)
            # What is done is done, whatever becomes of this process before its folder is sealed.
            checkpoints.save(replica.step, root.state)
            write_json(self._record, {"key": self._task_key, "senders": {name: list(parts) for name, parts in sent.items()}})
        self._children.finish(answer)
        for warning in root.inbox.refusals():
            self._reporter.warn(warning)
        traffic = self._children.links.traffic.values()
        summary = {
            "received_bytes": sum(link_traffic.received_bytes for link_traffic in traffic),
            "sent_bytes": sum(link_traffic.sent_bytes for link_traffic in traffic),
            "num_refused": root.inbox.num_refused,
        }
        result = root.result()
        report_result(start.group.config, start.initial, result, self._reporter)
        return Led(starts=starts, result=result, refused=self.refused, summary=summary)

    def _sent_before(self) -> dict[str, dict[str, bytes]] | None:
        """What devices began with, where all steps were taken before this process was restarted."""
        if not self._record.is_file() or (record := read_json(self._record, ("key", "senders")))["key"] != self._task_key:
            return None
        files = {name: {device: self._place / f"{device}.safetensors" for device in devices} for name, devices in record["senders"].items()}
        return {name: {device: path.read_bytes() for device, path in paths.items()} for name, paths in files.items()}

    def _take_steps(self, root: Root, answer: Answer, checkpoints: Checkpoints) -> None:
        replica, needs_all = root.replica, self._children.needs_all
        while not replica.is_done:
            try:
                messages = self._children.gradients(begin_anew if needs_all else answer)
            except LinkLost as lost:
                self._reporter.warn(f"{lost} All devices begin anew where the training stands.")
                sent = self._children.restart(lost.reason)
                self._admitted({device: data for parts in sent.values() for device, data in parts.items()})
                self._children.begin({name: answer(name, parts) for name, parts in sent.items()})
                continue
            if self._plan.has_relays:
                messages = self._sums(root, messages)
            message, total = root.total(messages)
            self._children.send(TOTAL, message)
            for warning in root.inbox.take_warnings():
                self._reporter.warn(warning)
            root.take(total)
            checkpoints.offer(replica.step, root.state)

    def _sums(self, root: Root, messages: Mapping[str, bytes]) -> dict[str, bytes]:
        """What edges sum in a step; the root keeps what they remember of their devices."""
        unpacked = {edge: unpack_sum(payload) for edge, payload in messages.items()}
        root.relay_states |= {edge: state for edge, (_, state) in unpacked.items()}
        return {edge: message for edge, (message, _) in unpacked.items()}

    def _admitted(self, parts: Mapping[str, bytes]) -> dict[str, ShareStart]:
        """The starts that can be used; others are refused by name."""
        usable: dict[str, ShareStart] = {}
        for device in self._plan.of_devices:
            if device not in parts:
                continue
            path = self._place / f"{device}.safetensors"
            path.write_bytes(parts[device])
            try:
                start = load_start(path)
                problem = check_start(start, self._num_dealt.get(device, 0))
            except RadiantError as error:
                start, problem = None, str(error)
            if start is None or problem is not None:
                self.refused[device] = problem or ""
                self._public_keys.pop(device, None)
                self._reporter.warn(f"the start of {device} is refused: {problem}")
            else:
                usable[device] = start
                self.refused.pop(device, None)
                self._public_keys[device] = start.public_key
        return usable

    def _begin(self, start: GroupStart, root: Root, sender: str, devices: Mapping[str, bytes]) -> bytes:
        offsets = {device: offset for device, offset in start.offsets.items() if device in devices}
        path, keys = self._place / "begin.safetensors", self._keys_beside(devices) if self._plan.masked else {}
        standing, last_total = root.standing()
        begun = Begun(group=start.group, state=standing, offsets=offsets, antialiased=start.initial.antialiased, public_keys=keys)
        save_begin(path, begun)
        parts = {"begin": path.read_bytes()}
        if last_total:
            parts["total"] = last_total
        if state := root.relay_states.get(sender):
            parts[RELAY_STATE] = state
        if root.replica.step:
            save_splats(self._place / INITIAL, start.initial)
            parts["initial"] = (self._place / INITIAL).read_bytes()
        refused = {device: self.refused[device] for device in devices if device in self.refused}
        return pack(BEGIN, {**parts, "refused": json.dumps(refused).encode()} if refused else parts)

    def _keys_beside(self, devices: Mapping[str, bytes]) -> dict[str, bytes]:
        """The public keys of all whose sum has these devices; BadInput where one sent none."""
        names = [name for views in self._plan.views.values() if views.keys() & devices.keys() for name in views]
        for name in names:
            if not self._public_keys.get(name):
                reason = self.refused.get(name, "it sent no public key")
                raise BadInput(f"a masked training cannot go on without {name} ({reason}): run again with --resume, or without masks.")
        return {name: self._public_keys[name] for name in names}

    def _key(self, start: GroupStart) -> str:
        return content_key(__version__, start.group, start.initial.arrays(), start.camera_centers, dict(self._plan.of_devices))
