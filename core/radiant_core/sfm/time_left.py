"""How long structure from motion still takes, over all of its phases. At every report of progress.

    left = left of the phase + speed · Σ w of the phases to come,    speed = elapsed / Σ w done

w are CPU seconds of each phase on one core of the machine where they were measured (AMD EPYC,
`radiant bench sfm`, docs/experiments/sfm.md): they say how the phases share the time, the job's own
pace how fast this machine is. What is left of the phase itself is extrapolated from its own pace
once a tenth of it is done. Where photographs are matched and mapped again, phases come back, and
what follows the last one is left; where all is done again thoroughly, all is.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from radiant_core.sfm.config import Phase, Report, SfmConfig, SfmProgress

SURE_SHARE = 0.1
"""From this share of a phase on its own pace is believed."""
LEAST_S = 1.0
"""No estimate in the first second."""
FEATURES_PER_MP = 16_000
"""Features of a megapixel of texture, up to `max_num_features` of a photograph: 17,200 in the town
at 640 px, 14,500 at 384."""
PARALLEL: tuple[Phase, ...] = ("features", "pairs", "matching", "undistorting")
"""Phases that threads share; others hardly gain."""
WAVE = 0.25
"""Threads end their first ones within this share of the time that the first of them took."""
GAIN = 0.75
"""n threads do n^GAIN times the work of one: two gained 1.6 in features and 1.8 in matching."""


def predict_phases(sizes_wh: Sequence[tuple[int, int]], config: SfmConfig) -> Mapping[Phase, float]:
    """Seconds of each phase for photographs of these sizes in pixels."""
    count = len(sizes_wh)
    whole_mp = sum(width * height for width, height in sizes_wh) / 1e6
    reduced_mp = sum(width * height * min(1.0, config.max_image_size_px / max(width, height)) ** 2 for width, height in sizes_wh) / 1e6
    candidates = min(count * (count - 1) / 2, 0.6 * config.num_neighbors * count)
    thorough = config.effort == "thorough"
    pairs = candidates if thorough else min(candidates, 0.7 * config.num_partners * count)
    # Small photographs have fewer features than the limit, to match and to map.
    few = min(1.0, count / 60)
    full = min(1.0, FEATURES_PER_MP * reduced_mp / max(1, count) / config.max_num_features)
    seconds: dict[Phase, float] = {
        "features": (2.2 if thorough else 1.0) * min(0.02 * count + 0.45 * reduced_mp, 0.08 * count + 0.26 * reduced_mp),
        "pairs": 0.0002 * candidates,
        "matching": (0.06 if thorough else 0.017) * pairs * full,
        "mapping": (0.4 if thorough else 0.32) * count * full * few * max(1.0, count / 60) ** 0.35,
        "triangulating": 0.03 * count * full * few**0.75 + 0.01 * whole_mp,
        "refining": 0.08 * count * full**0.5 * few**0.75,
        "undistorting": 0.03 * whole_mp,
    }
    return {phase: value / (config.threads**GAIN if phase in PARALLEL else 1) for phase, value in seconds.items()}


@dataclass(kw_only=True)
class TimeLeft:
    """Adds `SfmProgress.left_s` to what it reports, for a job of these `phases` in their order."""

    report: Report
    phases: Sequence[Phase]
    predicted_s: Mapping[Phase, float]
    clock: Callable[[], float] = time.monotonic
    _begun_s: float = field(init=False)
    _done_s: float = 0.0
    """Predicted seconds of the phases that are over."""
    _phase: SfmProgress | None = None
    """The first report of the current phase."""
    _phase_begun_s: float = 0.0
    _first: tuple[float, int] | None = None
    """When the first ones of the phase were done, and how many: they wait for libraries to load."""
    _waited_s: float = 0.0
    _last: int = -1
    """Number of the latest phase that was reached."""

    def __post_init__(self) -> None:
        self._begun_s = self.clock()

    def __call__(self, progress: SfmProgress) -> None:
        """Report `progress` with the seconds left of the whole job."""
        now_s, number = self.clock(), self.phases.index(progress.phase)
        if self._phase is None or progress.phase != self._phase.phase:
            self._enter(progress, now_s, number)
        self.report(replace(progress, left_s=self._left_s(progress, now_s)))

    def _enter(self, progress: SfmProgress, now_s: float, number: int) -> None:
        if self._phase is not None and self.phases.index(self._phase.phase) == self._last:
            self._done_s += self.predicted_s.get(self._phase.phase, 0.0)
        if progress.phase == "features" and number < self._last:
            # All begins anew.
            self._last, self._done_s = -1, 0.0
        if self._done_s <= 0:
            # What no prediction is for, such as checking photographs, says nothing about the pace.
            self._begun_s = now_s
        self._phase, self._phase_begun_s, self._first = progress, now_s, None
        self._last = max(self._last, number)

    def _left_s(self, progress: SfmProgress, now_s: float) -> float | None:
        assert self._phase is not None
        share = _share(progress.done - self._phase.done, progress.total - self._phase.done)
        own_s = self.predicted_s.get(progress.phase, 0.0)
        again = self.phases.index(progress.phase) < self._last
        done_s = self._done_s + (0.0 if again else own_s * share)
        if now_s - self._begun_s < LEAST_S or done_s <= 0:
            return None
        spent_s = self._spent_s(progress, now_s)
        speed = (self._phase_begun_s - self._begun_s + spent_s) / done_s
        paced = share >= SURE_SHARE
        of_phase_s = spent_s * (1 / share - 1) if paced else speed * own_s * (1 - share)
        return of_phase_s + speed * sum(self.predicted_s.get(phase, 0.0) for phase in self.phases[self._last + 1 :])

    def _spent_s(self, progress: SfmProgress, now_s: float) -> float:
        """How long what is done of the phase took, at the pace since its first."""
        assert self._phase is not None
        since_begun_s = now_s - self._phase_begun_s
        if progress.done > self._phase.done and now_s <= self._phase_begun_s + (1 + WAVE) * self._wait_s(now_s):
            self._first = now_s, progress.done
        if self._first is None or progress.done <= self._first[1]:
            return since_begun_s
        first_s, first = self._first
        return min(since_begun_s, (now_s - first_s) * (progress.done - self._phase.done) / (progress.done - first))

    def _wait_s(self, now_s: float) -> float:
        """How long the first of the phase took."""
        if self._first is None:
            self._waited_s = now_s - self._phase_begun_s
        return self._waited_s


def _share(num_done: float, total: float) -> float:
    return 1.0 if total <= 0 else min(1.0, max(0.0, num_done / total))
