"""What the inspector gets beside a run's files: its timeline and stages. Once per window."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from radiant_app.commands.run.control import BegunCommand, resuming_arguments, stop_run
from radiant_app.files.event_file import progress_stamps, read_progress
from radiant_app.files.run_folder import read_manifest
from radiant_app.files.system_file import load_system
from radiant_app.network.home import NODE_NAME
from radiant_app.network.overview import read_rows
from radiant_app.report.html import GANTT_TEXT
from radiant_app.report.prediction_error import SYSTEM_NAME, gantt_rows
from radiant_core.errors import BadInput
from radiant_core.io.records import load_plan
from radiant_viewer.runs.run_view import plan_path

if TYPE_CHECKING:
    from radiant_viewer.runs.run_feeds import RunFeeds, RunProgress
    from radiant_viewer.start.start_feeds import StartFeeds


def feeds_of(run: Path) -> RunFeeds:
    """The feeds of a run folder; of anything else, feeds that know nothing."""
    from radiant_viewer.runs.run_feeds import RunControl, RunFeeds, SurveyCommands

    if not (run / "manifest.json").is_file():
        return RunFeeds()
    python = (sys.executable, "-m")
    return RunFeeds(
        gantt_rows=lambda: _gantt_rows(run),
        gantt_detail=lambda: GANTT_TEXT[bool(read_manifest(run).emulated)],
        progress=_Progress(run),
        control=RunControl(
            arguments=lambda: resuming_arguments(run),
            stop=lambda: stop_run(run),
            resume=lambda: BegunCommand(resuming_arguments(run)),
        ),
        pages=(*python, "radiant_app", "clean", str(run), "--pages"),
        survey=SurveyCommands(
            measuring=(*python, "radiant_app.commands.survey.worker", str(run)),
            ortho=lambda out: (*python, "radiant_app", "export", str(run), str(out), "--format", "ortho"),
        ),
    )


def start_feeds() -> StartFeeds:
    """What the start window is given."""
    from radiant_app.commands.machine.this_machine import machine_profile
    from radiant_viewer.start.start_feeds import StartFeeds

    python, measured = (sys.executable, "-m"), machine_profile()
    return StartFeeds(
        worker=(*python, "radiant_app.commands.inspect.start_worker"),
        begin=BegunCommand,
        feeds=feeds_of,
        state=run_state,
        measuring=(*python, "radiant_app.commands.machine.this_machine"),
        measured=measured,
    )


def run_state(path: Path) -> str:
    """What a run, plan or model is now, in a word; empty where it is gone."""
    if not path.exists():
        return ""
    if not (path / "manifest.json").is_file():
        return "model or plan" if path.is_file() else "folder"
    try:
        return read_progress(path).status or "run"
    except BadInput:
        return "run"


class _Progress:
    """The progress of a run, read again only if its files changed: it is polled every second."""

    def __init__(self, run: Path) -> None:
        self._run = run
        self._home = _home_of(run)
        self._cached: tuple[tuple[object, ...], RunProgress] | None = None

    def __call__(self) -> RunProgress:
        stamps = progress_stamps(self._run)
        if self._cached is None or self._cached[0] != stamps:
            self._cached = (stamps, read_progress(self._run))
        return replace(self._cached[1], machines=tuple(row.text for row in read_rows(self._home))) if self._home else self._cached[1]


def _home_of(run: Path) -> Path | None:
    """The folder of the node that conducts a run over a network, which is the source of that."""
    try:
        source = read_manifest(run).config.get("source")
    except BadInput:
        # A run that has only begun, or was cut while it wrote: its progress can be shown all the
        # same.
        return None
    return Path(source) if isinstance(source, str) and (Path(source) / NODE_NAME).is_file() else None


def _gantt_rows(run: Path) -> Sequence[Any]:
    if not (run / SYSTEM_NAME).is_file() or not plan_path(run).is_file():
        return ()
    return gantt_rows(load_system(run / SYSTEM_NAME), load_plan(plan_path(run))[1], run, read_manifest(run))
