"""Shows the event stream on a terminal: a bar per running stage, a line per warning or decision.

    sfm: matching, step 3 of 6   ━━━━━━╺━━━   45 %  elapsed 0:31, left in step about 0:40

Names of photographs, jobs and devices are printed as they are, but for what has no shape of its
own, which comes as its escape: none is read as markup, and no text of a stranger moves the cursor.
Lines of a log file are not wrapped.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, SpinnerColumn, Task, TaskID, TextColumn
from rich.table import Column
from rich.text import Text

from radiant_app.events import Decided, Event, Outlined, RunLeft, StageDone, StageProgress, StageSkipped, StageStarted, TimeLeft, Warned
from radiant_app.pace import Pace, RunPace, clock_text, run_text
from radiant_app.plain_text import shown_text
from radiant_core.garbage import without_garbage_search

SECONDS_BETWEEN_LINES = 10.0
"""Interval between progress lines of a stage in a log file."""
MAX_BAR_WIDTH = 30
_TIME_LEFT = "/time left"
"""In place of a stage's name, of which none begins with a slash."""


@contextmanager
def show_starting() -> Iterator[None]:
    """A spinner on a terminal while libraries load, which takes seconds; nothing in a log."""
    console = Console(stderr=True)
    with console.status("starting") if console.is_terminal else nullcontext(), without_garbage_search():
        yield


class _Times(ProgressColumn):
    def render(self, task: Task) -> Text:
        return Text(task.fields["pace"].text)


class _Share(ProgressColumn):
    def render(self, task: Task) -> Text:
        return Text("" if not task.total else f"{task.percentage:>3.0f} %")


class ProgressDisplay:
    """A listener that draws while entered; without a terminal it prints lines at intervals."""

    def __init__(self, console: Console, clock: Callable[[], float] = time.monotonic, *, with_decisions: bool = True) -> None:
        self._console = console
        self._clock = clock
        self._with_decisions = with_decisions
        self.num_decisions = 0
        """Decisions that were heard and changed something, printed or not."""
        self._line_due_s: dict[str, float] = {}
        self._progress = Progress(
            SpinnerColumn(),
            # On a narrow terminal words go on in a second line; no figure is cut.
            TextColumn("{task.description}", markup=False, table_column=Column()),
            BarColumn(bar_width=min(MAX_BAR_WIDTH, max(4, console.width // 8 - 6))),
            _Share(table_column=Column(no_wrap=True)),
            _Times(table_column=Column(no_wrap=True)),
            TextColumn("{task.fields[note]}", markup=False, table_column=Column()),
            console=console,
            disable=not console.is_terminal,
        )
        self._tasks: dict[str, TaskID] = {}
        self._paces: dict[str, Pace] = {}
        self._run: TaskID | None = None
        self._whole = RunPace(clock=clock)
        self._stages: frozenset[str] = frozenset()
        self._ended: set[str] = set()

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._progress.stop()

    def __call__(self, event: Event) -> None:
        if isinstance(event, Outlined):
            self._outline(event)
        elif isinstance(event, StageStarted):
            self._begin(event.stage)
        elif isinstance(event, StageProgress) and event.stage in self._tasks:
            self._paces[event.stage].update(event)
            title = shown_text(f"{event.stage}: {event.doing}" if event.doing else event.stage)
            self._progress.update(
                self._tasks[event.stage], description=title, completed=event.done, total=event.total or None, note=shown_text(event.note)
            )
            self._print_line(event)
        elif isinstance(event, StageDone):
            took = f" {event.stage} in {event.seconds:.1f} s{' (emulated)' * event.emulated}"
            self._end(event.stage, Text.assemble(("done", "green"), took))
        elif isinstance(event, StageSkipped):
            self._end(event.stage, Text.assemble(("skipped", "dim"), f" {event.stage}: finished before"))
        elif isinstance(event, RunLeft):
            self._tell_run_left(event)
        elif isinstance(event, TimeLeft) and self._whole.last is None:
            self._tell_time_left(event)
        elif isinstance(event, Warned):
            self._print(shown_text(f"warning {event.stage}: {event.message}"), "yellow")
        elif isinstance(event, Decided) and not event.decision.changes_nothing:
            decision = event.decision
            self.num_decisions += 1
            if self._with_decisions:
                why = f"{decision.reason}; case {decision.row}" if decision.row else decision.reason
                line = f"decided {decision.stage}, {decision.topic}: {decision.choice} ({why})"
                self._print(shown_text(line), "dim")

    def _print(self, line: str | Text, style: str | None = None) -> None:
        self._console.print(line, style=style, highlight=False, markup=False, emoji=False, soft_wrap=not self._console.is_terminal)

    def _begin(self, stage: str) -> None:
        # A stage that is started again starts from 0.
        self._remove(stage)
        self._paces[stage] = pace = Pace(clock=self._clock)
        self._tasks[stage] = self._progress.add_task(stage, total=None, note="", pace=pace)
        self._line_due_s[stage] = self._clock() + SECONDS_BETWEEN_LINES

    def _outline(self, event: Outlined) -> None:
        self._stages = frozenset(event.stages)
        if self._run is None:
            self._run = self._progress.add_task("run", total=None, note="", pace=Pace(clock=self._clock))
        self._count()

    def _count(self) -> int:
        """How many stages of the run are finished, which its bar shows too."""
        num_ended, total = len(self._stages & self._ended), len(self._stages)
        if self._run is not None and self._whole.last is None:
            # The report comes after the stages and has a line of its own.
            ending = ", finishing" if 0 < total == num_ended else ""
            self._progress.update(self._run, description=f"run: {num_ended} of {total} stages{ending}", completed=num_ended, total=total)
        return num_ended

    def _tell_run_left(self, event: RunLeft) -> None:
        """In the bar of the run, whose share is that of its time; in a log at intervals, and where
        another phase begins."""
        before, title = self._whole.last, f"run: {run_text(event)}"
        self._whole.update(event)
        if self._run is None:
            self._run = self._progress.add_task(title, total=None, note="", pace=self._whole)
        share = self._whole.share
        total = None if share is None else 1.0
        self._progress.update(self._run, description=title, pace=self._whole, note="", total=total, completed=share or 0.0)
        is_new = before is None or before.number != event.number
        if not self._console.is_terminal and (is_new or self._clock() >= self._line_due_s.get(_TIME_LEFT, 0.0)):
            self._line_due_s[_TIME_LEFT] = self._clock() + SECONDS_BETWEEN_LINES
            self._print(f"{title}, {self._whole.text}")

    def _tell_time_left(self, event: TimeLeft) -> None:
        """Beside the bar of the run; in a log as a line, at most one per interval."""
        time_left = f"devices and edges: left about {clock_text(max(1.0, event.seconds))}"
        if self._console.is_terminal and self._run is not None:
            self._progress.update(self._run, note=time_left)
        elif self._clock() >= self._line_due_s.get(_TIME_LEFT, 0.0):
            self._line_due_s[_TIME_LEFT] = self._clock() + SECONDS_BETWEEN_LINES
            off = "" if abs(event.correction - 1) < 0.005 else f", {event.correction:.2f} × what was planned"
            self._print(time_left + off)

    def _print_line(self, event: StageProgress) -> None:
        now_s = self._clock()
        if self._console.is_terminal or now_s < self._line_due_s[event.stage]:
            return
        self._line_due_s[event.stage] = now_s + SECONDS_BETWEEN_LINES
        share = f"{100 * event.done / event.total:.0f} %" if event.total else ""
        texts = [event.doing, share, self._paces[event.stage].text, event.note]
        self._print(shown_text(f"{event.stage}: {', '.join(text for text in texts if text)}"))

    def _end(self, stage: str, line: Text) -> None:
        self._remove(stage)
        self._ended.add(stage)
        num_ended = self._count()
        counted = stage in self._stages and self._whole.last is None
        self._print(line + Text(f"; {num_ended} of {len(self._stages)} stages finished" if counted else ""))

    def _remove(self, stage: str) -> None:
        if stage in self._tasks:
            self._progress.remove_task(self._tasks.pop(stage))


def terminal_display(*, with_decisions: bool = True) -> ProgressDisplay:
    """Return a display on standard error: standard output is for the results of a command."""
    return ProgressDisplay(Console(stderr=True), with_decisions=with_decisions)
