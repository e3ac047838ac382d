"""What the inspector gets beside a run's files: its timeline and stages. Once per window."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from radiant_app.files.event_file import progress_stamps, read_progress
from radiant_app.files.run_folder import read_manifest
from radiant_app.files.system_file import load_system
from radiant_app.report.html import GANTT_TEXT
from radiant_app.run.prediction_error import SYSTEM_NAME, gantt_rows
from radiant_core.io.records import load_plan
from radiant_viewer.runs.run_view import plan_path

if TYPE_CHECKING:
    from radiant_viewer.runs.run_feeds import RunFeeds, RunProgress


def feeds_of(run: Path) -> RunFeeds:
    """The feeds of a run folder; of anything else, feeds that know nothing."""
    from radiant_viewer.runs.run_feeds import RunFeeds

    if not (run / "manifest.json").is_file():
        return RunFeeds()
    return RunFeeds(
        gantt_rows=lambda: _gantt_rows(run), gantt_detail=lambda: GANTT_TEXT[bool(read_manifest(run).emulated)], progress=_Progress(run)
    )


class _Progress:
    """The progress of a run, read again only if its files changed: it is polled every second."""

    def __init__(self, run: Path) -> None:
        self._run = run
        self._read: tuple[tuple[object, ...], RunProgress] | None = None

    def __call__(self) -> RunProgress:
        stamps = progress_stamps(self._run)
        if self._read is None or self._read[0] != stamps:
            self._read = (stamps, read_progress(self._run))
        return self._read[1]


def _gantt_rows(run: Path) -> Sequence[Any]:
    if not (run / SYSTEM_NAME).is_file() or not plan_path(run).is_file():
        return ()
    return gantt_rows(load_system(run / SYSTEM_NAME), load_plan(plan_path(run))[1], run, read_manifest(run))
