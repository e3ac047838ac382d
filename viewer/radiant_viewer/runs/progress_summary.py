"""How far a run is, in a line: for the window and the page."""

from __future__ import annotations

from radiant_viewer.layers.region_layer import duration_text
from radiant_viewer.runs.run_feeds import RunProgress

REPORT = "report"


def progress_summary(progress: RunProgress) -> str:
    """State, phase or stages, time left and the number of warnings."""
    if not progress.stages:
        return f"This run is {progress.status or 'of an older version'}; it kept no stream of events."
    finished_stages = {stage.stage for stage in progress.stages if stage.state in ("done", "skipped")}
    finished = f"{len(finished_stages)} of {len(progress.stages)} stages that began are finished"
    if progress.expected:
        # The report comes after all that a run expects of its nodes, and is a row as well.
        expected = {*progress.expected, *({REPORT} & {stage.stage for stage in progress.stages})}
        finished = f"{len(finished_stages & expected)} of {len(expected)} stages finished"
    parts = [f"Run {progress.status or 'unknown'}", finished]
    whole = progress.whole
    if progress.is_running and whole is not None:
        parts[1] = f"{whole.phase}, {whole.number} of {whole.num_phases}"
        if whole.left_s is not None:
            parts.append(f"about {duration_text(max(1, round(whole.left_s)))}{_off_text(whole.off_percent, ' left')}")
    elif progress.is_running and progress.seconds_left is not None:
        parts.append(f"devices and edges: about {duration_text(max(1, round(progress.seconds_left)))} left")
    if progress.warnings:
        parts.append(f"{len(progress.warnings)} warning{'s' * (len(progress.warnings) > 1)}")
    return "   ·   ".join(parts)


def _off_text(percent: float | None, left: str) -> str:
    """What follows a time that is `left`: how far off it may be, as on the terminal."""
    if percent is None:
        return left
    return f" ± {percent:.0f} %{left}" if round(percent) < 100 else f"{left} (may be twice as long or more)"
