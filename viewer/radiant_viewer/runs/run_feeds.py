"""What the application gives the window beside the run's files: progress, bars of plan and run. The
window never imports the application; it calls these functions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol

if TYPE_CHECKING:
    from radiant_viewer.charts.gantt_chart import GanttRow

State = Literal["running", "done", "skipped", "failed", "interrupted"]
"""interrupted: the run was stopped while it was running."""


@dataclass(frozen=True, kw_only=True)
class StageState:
    """Progress of a stage or node: completed of total in any unit; seconds once it is done."""

    stage: str
    state: State
    completed: float = 0.0
    total: float = 0.0
    note: str = ""
    seconds: float | None = None

    @property
    def share(self) -> float | None:
        """The finished share, 0 to 1; None while the total is unknown."""
        if self.state in ("done", "skipped"):
            return 1.0
        return min(1.0, max(0.0, self.completed / self.total)) if self.total > 0 else None


@dataclass(frozen=True, kw_only=True)
class WholeRunState:
    """How far a whole run was when it was told last: its phase, by name and by number from 1, and
    the seconds left of all; `off_percent`: about what such estimates were off by where they were
    measured."""

    phase: str
    number: int
    num_phases: int
    elapsed_s: float
    left_s: float | None = None
    """None: nothing is foreseen yet."""
    off_percent: float | None = None

    @property
    def share(self) -> float | None:
        """Of the run's time, what has passed, 0 to 1; 1 once its report stands."""
        return None if self.left_s is None else self.elapsed_s / max(self.elapsed_s + self.left_s, 1e-9)


@dataclass(frozen=True, kw_only=True)
class LossCurve:
    """The loss of a stage: (share of it that is done, loss), as far as it was told."""

    stage: str
    points: tuple[tuple[float, float], ...]


@dataclass(frozen=True, kw_only=True)
class RunProgress:
    """Stages in the order they began, warnings, and seconds left to devices and edges if known."""

    stages: tuple[StageState, ...] = ()
    expected: tuple[str, ...] = ()
    """Names of all stages of the run; empty if unknown."""
    warnings: tuple[str, ...] = ()
    seconds_left: float | None = None
    whole: WholeRunState | None = None
    """None: an earlier version runs it."""
    is_running: bool = False
    """Whether the run is running; False once it ended, however it ended."""
    status: str = ""
    """Status in the run's own record: running, done, interrupted or failed."""
    machines: tuple[str, ...] = ()
    """A line per machine of a run over a network: joined, offline since, what arrived, why
    refused."""
    losses: tuple[LossCurve, ...] = ()
    """Of the stages that train, in the order they began."""


def no_rows() -> Sequence[GanttRow]:
    """Return no rows: there is no plan."""
    return ()


@dataclass(frozen=True, kw_only=True)
class SurveyCommands:
    """Command lines of the application that a window runs in processes of their own: `measuring`
    answers requests about measures (`radiant_app.commands.survey.worker`), `ortho` of a path
    writes the orthophoto there."""

    measuring: tuple[str, ...]
    ortho: Callable[[Path], tuple[str, ...]]


class Begun(Protocol):
    """A command of the application at work."""

    def poll(self) -> str | None:
        """None while it is at work; its last words once it ended, empty where it ended well."""
        ...

    def stop(self) -> None:
        """End it as Ctrl-C does."""
        ...


@dataclass(frozen=True, kw_only=True)
class RunControl:
    """Stops and resumes a run of this machine; each raises BadInput where that cannot be."""

    arguments: Callable[[], tuple[str, ...]]
    """Of `radiant`, that go on with the run."""
    stop: Callable[[], None]
    resume: Callable[[], Begun]


@dataclass(frozen=True, kw_only=True)
class RunFeeds:
    """Functions that read the present state; they raise BadInput or StoreDamaged if they cannot."""

    gantt_rows: Callable[[], Sequence[GanttRow]] = no_rows
    gantt_detail: Callable[[], str] = str
    progress: Callable[[], RunProgress] = RunProgress
    survey: SurveyCommands | None = None
    pages: tuple[str, ...] = ()
    """Command line that makes the pages anew that are sent; empty where there is none."""
    control: RunControl | None = None
