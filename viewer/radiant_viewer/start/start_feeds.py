"""What the application gives the start window, which never imports it. Once per window."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from radiant_viewer.runs.run_feeds import Begun, RunFeeds


@dataclass(frozen=True, kw_only=True)
class StartFeeds:
    """Commands and functions of the application."""

    worker: tuple[str, ...]
    """Answers what a folder is and what a run of it takes
    (`radiant_app.commands.inspect.start_worker`)."""
    begin: Callable[[Sequence[str]], Begun]
    """Begins `radiant` with these arguments."""
    feeds: Callable[[Path], RunFeeds]
    """Of a run."""
    state: Callable[[Path], str]
    """What a run that was open before is now, in a word; empty where it is gone."""
    measuring: tuple[str, ...] = ()
    """Command line that measures this machine for forecasts."""
    measured: Path | None = None
    """Where its figures lie, once it was."""
