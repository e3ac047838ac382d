"""What the application hands the window beside the run's files: how stages stand, and the bars of plan and run.

The window never imports the application: it calls these when it wants to know.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from radiant_viewer.charts.gantt_chart import GanttRow

State = Literal["running", "done", "skipped", "failed", "interrupted"]
"""interrupted: somebody stopped the run while it was at work."""


@dataclass(frozen=True, kw_only=True)
class StageState:
    """How one stage or node stands: done and total in any unit while it runs, seconds once it is done."""

    stage: str
    state: State
    done: float = 0.0
    total: float = 0.0
    note: str = ""
    seconds: float | None = None

    @property
    def share(self) -> float | None:
        """How much of it is done, 0 to 1; None while nothing says how much there is."""
        if self.state in ("done", "skipped"):
            return 1.0
        return min(1.0, max(0.0, self.done / self.total)) if self.total > 0 else None


@dataclass(frozen=True, kw_only=True)
class RunProgress:
    """All stages in the order they began, what was warned of, and the seconds that devices and edges still need, if known."""

    stages: tuple[StageState, ...] = ()
    expected: tuple[str, ...] = ()
    """Names of the stages that the run has in all; empty where it did not say so."""
    warnings: tuple[str, ...] = ()
    seconds_left: float | None = None
    is_running: bool = False
    """Whether the run is at work; False once it ended, however it ended."""
    status: str = ""
    """How the run's own record says it stands: running, done, interrupted or failed."""


def no_rows() -> Sequence[GanttRow]:
    """No plan to show."""
    return ()


@dataclass(frozen=True, kw_only=True)
class RunFeeds:
    """Functions that read anew each time; they raise BadInput or StoreDamaged where a file cannot be read."""

    gantt_rows: Callable[[], Sequence[GanttRow]] = no_rows
    gantt_detail: Callable[[], str] = str
    progress: Callable[[], RunProgress] = RunProgress
