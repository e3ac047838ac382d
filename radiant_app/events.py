"""The stream of typed events that long work emits. The command line, the window and the report read the same stream.

A worker process writes one event per line of standard output as JSON; `decode` turns the line back into the event.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, get_args

from radiant_core.decisions import Decision
from radiant_core.errors import StageFailed

UPLINK = "/uplink"
"""Ending of the stage in which a node's product is sent to its parent over an emulated link."""


@dataclass(frozen=True, kw_only=True)
class StageStarted:
    """A stage or node of the tree begins."""

    stage: str
    machine: str = ""
    """Where, in a cluster."""
    emulated: bool = False
    """Whether its time says how long an emulated machine or link takes, and not this one."""


@dataclass(frozen=True, kw_only=True)
class Outlined:
    """Which stages a run has, as far as is known by now; a later one replaces it."""

    stages: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class StageProgress:
    """How far a stage is; `done` of `total` in any unit. Where it has several steps both are of the one that runs."""

    stage: str
    done: float
    total: float
    note: str = ""
    phase: str = ""
    """What its step does, such as "matching"; another one begins to count anew."""
    step: int = 0
    """Number of the step, from 1; 0 where there are none."""
    num_steps: int = 0

    @property
    def doing(self) -> str:
        """As "matching, step 3 of 6"; empty for a stage without steps."""
        return f"{self.phase}, step {self.step} of {self.num_steps}" if self.num_steps > 1 else self.phase


@dataclass(frozen=True, kw_only=True)
class StageDone:
    """A stage finished after so many seconds of its own."""

    stage: str
    seconds: float
    emulated: bool = False


@dataclass(frozen=True, kw_only=True)
class MemoryPeaked:
    """The most memory that the process of a stage held, its libraries included."""

    stage: str
    peak_bytes: int


@dataclass(frozen=True, kw_only=True)
class TimeLeft:
    """How long all devices and edges will still take, after the node `after` ended; `correction`: what remains, over what was planned."""

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
    """Something a user should know; nothing stopped."""

    stage: str
    message: str


@dataclass(frozen=True, kw_only=True)
class Decided:
    """Something was skipped or chosen."""

    decision: Decision


@dataclass(frozen=True, kw_only=True)
class Failed:
    """A worker ends without its result; `exit_code` is that of its error."""

    stage: str
    message: str
    exit_code: int
    cannot_write: bool = False
    """Whether it is a `CannotWrite`, after which nothing is tidied away."""


@dataclass(frozen=True, kw_only=True)
class Beat:
    """The process of a stage is alive; for the executor alone."""

    stage: str


Event = Beat | Outlined | StageStarted | StageProgress | StageDone | MemoryPeaked | TimeLeft | StageSkipped | Warned | Decided | Failed
Listener = Callable[[Event], None]

_TYPES: dict[str, Any] = {kind.__name__: kind for kind in get_args(Event)}


def encode(event: Event) -> str:
    """One line of JSON."""
    return json.dumps({"event": type(event).__name__, **asdict(event)})


def decode(line: str) -> Event:
    """The event of a line written by `encode`; StageFailed when the line is something else."""
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
