"""The event stream of a run as events.jsonl in its folder, for processes that show its progress.

One event per line, as `events.encode` writes it. Of progress, at most two lines a second and stage,
and the first of every phase, which restarts the count: else a long phase would show the end of the
previous one. A resumed run starts a new file.
"""

from __future__ import annotations

import fcntl
import json
import re
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import IO, TYPE_CHECKING, Self

from radiant_app.events import (
    Event,
    Failed,
    Listener,
    Outlined,
    RunLeft,
    StageDone,
    StageProgress,
    StageSkipped,
    StageStarted,
    TimeLeft,
    Warned,
    decode,
    encode,
)
from radiant_app.pace import clock_text
from radiant_core.errors import BadInput, StageFailed
from radiant_core.io.run_store import LOCK_NAME

if TYPE_CHECKING:
    from radiant_viewer.runs.run_feeds import RunProgress, StageState, State

EVENTS_NAME = "events.jsonl"
LOSS = re.compile(r"loss (\d+\.\d+)")
"""How trainings tell their loss (`radiant_core.hierarchy.reporter`)."""
SECONDS_BETWEEN = 0.5
MIN_PHASE_S = 0.05
"""A phase that starts sooner after a line is not written: its total may change with each event."""


class EventFile:
    """A listener that writes and forwards events while entered; a full disk ends only the file."""

    def __init__(self, run: Path, listen: Listener, clock: Callable[[], float] = time.monotonic) -> None:
        self._path, self._listen, self._clock = run / EVENTS_NAME, listen, clock
        self._file: IO[str] | None = None
        self._written_s: dict[str, float] = {}
        self._last_of_stage: dict[str, StageProgress] = {}

    def __enter__(self) -> Self:
        with suppress(OSError):
            self._file = self._path.open("w", encoding="utf-8", buffering=1)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._file is not None:
            with suppress(OSError):
                self._file.close()

    def __call__(self, event: Event) -> None:
        """See `Listener`."""
        if self._file is not None and not self._is_too_soon(event):
            try:
                self._file.write(encode(event) + "\n")
            except OSError:
                self._file = None
        self._listen(event)

    def _is_too_soon(self, event: Event) -> bool:
        if not isinstance(event, StageProgress):
            return False
        last, now_s = self._last_of_stage.get(event.stage), self._clock()
        self._last_of_stage[event.stage] = event
        begins = last is not None and (event.phase != last.phase or event.done < last.done or event.total != last.total)
        if now_s - self._written_s.get(event.stage, float("-inf")) < (MIN_PHASE_S if begins else SECONDS_BETWEEN):
            return True
        self._written_s[event.stage] = now_s
        return False


def read_progress(run: Path) -> RunProgress:
    """Read the progress of a run from events and manifest; BadInput for a file of anything else."""
    from radiant_viewer.runs.run_feeds import LossCurve, RunProgress, WholeRunState

    path = run / EVENTS_NAME
    stages: dict[str, StageState] = {}
    losses: dict[str, list[tuple[float, float]]] = {}
    warnings: list[str] = []
    seconds_left, outline, whole = None, Outlined(stages=()), None
    for event in _events(path):
        if isinstance(event, Warned):
            warnings.append(f"{event.stage}: {event.message}")
        elif isinstance(event, TimeLeft):
            seconds_left = event.seconds
        elif isinstance(event, RunLeft):
            whole = WholeRunState(
                phase=event.phase,
                number=event.number,
                num_phases=event.num_phases,
                elapsed_s=event.elapsed_s,
                left_s=event.left_s,
                off_percent=event.off_percent,
            )
        elif isinstance(event, Outlined):
            outline = event
        elif (state := _next_state(event)) is not None:
            stages[state.stage] = state
            _count_loss(event, losses)
    status = _status(run)
    is_running = status == "running" and is_locked(run)
    if status == "running" and not is_running:
        status = "interrupted"
    if not is_running:
        # Stages that were running were stopped with the run or failed.
        ended: State = "interrupted" if status == "interrupted" else "failed"
        stages = {name: replace(state, state=ended) if state.state == "running" else state for name, state in stages.items()}
    return RunProgress(
        stages=tuple(stages.values()),
        expected=outline.stages,
        warnings=tuple(warnings),
        seconds_left=seconds_left,
        whole=whole,
        is_running=is_running,
        status=status,
        losses=tuple(LossCurve(stage=stage, points=tuple(points)) for stage, points in losses.items() if len(points) > 1),
    )


def _count_loss(event: Event, losses: dict[str, list[tuple[float, float]]]) -> None:
    """Add the loss that trainings tell in their note; a stage that begins anew begins its curve."""
    if isinstance(event, StageStarted):
        losses.pop(event.stage, None)
    if not isinstance(event, StageProgress) or not event.total > 0 or (match := LOSS.search(event.note)) is None:
        return
    curve, share = losses.setdefault(event.stage, []), event.done / event.total
    if curve and share < curve[-1][0]:
        curve.clear()
    curve.append((share, float(match[1])))


def progress_stamps(run: Path) -> tuple[object, ...]:
    """Return values that change whenever `read_progress` would read something new."""
    stamps: list[object] = [is_locked(run)]
    for name in (EVENTS_NAME, "manifest.json"):
        with suppress(OSError):
            status = (run / name).stat()
            stamps.append((name, status.st_ino, status.st_mtime_ns, status.st_size))
    return tuple(stamps)


def _next_state(event: Event) -> StageState | None:
    from radiant_viewer.runs.run_feeds import StageState

    if isinstance(event, StageStarted):
        return StageState(stage=event.stage, state="running")
    if isinstance(event, StageProgress):
        time_left = "" if event.left_s is None else f"about {clock_text(max(1.0, event.left_s))} left"
        note = ", ".join(text for text in (event.doing, event.note, time_left) if text)
        return StageState(stage=event.stage, state="running", completed=event.done, total=event.total, note=note)
    if isinstance(event, StageDone):
        return StageState(stage=event.stage, state="done", seconds=event.seconds)
    if isinstance(event, StageSkipped):
        return StageState(stage=event.stage, state="skipped", note="finished before")
    if isinstance(event, Failed):
        return StageState(stage=event.stage, state="failed", note=event.message)
    return None


def _events(path: Path) -> list[Event]:
    if not path.is_file():
        return []
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
        # The last line may be incomplete.
        return [decode(line) for line in text[: text.rfind("\n") + 1].splitlines()]
    except (OSError, StageFailed) as error:
        raise BadInput(f"{path} cannot be read as a stream of events ({error}): the run itself is not touched by that.") from error


def _status(run: Path) -> str:
    try:
        record = json.loads((run / "manifest.json").read_bytes())
    except (OSError, ValueError):
        return ""
    status = record.get("status") if isinstance(record, dict) else None
    return status if isinstance(status, str) else ""


def is_locked(run: Path) -> bool:
    """Whether a process holds the run's lock, which the kernel frees when that process ends."""
    try:
        with (run / LOCK_NAME).open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False
