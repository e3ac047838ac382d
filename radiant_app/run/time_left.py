"""Remaining time of devices and edges, from the plan's corrected curves. Once per finished node."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field

from radiant_app.events import UPLINK, Event, Listener, StageDone, StageSkipped, StageStarted, TimeLeft
from radiant_core.plan.plans import EdgePlan
from radiant_core.plan.system import System
from radiant_core.plan.timeline.prediction import PlannedStage, correct_system, planned_stages, time_left_s

OVERDUE_FACTOR = 4.0
"""A node is overdue at this many times its prediction: equal photographs differ by less than 2."""
LEAST_S = 60.0
"""No node is overdue before: plans of small scenes leave out starting and loading."""


@dataclass(kw_only=True)
class TimeLeftListener:
    """Passes every event on and adds a `TimeLeft` whenever a node has ended."""

    listen: Listener
    system: System
    edge_plans: Sequence[EdgePlan]
    num_workers: int
    emulated: bool
    """Whether nodes send over emulated links before they end; all of them then run at once."""
    clock: Callable[[], float] = time.monotonic
    deadline_factor: float = 0.0
    """A node is given up after this many times its predicted time; 0: never."""
    _expected_s: dict[str, float] = field(default_factory=dict[str, float])
    _started_s: dict[str, float] = field(default_factory=dict[str, float])
    _measured: dict[tuple[str, str], float] = field(default_factory=dict[tuple[str, str], float])
    _ended: set[str] = field(default_factory=set[str])
    _paused: set[str] = field(default_factory=set[str])
    """Nodes whose duration counts for nothing, since the run was suspended meanwhile."""

    def __post_init__(self) -> None:
        self._planned = planned_stages(self.system, self.edge_plans)
        self._seconds_of = _node_seconds(self._planned, with_sending=self.emulated)
        self._parents = {f"devices/{name}": f"edges/{plan.edge_id}" for plan in self.edge_plans for name in plan.device_ids}
        self._parents |= {f"edges/{plan.edge_id}": "cloud" for plan in self.edge_plans}

    def __call__(self, event: Event) -> None:
        """See `Listener`."""
        self.listen(event)
        node = getattr(event, "stage", "")
        if node.removesuffix(UPLINK) not in self._seconds_of or node.endswith(UPLINK):
            return
        if isinstance(event, StageStarted):
            self._started_s[node] = self.clock()
            self._paused.discard(node)
        elif isinstance(event, StageDone):
            # Shares of the stages do not matter to the correction, only their sum.
            sending_s = sum(row.seconds for row in self._planned if row.node == node and row.stage == "send") if self.emulated else 0.0
            compute = [row for row in self._planned if row.node == node and row.stage != "send"]
            planned_s = sum(row.seconds for row in compute)
            if planned_s > 0 and node not in self._paused:
                factor = max(0.0, event.seconds - sending_s) / planned_s
                self._measured |= {(node, row.stage): row.seconds * factor for row in compute}
            self._end(node)
        elif isinstance(event, StageSkipped):
            self._end(node)

    def overdue_reason(self, node_id: str, ran_s: float) -> str | None:
        """See `Deadlines`."""
        return self._reason_over(node_id, ran_s, OVERDUE_FACTOR)

    def timeout_reason(self, node_id: str, ran_s: float) -> str | None:
        """See `Deadlines`."""
        return self._reason_over(node_id, ran_s, self.deadline_factor) if self.deadline_factor else None

    def exclude_pause(self, node_ids: Collection[str], seconds: float) -> None:
        """See `Deadlines`."""
        for node in self._started_s.keys() & set(node_ids):
            self._paused.add(node)
            self._started_s[node] += seconds

    def _reason_over(self, node_id: str, ran_s: float, factor: float) -> str | None:
        expected_s = self._expected_s.get(node_id)
        # A system file may be wrong by any factor: one node of the tier must be measured first.
        is_measured = any(node.split("/")[0] == node_id.split("/", maxsplit=1)[0] for node, _ in self._measured)
        if expected_s is None or not is_measured or ran_s < max(LEAST_S, factor * expected_s):
            return None
        return f"it has run for {ran_s:.0f} s, where the plan, corrected by what was measured, says {expected_s:.0f} s"

    def _end(self, node: str) -> None:
        self._ended.add(node)
        corrected = planned_stages(correct_system(self.system, self._planned, self._measured), self.edge_plans)
        self._expected_s = expected_s = _node_seconds(corrected, with_sending=self.emulated)
        now_s = self.clock()
        running_s = {name: now_s - started_s for name, started_s in self._started_s.items() if name not in self._ended}
        remaining = [name for name in expected_s if name not in self._ended]
        if not remaining:
            return
        before_s, after_s = (sum(seconds[name] for name in remaining) for seconds in (self._seconds_of, expected_s))
        workers = len(expected_s) if self.emulated else self.num_workers
        seconds = time_left_s(expected_s, self._parents, running_s, self._ended, workers)
        self.listen(TimeLeft(seconds=seconds, correction=after_s / before_s if before_s > 0 else 1.0, after=node))


def _node_seconds(stages: Sequence[PlannedStage], *, with_sending: bool) -> dict[str, float]:
    seconds: dict[str, float] = {}
    for row in stages:
        seconds[row.node] = seconds.get(row.node, 0.0) + (row.seconds if with_sending or row.stage != "send" else 0.0)
    return seconds
