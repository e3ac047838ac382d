"""The stream of typed events of long work, read by command line, window and report.

A worker process writes one event per line of standard output as JSON; `decode` parses it.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, get_args

from radiant_core.decisions import Decision
from radiant_core.errors import StageFailed

UPLINK = "/uplink"
"""Suffix of the stage in which a node sends its model to its parent over an emulated link."""


@dataclass(frozen=True, kw_only=True)
class StageStarted:
    """A stage or node of the tree begins."""

    stage: str
    machine: str = ""
    """Machine of a cluster."""
    emulated: bool = False
    """Whether its time is that of an emulated machine or link."""


@dataclass(frozen=True, kw_only=True)
class Outlined:
    """The stages of a run as far as they are known; a later event replaces it."""

    stages: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class StageProgress:
    """Progress of a stage: `done` of `total` in any unit, of the current step if it has several."""

    stage: str
    done: float
    total: float
    note: str = ""
    phase: str = ""
    """What the current step does, such as "matching"; `done` restarts with a new one."""
    step: int = 0
    """Number of the step, from 1; 0 without steps."""
    num_steps: int = 0
    left_s: float | None = None
    """Seconds left of the whole stage, where the stage itself can tell."""

    @property
    def doing(self) -> str:
        """Such as "matching, step 3 of 6"; empty for a stage without steps."""
        return f"{self.phase}, step {self.step} of {self.num_steps}" if self.num_steps > 1 else self.phase


@dataclass(frozen=True, kw_only=True)
class StageDone:
    """A stage finished; `seconds` is its own time."""

    stage: str
    seconds: float
    emulated: bool = False


@dataclass(frozen=True, kw_only=True)
class MemoryPeaked:
    """Peak memory of the process of a stage, its libraries included."""

    stage: str
    peak_bytes: int


@dataclass(frozen=True, kw_only=True)
class TimeLeft:
    """Time left of devices and edges after the node `after`; `correction`: over the plan's time."""

    seconds: float
    correction: float
    after: str


@dataclass(frozen=True, kw_only=True)
class StageSkipped:
    """A stage was finished by an earlier run and its files are intact."""

    stage: str
    emulated: bool = False


@dataclass(frozen=True, kw_only=True)
class Warned:
    """A problem that stops nothing."""

    stage: str
    message: str


@dataclass(frozen=True, kw_only=True)
class Decided:
    """Something was skipped or chosen."""

    decision: Decision


@dataclass(frozen=True, kw_only=True)
class Failed:
    """A worker ends without a result; `exit_code` is that of its error."""

    stage: str
    message: str
    exit_code: int
    cannot_write: bool = False
    """Whether it is a `CannotWrite`, after which no file is removed."""


@dataclass(frozen=True, kw_only=True)
class Heartbeat:
    """The process of a stage is alive; only the executor receives it."""

    stage: str


Event = Heartbeat | Outlined | StageStarted | StageProgress | StageDone | MemoryPeaked | TimeLeft | StageSkipped | Warned | Decided | Failed
Listener = Callable[[Event], None]

_TYPES: dict[str, Any] = {kind.__name__: kind for kind in get_args(Event)}


def encode(event: Event) -> str:
    """Return the event as one line of JSON."""
    return json.dumps({"event": type(event).__name__, **asdict(event)})


def decode(line: str) -> Event:
    """Parse a line written by `encode`; StageFailed for any other line."""
    try:
        fields = json.loads(line)
        kind = _TYPES[fields.pop("event")]
        if kind is Decided:
            return Decided(decision=Decision(**fields["decision"]))
        if kind is Outlined:
            return Outlined(stages=tuple(fields["stages"]))
        return kind(**fields)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise StageFailed(f"a worker wrote a line that is no event: {line[:200]!r} ({error}).") from error
