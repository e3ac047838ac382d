"""What each machine of a group does in a step, message by message: nothing here knows of processes.

Holder    contribute ─→ message up      total ─→ take          has photographs and a replica
Relay     messages of its holders ─→ message up                an edge below the root
Root      messages ─→ total, which it takes                    keeps the model and checkpoints
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.train.results import TrainResult, TrainState
from radiant_core.train.together.codec import decode_gradients, decode_limits, encode_gradients, encode_limits, peek_gradients
from radiant_core.train.together.gradients import Layout, StepGradients, sum_gradients
from radiant_core.train.together.masking import FixedPoint, MaskKeys, check_sum, encode_masked, peek_masked, unmask_sum
from radiant_core.train.together.replica import Group, Limits, Replica
from radiant_core.train.together.scrutiny import Scrutiny

_INBOX, _LAST_TOTAL = "inbox", "last_total"


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
        limits, at = decode_limits(total, count)
        gradients = decode_gradients(memoryview(total)[at:], replica.step, count, replica.layout, self._group.views_per_step, checks=False)
        replica.take(gradients, limits)

    def follow(self, other: Holder) -> None:
        """Have the model of a holder in this process that took a step."""
        self.replica.share_model(other.replica)


@dataclass(kw_only=True)
class Inbox:
    """What a sum counts of its senders, and of whom it refused how many messages, and why."""

    most_views: Mapping[str, int]
    """Views of a step that each sender has at most."""
    refused: dict[str, list[str]] = field(default_factory=dict)
    scrutiny: Scrutiny | None = None
    """Refuses what no photographs cause; None: all that is finite counts."""
    masked: bool = False
    """Whether messages are masked, so that only the sum of all can be looked at."""

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
        for name, reason in reasons.items():
            self.refused.setdefault(name, []).append(f"step {step + 1}: {reason}")
        return [gradients for name, gradients in sent.items() if name not in reasons]

    def state(self) -> dict[str, Any]:
        """What a checkpoint keeps, as JSON."""
        return {"refused": self.refused, "scrutiny": None if self.scrutiny is None else self.scrutiny.state()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from `state`."""
        self.refused = {name: list(reasons) for name, reasons in state["refused"].items()}
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
        self.refused.setdefault("all", []).append(f"step {step + 1}: {reason}")
        return []


class Relay:
    """An edge that sums what its holders send, for a root above it."""

    def __init__(self, most_views: Mapping[str, int], layout: Layout, group: Group) -> None:
        self.inbox = Inbox(most_views=most_views, scrutiny=Scrutiny(config=group.config), masked=group.masked)
        self._layout, self._group = layout, group
        self.num_sent = 0

    def message(self, messages: Mapping[str, bytes]) -> bytes:
        """The sum of a step: of the step and the model that most of the messages are of."""
        heads = [head for message in messages.values() if (head := peek_gradients(message) or peek_masked(message)) is not None]
        heads = [(step, count) for step, count in heads if count <= self._group.config.max_num_splats]
        # Of a tie the first sender's.
        step, count = max(heads, key=heads.count) if heads else (self.num_sent, 0)
        total = sum_gradients(self.inbox.read(messages, step, count, self._layout), count, self._layout)
        message = encode_gradients(total, step, count, self._layout, self._group.form)
        self.num_sent = step + 1
        return message


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

    @property
    def senders(self) -> Sequence[str]:
        """Whose messages are summed, in this order."""
        return tuple(self.inbox.most_views)

    def total(self, messages: Mapping[str, bytes]) -> tuple[bytes, StepGradients]:
        """The message of a step for all holders, and the gradients in it; `take_total` takes it."""
        replica, count, layout = self.replica, self.replica.num_splats, self.replica.layout
        self._limits = replica.limits(self._centers)
        message, said = self._say(sum_gradients(self.inbox.read(messages, replica.step, count, layout), count, layout))
        if not said.is_finite:
            # Parts that are finite may add up to what is not.
            self.inbox.refused.setdefault("all", []).append(f"step {replica.step + 1}: the sum is not finite")
            message, said = self._say(StepGradients.nothing(layout))
        self._message = encode_limits(self._limits, count) + message
        return self._message, said

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
        arrays = {**standing.arrays, _LAST_TOTAL: np.frombuffer(last, np.uint8)} if last else standing.arrays
        return TrainState(arrays=arrays, numbers={**standing.numbers, _INBOX: self.inbox.state()})

    def restore(self, state: TrainState) -> None:
        """Go on from `state`; BadInput where it is of other inputs or configuration."""
        self.replica.restore(state)
        self.inbox.restore(state.numbers[_INBOX])
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
        limits, at = decode_limits(total, replica.num_splats)
        body = memoryview(total)[at:]
        views = self._group.views_per_step
        return decode_gradients(body, replica.step, replica.num_splats, replica.layout, views, checks=False), limits

    def result(self) -> TrainResult:
        """The model of the group."""
        return self.replica.result(self._centers)
