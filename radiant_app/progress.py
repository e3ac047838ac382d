"""Shows the event stream on a terminal: a bar with time left per running stage, a line for what was decided or warned."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from types import TracebackType
from typing import Self, TypeVar

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn, track

from radiant_app.events import Decided, Event, StageDone, StageProgress, StageSkipped, StageStarted, TimeLeft, Warned

_Item = TypeVar("_Item")
SECONDS_BETWEEN_LINES = 10.0
"""How often a stage tells a log file where it stands."""


def tracked(items: Sequence[_Item], what: str) -> Iterator[_Item]:
    """The items one after the other with a bar on a terminal's standard error, for a loop whose items take about as long as each other."""
    console = Console(stderr=True)
    return iter(track(items, description=what, console=console, disable=not console.is_terminal))


class ProgressDisplay:
    """A listener that draws; used as a context manager. Without a terminal it prints a line every `SECONDS_BETWEEN_LINES` and one
    per finished stage."""

    def __init__(self, console: Console, clock: Callable[[], float] = time.monotonic) -> None:
        self._console = console
        self._clock = clock
        self._line_due_s: dict[str, float] = {}
        self._progress = Progress(
            SpinnerColumn(),
            TextColumn("{task.description:<22}"),
            BarColumn(bar_width=30),
            TextColumn("{task.percentage:>3.0f} %"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            TextColumn("{task.fields[note]}"),
            console=console,
            disable=not console.is_terminal,
        )
        self._tasks: dict[str, TaskID] = {}

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._progress.stop()

    def __call__(self, event: Event) -> None:
        if isinstance(event, StageStarted):
            self._tasks[event.stage] = self._progress.add_task(event.stage, total=None, note="")
            self._line_due_s[event.stage] = self._clock() + SECONDS_BETWEEN_LINES
        elif isinstance(event, StageProgress) and event.stage in self._tasks:
            self._progress.update(self._tasks[event.stage], completed=event.done, total=event.total, note=event.note)
            self._print_line(event)
        elif isinstance(event, StageDone):
            self._remove(event.stage)
            self._console.print(f"[green]done[/] {event.stage} in {event.seconds:.1f} s{' (emulated)' * event.emulated}")
        elif isinstance(event, TimeLeft):
            times = "" if abs(event.correction - 1) < 0.005 else f", {event.correction:.2f} times the plan's for what remains"
            self._console.print(f"devices and edges: about {event.seconds:.0f} s left{times}", highlight=False, markup=False)
        elif isinstance(event, StageSkipped):
            self._console.print(f"[dim]skipped {event.stage}: finished before[/]")
        elif isinstance(event, Warned):
            self._console.print(f"warning {event.stage}: {event.message}", style="yellow", highlight=False, markup=False)
        elif isinstance(event, Decided):
            decision = event.decision
            line = f"decided {decision.stage}, {decision.topic}: {decision.choice} ({decision.reason})"
            self._console.print(line, style="dim", highlight=False, markup=False)

    def _print_line(self, event: StageProgress) -> None:
        now_s = self._clock()
        if self._console.is_terminal or now_s < self._line_due_s[event.stage]:
            return
        self._line_due_s[event.stage] = now_s + SECONDS_BETWEEN_LINES
        left_s = self._progress.tasks[self._progress.task_ids.index(self._tasks[event.stage])].time_remaining
        left = "" if left_s is None else f", {left_s:.0f} s left"
        share = "" if not event.total else f" {100 * event.done / event.total:.0f} %"
        self._console.print(f"{event.stage}{share}{left} {event.note}", highlight=False, markup=False)

    def _remove(self, stage: str) -> None:
        if stage in self._tasks:
            self._progress.remove_task(self._tasks.pop(stage))


def terminal_display() -> ProgressDisplay:
    """A display on standard error: standard output is for what a command gives."""
    return ProgressDisplay(Console(stderr=True))
