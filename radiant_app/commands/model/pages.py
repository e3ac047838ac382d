"""The pages of a run that are sent, made anew: the report and the page that flies through."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from radiant_app.files.run_folder import read_manifest
from radiant_app.report.progress import ProgressDisplay
from radiant_core.errors import BadInput
from radiant_core.io.run_store import RunLock, read_json
from radiant_viewer.runs.run_view import METRICS_NAME
from radiant_viewer.runs.unplanned import finish_command, folder_kind


def rewrite_pages(run: Path, display: ProgressDisplay) -> dict[str, Any]:
    """Write report.html and scene.html of a finished run as its model is cleaned now; BadInput
    where the folder holds none, or the run is at work."""
    from radiant_app.report.html import write_report

    if not run.is_dir() or folder_kind(run) != "run":
        raise BadInput(f"{run} has no pages that are sent: give the folder that 'radiant run --out' made, or leave --pages out.")
    if not (run / METRICS_NAME).is_file():
        raise BadInput(f"{run} has no {METRICS_NAME}, of which its report tells: {finish_command(run)}.")
    with RunLock(run):
        return {"pages": str(write_report(run, read_manifest(run), read_json(run / METRICS_NAME), display))}
