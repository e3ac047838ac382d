"""The process of one job of a batch: `python -m radiant_app.commands.run.job run FOLDER STAGE
KEY`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from radiant_app.commands.run.pipeline import run
from radiant_app.config.fields import config_of, values_of
from radiant_app.interrupts import INTERRUPTED, interrupt_on_signals
from radiant_app.reporting import EventReporter
from radiant_app.workers.tasks import JobTask
from radiant_app.workers.worker import end_process, main


def run_job(folder: Path, task: JobTask, reporter: EventReporter) -> Sequence[str]:
    """The run that the task describes, its events sent on."""
    # Asked to stop, the run stops its own workers and says so in its manifest, as after Ctrl-C.
    interrupt_on_signals()
    try:
        run(config_of(values_of(task.config, "job")), reporter.emit, resume=task.resume)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    return []


if __name__ == "__main__":
    end_process(main(sys.argv[1:], run_job))
