"""Remaining time of a running stage, extrapolated from its own pace. Runs at every redraw.

    left_s = (total − done) · (now − begun) / (done − done at the beginning)

A stage that tells itself what is left of it (structure from motion) is believed; else one of
several steps is timed step by step, since an earlier step predicts nothing about a later one.
Without events the estimate grows and never reaches 0 s; before
the first measurement there is none.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from radiant_app.events import RunLeft, StageProgress

LEAST_S, SURE_S = 1.0, 10.0
LEAST_SHARE = 0.01
"""No estimate in the first second, nor in the first 10 s below this share of a step."""


@dataclass(kw_only=True)
class Pace:
    """The pace of one stage."""

    clock: Callable[[], float] = time.monotonic
    _first: StageProgress | None = None
    _last: StageProgress | None = None
    _step_s: float = 0.0
    _last_s: float = 0.0
    _begun_s: float = field(init=False)

    def __post_init__(self) -> None:
        self._begun_s = self.clock()

    def update(self, event: StageProgress) -> None:
        """Update the stage's progress; a new phase or a lower `done` restarts the measurement."""
        last = self._last
        if last is None or event.phase != last.phase or event.done < last.done:
            self._first, self._step_s = event, self.clock()
        self._last, self._last_s = event, self.clock()

    @property
    def elapsed_s(self) -> float:
        """Seconds since the stage began."""
        return self.clock() - self._begun_s

    @property
    def left_s(self) -> float | None:
        """Remaining seconds of the stage or of its current step; None without an estimate."""
        if self._first is None or self._last is None:
            return None
        if self._last.left_s is not None:
            # Between two events it falls with the clock; a late one makes it wait, never end.
            return max(0.5 * self._last.left_s, self._last.left_s - (self.clock() - self._last_s))
        amount_done, amount_left = self._last.done - self._first.done, self._last.total - self._last.done
        ran_s = self.clock() - self._step_s
        if not (amount_done > 0 and amount_left > 0 and ran_s >= LEAST_S):
            return None
        if ran_s < SURE_S and amount_done < LEAST_SHARE * (amount_done + amount_left):
            return None
        return amount_left * ran_s / amount_done

    @property
    def text(self) -> str:
        """As "elapsed 0:03, left about 0:40"; of several steps, what is left of the current one."""
        left_s = self.left_s
        if left_s is None:
            return f"elapsed {clock_text(self.elapsed_s)}"
        of_step = " in step" * (self._last is not None and self._last.num_steps > 1 and self._last.left_s is None)
        return f"elapsed {clock_text(self.elapsed_s)}, left{of_step} about {clock_text(max(1.0, left_s))}"


@dataclass(kw_only=True)
class RunPace:
    """The time left of a whole run, as it was told last; falls with the clock in between."""

    clock: Callable[[], float] = time.monotonic
    last: RunLeft | None = None
    _told_s: float = 0.0

    def update(self, event: RunLeft) -> None:
        """Take what was told as the time left from now on."""
        self.last, self._told_s = event, self.clock()

    @property
    def elapsed_s(self) -> float:
        """Seconds since the run began."""
        return 0.0 if self.last is None else self.last.elapsed_s + self.clock() - self._told_s

    @property
    def left_s(self) -> float | None:
        """Seconds left, never below half of what was told; None where nothing is foreseen."""
        if self.last is None or self.last.left_s is None:
            return None
        return max(0.5 * self.last.left_s, self.last.left_s - (self.clock() - self._told_s))

    @property
    def share(self) -> float | None:
        """Of the run's time, what has passed; 1 once nothing is left."""
        left_s = self.left_s
        return None if left_s is None else self.elapsed_s / max(self.elapsed_s + left_s, 1e-9)

    @property
    def text(self) -> str:
        """As "elapsed 0:31, left about 2:10 ± 40 %", or "(may be twice as long or more)"."""
        elapsed, left_s = f"elapsed {clock_text(self.elapsed_s)}", self.left_s
        if self.last is None or left_s is None or left_s <= 0:
            return elapsed
        return f"{elapsed}, left about {clock_text(max(1.0, left_s))}{_off_text(self.last.off_percent)}"


def _off_text(percent: float | None) -> str:
    """How far off a time may be; from 100 % on a range would reach below zero."""
    if percent is None:
        return ""
    return f" ± {percent:.0f} %" if round(percent) < 100 else " (may be twice as long or more)"


def run_text(event: RunLeft) -> str:
    """As "training, 2 of 6"."""
    return f"{event.phase}, {event.number} of {event.num_phases}"


def clock_text(seconds: float) -> str:
    """Seconds as a clock shows them: 0:03, 12:40, 1:02:03."""
    minutes, remainder = divmod(math.ceil(seconds - 0.5), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{remainder:02d}" if hours else f"{minutes}:{remainder:02d}"
