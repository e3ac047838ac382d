"""What each machine of a group does in a step, message by message: nothing here knows of processes.

Holder    contribute ─→ message up      total ─→ take          has photographs and a replica
Relay     messages of its holders ─→ message up                an edge below the root
Root      messages ─→ total, which it takes                    keeps the model and checkpoints
"""

from __future__ import annotations

import json
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.train.results import TrainResult, TrainState
from radiant_core.train.together.codec import (
    decode_gradients,
    decode_limits,
    encode_gradients,
    encode_limits,
    encode_nothing,
    peek_gradients,
    peek_total,
)
from radiant_core.train.together.gradients import Layout, StepGradients, sum_gradients
from radiant_core.train.together.masking import FixedPoint, MaskKeys, check_sum, encode_masked, peek_masked, unmask_sum
from radiant_core.train.together.replica import Group, Limits, Replica
from radiant_core.train.together.scrutiny import Scrutiny

_INBOX, _LAST_TOTAL, _RELAY = "inbox", "last_total", "relay."
MOST_STATE_BYTES = 1 << 20
"""Of what an edge remembers of its senders, compressed."""


class Holder:
    """A machine that has photographs of a group."""

    def __init__(self, replica: Replica, group: Group, masks: MaskKeys | None = None) -> None:
        """`masks`: the keys of a group that is `masked`."""
        if group.masked != (masks is not None):
            raise BadInput("a device of a masked group needs keys for its masks, and one of another has none.")
        self.replica, self._group, self.masks = replica, group, masks
        self.num_sent = replica.step
        """Steps that it has contributed to."""

    @property
    def num_steps(self) -> int:
        """Those of the whole training."""
        return self._group.stepping.num_steps

    @property
    def waits_for_total(self) -> bool:
        """Whether the total of the step before must be taken before the next contribution."""
        behind = self.num_sent > self.replica.step
        return behind and (not self._group.overlaps or self.num_sent > self.replica.step + 1 or self.replica.next_step_edits)

    def message(self) -> bytes:
        """The gradients of its views of the next step that it has not contributed to."""
        replica = self.replica
        gradients = replica.contribute(self.num_sent)
        if self.masks is not None:
            message = encode_masked(gradients, self.num_sent, replica.num_splats, self.unit_of(self.masks), self.masks)
        else:
            message = encode_gradients(gradients, self.num_sent, replica.num_splats, replica.layout, self._group.form)
        self.num_sent += 1
        return message

    def unit_of(self, masks: MaskKeys) -> FixedPoint:
        """That of the next masked message."""
        return FixedPoint.of(self.replica.magnitudes, len(masks.pairs) + 1)

    def skip_message(self) -> None:
        """Count the next message as sent: that of a step whose total is there already."""
        self.num_sent += 1

    def take(self, total: bytes | memoryview) -> None:
        """Take the next step by the message of the root. BadInput where it is damaged."""
        replica, count = self.replica, self.replica.num_splats
        limits, at = decode_limits(total, replica.step, count)
        gradients = decode_gradients(memoryview(total)[at:], replica.step, count, replica.layout, self._group.views_per_step, checks=False)
        replica.take(gradients, limits)

    def follow(self, source: Holder) -> None:
        """Have the model of a holder in this process that took a step."""
        self.replica.share_model(source.replica)


@dataclass(kw_only=True)
class Refusals:
    """How many messages of a sender were refused, and why the first."""

    count: int
    first: str


@dataclass(kw_only=True)
class Inbox:
    """What a sum counts of its senders, and of whom it refused how many messages, and why."""

    most_views: Mapping[str, int]
    """Views of a step that each sender has at most."""
    refused: dict[str, Refusals] = field(default_factory=dict)
    scrutiny: Scrutiny | None = None
    """Refuses what no photographs cause; None: all that is finite counts."""
    masked: bool = False
    """Whether messages are masked, so that only the sum of all can be looked at."""

    def take_warnings(self) -> list[str]:
        """What has been noticed since it was last asked for."""
        return [] if self.scrutiny is None else self.scrutiny.take_warnings()

    @property
    def num_refused(self) -> int:
        """Messages of all senders that were refused."""
        return sum(refusal.count for refusal in self.refused.values())

    def refusals(self) -> list[str]:
        """A warning for each sender of whom messages were refused."""
        return [f"{refusal.count} messages of {name} were refused, the first: {refusal.first}" for name, refusal in self.refused.items()]

    def refuse(self, step: int, reasons: Mapping[str, str]) -> None:
        """Count a refused message of each of these senders."""
        for name, reason in reasons.items():
            before = self.refused.setdefault(name, Refusals(count=0, first=f"step {step + 1}: {reason}"))
            before.count += 1

    def read(self, messages: Mapping[str, bytes], step: int, num_splats: int, layout: Layout) -> list[StepGradients]:
        """The gradients that can be used, in the order of the senders; of masked ones their sum."""
        if self.masked:
            return self._read_masked(messages, step, num_splats, layout)
        sent, reasons = dict[str, StepGradients](), dict[str, str]()
        for name in self.most_views:
            if name not in messages:
                continue
            try:
                sent[name] = decode_gradients(messages[name], step, num_splats, layout, self.most_views[name])
            except BadInput as error:
                reasons[name] = str(error)
        if self.scrutiny is not None:
            reasons |= self.scrutiny.refuse(step, sent, num_splats, layout)
        self.refuse(step, reasons)
        return [gradients for name, gradients in sent.items() if name not in reasons]

    def state(self) -> dict[str, Any]:
        """What a checkpoint keeps, as JSON."""
        refused = {name: [refusal.count, refusal.first] for name, refusal in self.refused.items()}
        return {"refused": refused, "scrutiny": None if self.scrutiny is None else self.scrutiny.state()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from `state`."""
        self.refused = {name: Refusals(count=int(count), first=str(first)) for name, (count, first) in state["refused"].items()}
        if self.scrutiny is not None and state["scrutiny"] is not None:
            self.scrutiny.restore(state["scrutiny"])

    def _read_masked(self, messages: Mapping[str, bytes], step: int, num_splats: int, layout: Layout) -> list[StepGradients]:
        try:
            total = unmask_sum(messages, list(self.most_views), step, num_splats, layout)
            reason = None if self.scrutiny is None else check_sum(total, sum(self.most_views.values()), self.scrutiny.config, layout)
        except BadInput as error:
            total, reason = None, str(error)
        if total is not None and reason is None:
            return [total]
        # Behind masks nobody knows whose fault it is.
        self.refuse(step, {"all": str(reason)})
        return []


class Relay:
    """An edge that sums what its holders send, for a root above it, which keeps its state."""

    def __init__(self, most_views: Mapping[str, int], layout: Layout, group: Group) -> None:
        self.inbox = Inbox(most_views=most_views, scrutiny=Scrutiny(config=group.config), masked=group.masked)
        self._layout, self._group = layout, group
        self._step, self._count = 0, None

    def begin(self, step: int, num_splats: int | None, state: bytes = b"") -> None:
        """The next step (from 0), of a model of `num_splats` Gaussians, None: unknown; `state`:
        what `state` said after the step before, empty where there was none. BadInput where that is
        damaged."""
        self._step, self._count = step, num_splats
        if not state:
            return
        unpacking = zlib.decompressobj()
        try:
            self.inbox.restore(json.loads(unpacking.decompress(state, 16 * MOST_STATE_BYTES)))
        except (zlib.error, ValueError, KeyError, TypeError) as error:
            raise BadInput(f"what is known of the devices of an edge is damaged ({error}): remove the checkpoint of the root.") from error

    def state(self) -> bytes:
        """What is known of the senders, for the root's checkpoints, some kilobytes."""
        return zlib.compress(json.dumps(self.inbox.state()).encode(), 1)

    def message(self, messages: Mapping[str, bytes]) -> bytes:
        """The sum of the next step."""
        step, count = self._step, self._agreed(messages) if self._count is None else self._count
        if count is None:
            return encode_nothing(step)
        total = sum_gradients(self.inbox.read(messages, step, count, self._layout), count, self._layout)
        return encode_gradients(total, step, count, self._layout, self._group.form) if count else encode_nothing(step)

    def follow(self, total: bytes | memoryview) -> None:
        """Note by the root's message of a step which one is next, and how many Gaussians its model
        has, unless that step adds or removes some."""
        head = peek_total(total)
        if head is None:
            raise BadInput("what came for a step is no sum of gradients: the root has another version.")
        step, count = head
        self._step, self._count = step + 1, None if self._group.edits(step) else count

    def _agreed(self, messages: Mapping[str, bytes]) -> int | None:
        """How many Gaussians most senders say that the model has; None where as many say something
        else: then nobody is believed, and the next total tells."""
        heads = {name: peek_gradients(message) or peek_masked(message) for name, message in messages.items()}
        counts = {name: head[1] for name, head in heads.items() if head is not None and head[0] == self._step}
        counts = {name: count for name, count in counts.items() if count <= self._group.config.max_num_splats}
        ranked = Counter(counts.values()).most_common(2)
        if len(ranked) == 2 and ranked[0][1] == ranked[1][1]:
            contradiction = "; ".join(f"{name}: {count}" for name, count in counts.items())
            reason = f"senders contradict each other on how many Gaussians the model has ({contradiction}), and none of them counts"
            self.inbox.refuse(self._step, dict.fromkeys(counts, reason))
            return None
        return ranked[0][0] if ranked else 0


class Root:
    """The machine at which all gradients of a group arrive, which has its model."""

    def __init__(
        self,
        replica: Replica,
        most_views: Mapping[str, int],
        camera_centers: FloatArray,
        group: Group,
        *,
        sums_edges: bool = False,
        before: Replica | None = None,
    ) -> None:
        """`camera_centers` (C,3) of all photographs; `most_views` of a step by sender;
        `sums_edges`: senders are edges, which took off the masks; `before`: a replica as
        `replica`, which stays a step behind where steps overlap, so that a holder that comes back
        has the model that its next gradients would have been of."""
        masked = group.masked and not sums_edges
        self.replica = replica
        self.inbox = Inbox(most_views=most_views, scrutiny=Scrutiny(config=group.config), masked=masked)
        self._centers, self._group = camera_centers, group
        self._before = before if group.overlaps else None
        self._message, self._last_total = b"", b""
        self.relay_states: dict[str, bytes] = {}
        """What each edge remembers of its senders, after the last step."""

    @property
    def senders(self) -> Sequence[str]:
        """Whose messages are summed, in this order."""
        return tuple(self.inbox.most_views)

    def total(self, messages: Mapping[str, bytes]) -> tuple[bytes, StepGradients]:
        """The message of a step for all holders, and the gradients in it; `take_total` takes it."""
        replica, count, layout = self.replica, self.replica.num_splats, self.replica.layout
        self._limits = replica.limits(self._centers)
        message, total = self._say(sum_gradients(self.inbox.read(messages, replica.step, count, layout), count, layout))
        if not total.is_finite:
            # Parts that are finite may add up to what is not.
            self.inbox.refuse(replica.step, {"all": "the sum is not finite"})
            message, total = self._say(StepGradients.nothing(layout))
        self._message = encode_limits(self._limits, replica.step, count) + message
        return self._message, total

    def _say(self, total: StepGradients) -> tuple[bytes, StepGradients]:
        """The message of a sum, and what it says, rounded, which is what is taken."""
        replica, count, layout = self.replica, self.replica.num_splats, self.replica.layout
        message = encode_gradients(total, replica.step, count, layout, self._group.form)
        return message, decode_gradients(message, replica.step, count, layout, self._group.views_per_step, checks=False)

    def standing(self) -> tuple[TrainState, bytes]:
        """Where a holder begins that comes now: a model, and the total that it takes next, empty
        where it is to send gradients of that model first."""
        if self._before is None or not self._last_total:
            return self.replica.state(), b""
        return self._before.state(), self._last_total

    def state(self) -> TrainState:
        """What a checkpoint keeps: the model, and what is known of its senders, which devices are
        not told."""
        standing, last = self.standing()
        arrays = {**standing.arrays, _LAST_TOTAL: np.frombuffer(last, np.uint8)} if last else dict(standing.arrays)
        arrays |= {_RELAY + edge: np.frombuffer(state, np.uint8) for edge, state in self.relay_states.items()}
        return TrainState(arrays=arrays, numbers={**standing.numbers, _INBOX: self.inbox.state()})

    def restore(self, state: TrainState) -> None:
        """Go on from `state`; BadInput where it is of other inputs or configuration."""
        self.replica.restore(state)
        self.inbox.restore(state.numbers[_INBOX])
        self.relay_states = {name.removeprefix(_RELAY): array.tobytes() for name, array in state.arrays.items() if name.startswith(_RELAY)}
        if self._before is None:
            return
        self._before.restore(state)
        if (last := state.arrays.get(_LAST_TOTAL)) is not None:
            self._last_total = last.tobytes()
            self.replica.take(*self._read(self.replica, self._last_total))

    def take(self, total: StepGradients) -> None:
        """Take the step of `total`, whose message is on its way."""
        if self._before is not None and self._last_total:
            self._before.take(*self._read(self._before, self._last_total))
        self.replica.take(total, self._limits)
        self._last_total = self._message

    def _read(self, replica: Replica, total: bytes) -> tuple[StepGradients, Limits | None]:
        limits, at = decode_limits(total, replica.step, replica.num_splats)
        body = memoryview(total)[at:]
        views = self._group.views_per_step
        return decode_gradients(body, replica.step, replica.num_splats, replica.layout, views, checks=False), limits

    def result(self) -> TrainResult:
        """The model of the group."""
        return self.replica.result(self._centers)
