"""Time left of a whole run, from what was foreseen of its phases and how long those took that are
over. At every event.

    left = Σ left of the phases that have begun + Σ v P of those to come

P are predicted seconds of a phase (`foreseen.py`) and v = Σ measured / Σ P over the phases of its
unit of which a tenth is done, else over all of them, else what else runs here says. A phase that
took t for the share s of its stages has left

    s · t (1 − s) / s  +  (1 − s) · max(v P − t, (1 − s) v P / 2),

more and more by its own pace; structure from motion tells what is left of it. Stages of a phase
count alike.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from radiant_app.events import (
    PHASES,
    UPLINK,
    Event,
    Foreseen,
    Listener,
    Outlined,
    RunLeft,
    StageDone,
    StageProgress,
    StageSkipped,
    StageStarted,
)
from radiant_core.aggregate.tree import refines_for

SECONDS_BETWEEN = 2.0
"""Between two events while a phase goes on."""
SURE_SHARE = 0.1
"""From this share of a phase on, its pace corrects the others."""
PLACING, TRAINING, JOINING, REFINING, SCORING, REPORT = range(len(PHASES))
REPORT_SHARES = (0.65, 0.25, 0.1)
"""Of the time of the report, what its steps take: 40 to 55, 12 to 15 and 5 to 9 s of two runs."""
UNIT_HERE, UNIT_PLANNED = 0, 1
"""Units of what runs on this machine, and of machines whose costs are known."""
OFF_PERCENT = (115.0, 45.0, 40.0, 40.0, 55.0, 55.0)
"""By phase: about what estimates made in it were off by, in two runs of one small scene on a busy
machine (docs/experiments/planner.md)."""


def phase_of(stage: str) -> int | None:
    """The index in `PHASES` of a stage or node; None for what belongs to none."""
    tier, last = stage.split("/", maxsplit=1)[0], stage.rsplit("/", 1)[-1]
    if stage.endswith(UPLINK):
        return None
    if refines_for(stage) != stage:
        return REFINING
    if last == "score" or stage == "evaluation":
        return SCORING
    return {"sfm": PLACING, "positions": PLACING, "planning": PLACING, "devices": TRAINING, "edges": JOINING, "cloud": JOINING}.get(
        tier, REPORT if stage == "report" else None
    )


@dataclass(kw_only=True)
class _Phase:
    """What was heard of one phase."""

    expected: int = 1
    """Stages that it is known to have."""
    begun_s: float | None = None
    ended_s: float | None = None
    shares: dict[str, float] = field(default_factory=dict[str, float])
    """Stage → its share done."""
    skipped: set[str] = field(default_factory=set[str])
    left_s: float | None = None
    """Seconds that a stage has told to be left, and when."""
    told_s: float = 0.0

    @property
    def goes_on(self) -> bool:
        """Whether it has begun and is not over."""
        return bool(self.shares) and self.ended_s is None

    @property
    def share(self) -> float:
        """Of its stages, what is done; what an earlier run did took no time and does not count."""
        counted = [share for stage, share in self.shares.items() if stage not in self.skipped]
        return min(1.0, sum(counted) / max(self.expected - len(self.skipped), len(counted), 1))


@dataclass(kw_only=True)
class WholeRun:
    """Passes every event on and adds a `RunLeft` when a phase begins or ends, and at intervals."""

    listen: Listener
    clock: Callable[[], float] = time.monotonic
    slowdown: float = 1.0
    """Seconds of this machine for each one that is foreseen, before any phase was measured."""
    _phases: tuple[_Phase, ...] = field(default_factory=lambda: tuple(_Phase() for _ in PHASES))
    _foreseen: Foreseen | None = None
    _current: int = 0
    _top: int = 0
    """The last phase that has begun."""
    _due_s: float = float("-inf")
    _begun_s: float = field(init=False)

    def __post_init__(self) -> None:
        self._begun_s = self.clock()

    def __call__(self, event: Event) -> None:
        """See `Listener`."""
        if self._due_s == float("-inf"):
            # Before all else, so that nobody counts stages that a plan will change.
            self._due_s = self.clock() + SECONDS_BETWEEN
            self.listen(self.run_left)
        self.listen(event)
        before = self._current
        if isinstance(event, Foreseen):
            self._foreseen, self._due_s = event, self.clock()
        elif isinstance(event, Outlined):
            self._expect(event.stages)
        elif isinstance(event, StageStarted | StageProgress | StageDone | StageSkipped):
            self._hear(event)
        else:
            return
        is_over = self._phases[REPORT].ended_s is not None
        if self._current != before or is_over or self.clock() >= self._due_s:
            self._due_s = self.clock() + SECONDS_BETWEEN
            self.listen(self.run_left)

    @property
    def run_left(self) -> RunLeft:
        """How far the run is now."""
        seconds = self._left_s()
        return RunLeft(
            phase=PHASES[self._current],
            number=self._current + 1,
            num_phases=len(PHASES),
            elapsed_s=self.clock() - self._begun_s,
            left_s=seconds,
            off_percent=None if seconds is None else OFF_PERCENT[self._current],
        )

    def _expect(self, stages: tuple[str, ...]) -> None:
        counts = [0] * len(PHASES)
        for stage in stages:
            if (index := phase_of(stage)) is not None:
                counts[index] += 1
        for phase, count in zip(self._phases, counts, strict=True):
            phase.expected = max(count, 1)

    def _hear(self, event: StageStarted | StageProgress | StageDone | StageSkipped) -> None:
        index = phase_of(event.stage)
        if index is None:
            return
        phase, now_s = self._phases[index], self.clock()
        if isinstance(event, StageSkipped):
            phase.skipped.add(event.stage)
            phase.shares[event.stage] = 1.0
        else:
            phase.begun_s = now_s if phase.begun_s is None else phase.begun_s
            phase.shares[event.stage] = _share_of(event, phase.shares.get(event.stage, 0.0))
        if isinstance(event, StageProgress) and event.left_s is not None:
            phase.left_s, phase.told_s = event.left_s, now_s
        is_over = len(phase.shares) >= phase.expected and min(phase.shares.values()) >= 1.0
        phase.ended_s = now_s if is_over else None
        self._top = max(self._top, index)
        if event.stage == "cloud" or index > JOINING:
            # What has failed, or came to nothing, is waited for no longer.
            for earlier in self._phases[:index]:
                earlier.ended_s = now_s if earlier.ended_s is None else earlier.ended_s
        # Some edges join while devices of others train.
        self._current = next((number for number in range(self._top) if self._phases[number].goes_on), self._top)

    def _left_s(self) -> float | None:
        if self._foreseen is None:
            return None
        return sum(self._left_of(index) for index in range(self._current, len(PHASES)))

    def _left_of(self, index: int) -> float:
        assert self._foreseen is not None
        phase, planned_s = self._phases[index], self._foreseen.phases_s[index]
        if phase.ended_s is not None:
            return 0.0
        todo = 1.0 - len(phase.skipped) / max(phase.expected, 1)
        if phase.begun_s is None:
            return self._speed(index) * planned_s * todo
        if phase.left_s is not None:
            return max(0.5 * phase.left_s, phase.left_s - (self.clock() - phase.told_s))
        share, ran_s = phase.share, self.clock() - phase.begun_s
        expected_s = self._speed(index) * planned_s * todo
        # A phase that takes longer than expected has half of it left until its own pace says more.
        foreseen_s = max(expected_s - ran_s, 0.5 * expected_s * (1.0 - share))
        return (1.0 - share) * (ran_s + foreseen_s)

    def _speed(self, index: int) -> float:
        """Measured over predicted seconds of the phases that are like this one."""
        assert self._foreseen is not None
        units = self._foreseen.units
        for alike in ([units[index] == unit for unit in units], [True] * len(units)):
            pairs = [pair for number, pair in self._measured() if alike[number]]
            planned_s = sum(planned for planned, _ in pairs)
            if planned_s > 0:
                return sum(measured for _, measured in pairs) / planned_s
        return self.slowdown if units[index] == UNIT_HERE else 1.0

    def _measured(self) -> Iterator[tuple[int, tuple[float, float]]]:
        """(index, (predicted, measured seconds)) of every phase of which a tenth is done here."""
        assert self._foreseen is not None
        for index, phase in enumerate(self._phases):
            share = 1.0 if phase.ended_s is not None else phase.share
            if phase.begun_s is None or phase.skipped or share < SURE_SHARE:
                continue
            until_s = self.clock() if phase.ended_s is None else phase.ended_s
            yield index, (self._foreseen.phases_s[index] * share, until_s - phase.begun_s)


def _share_of(event: StageStarted | StageProgress | StageDone, before: float) -> float:
    if isinstance(event, StageDone):
        return 1.0
    if isinstance(event, StageStarted):
        return 0.0
    if event.num_steps > 1:
        inner, step = min(1.0, event.done / event.total) if event.total > 0 else 0.0, max(event.step, 1) - 1
        shares = REPORT_SHARES if event.stage == "report" else (1 / event.num_steps,) * event.num_steps
        return max(before, 0.999 * min(1.0, sum(shares[:step]) + inner * shares[min(step, len(shares) - 1)]))
    return min(0.999, event.done / event.total) if event.total > 0 else before
