"""The stream of typed events of long work, read by command line, window and report.

A worker process writes one event per line of standard output as JSON; `decode` parses it: every
field has the type and the range that stand here, and what is parsed is what is used.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import MISSING, asdict, dataclass, fields
from functools import cache, reduce
from operator import or_
from typing import Annotated, Any, Literal, get_args, get_type_hints

from pydantic import Field, TypeAdapter, ValidationError, create_model

from radiant_core.decisions import Decision
from radiant_core.errors import StageFailed
from radiant_core.io.strict import Strict

MOST = 1e15
"""Most of what an event counts: bytes of memory, seconds, units of work. More is a fault."""
Amount = Annotated[float, Field(ge=0, le=MOST)]
Number = Annotated[int, Field(ge=0, le=MOST)]
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
    done: Amount
    total: Amount
    note: str = ""
    phase: str = ""
    """What the current step does, such as "matching"; `done` restarts with a new one."""
    step: Number = 0
    """Number of the step, from 1; 0 without steps."""
    num_steps: Number = 0
    left_s: Amount | None = None
    """Seconds left of the whole stage, where the stage itself can tell."""

    @property
    def doing(self) -> str:
        """Such as "matching, step 3 of 6"; empty for a stage without steps."""
        return f"{self.phase}, step {self.step} of {self.num_steps}" if self.num_steps > 1 else self.phase


@dataclass(frozen=True, kw_only=True)
class StageDone:
    """A stage finished; `seconds` is its own time."""

    stage: str
    seconds: Amount
    emulated: bool = False


@dataclass(frozen=True, kw_only=True)
class MemoryPeaked:
    """Peak memory of the process of a stage, its libraries included."""

    stage: str
    peak_bytes: Number


@dataclass(frozen=True, kw_only=True)
class CpuSpent:
    """CPU seconds of all threads of the process of a stage, its start included."""

    stage: str
    seconds: Amount


@dataclass(frozen=True, kw_only=True)
class TimeLeft:
    """Time left of devices and edges after the node `after`; `correction`: over the plan's time."""

    seconds: Amount
    correction: Amount
    after: str


PHASES = ("placing photographs", "training", "joining", "refining", "scoring", "report")
"""What every run goes through, in order: it passes those that it has no use for."""


@dataclass(frozen=True, kw_only=True)
class Foreseen:
    """Seconds of each of `PHASES` as predicted, if none had begun; a later event replaces it."""

    phases_s: tuple[Amount, ...]
    units: tuple[Number, ...]
    """Phases of equal number here are predicted for the same machines, so that what one of them
    took corrects the others first."""


@dataclass(frozen=True, kw_only=True)
class RunLeft:
    """How far the whole run is: its first phase that is not over, and the time left of all."""

    phase: str
    number: Number
    """Of the phase, from 1 to `num_phases`."""
    num_phases: Number
    elapsed_s: Amount
    left_s: Amount | None = None
    """Seconds left until the report stands; None where nothing is predicted yet."""
    off_percent: Amount | None = None
    """About what such estimates were off by, where they were measured."""


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


Event = (
    Heartbeat
    | Outlined
    | Foreseen
    | RunLeft
    | StageStarted
    | StageProgress
    | StageDone
    | MemoryPeaked
    | CpuSpent
    | TimeLeft
    | StageSkipped
    | Warned
    | Decided
    | Failed
)
Listener = Callable[[Event], None]

_TYPES: dict[str, Any] = {kind.__name__: kind for kind in get_args(Event)}


def encode(event: Event) -> str:
    """Return the event as one line of JSON."""
    record = {"event": type(event).__name__, **asdict(event)}
    text = json.dumps(record)
    if "\\ud" not in text:
        return text
    # Half a character, as of a file name that is no text, stands in no JSON.
    return json.dumps(json.loads(json.dumps(record, ensure_ascii=False).encode(errors="replace")))


def decode(line: str | bytes) -> Event:
    """Parse a line written by `encode`; StageFailed for any other line."""
    try:
        record = _parser().validate_json(line, strict=True)
    except ValidationError as error:
        raise StageFailed(f"a worker wrote a line that is no event: {line[:200]!r} ({_problem_of(error)}).") from error
    values = {name: getattr(record, name) for name in record.model_fields_set if name != "event"}
    event: Event = _TYPES[record.event](**values)
    return event


@cache
def _parser() -> Any:
    """Made with the first line, by the types of the events themselves."""
    models: list[Any] = []
    for kind in _TYPES.values():
        hints = get_type_hints(kind, include_extras=True)
        # What an earlier version did not write has its default.
        defaults = {member.name: ... if member.default is MISSING else member.default for member in fields(kind)}
        types_and_defaults: dict[str, Any] = {name: (hints[name], default) for name, default in defaults.items()}
        named: Any = Literal[kind.__name__]  # pyright: ignore[reportInvalidTypeForm]
        models.append(create_model(kind.__name__, __base__=Strict, event=(named, ...), **types_and_defaults))
    # Made from the list of all events, which no checker of types sees.
    one_of: Any = reduce(or_, models)
    event_type: Any = Annotated[one_of, Field(discriminator="event")]  # pyright: ignore
    return TypeAdapter(event_type)


def _problem_of(error: ValidationError) -> str:
    """The first thing that is wrong with a line, in few words."""
    problem = error.errors(include_url=False, include_input=False)[0]
    where = ".".join(map(str, problem["loc"][1:]))
    return f"{where}: {problem['msg']}" if where else str(problem["msg"])
