"""A batch: the jobs of a job file one after the other, going on after a failure, with a summary.

Each job is a process of its own that runs the pipeline (worker kind "run") and streams its events
here: a segmentation fault or a full memory ends one job and not the night, and its memory is free
for the next. Jobs do not run side by side, since each already gives every core a worker.

    BATCH/summary.json  summary.html
    BATCH/jobs/<name>/    task.json: its configuration; log.txt; done.json once it is finished
    BATCH/<out>/          the run's folder
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import jinja2

from radiant_app.config.fields import tables_of
from radiant_app.events import Event, Listener, StageSkipped
from radiant_app.executors.local import run_task
from radiant_app.executors.protocol import NodeTask
from radiant_app.files.job_file import RECORDS, Job, load_jobs
from radiant_app.files.run_folder import create_folder, require_empty
from radiant_app.interrupts import INTERRUPTED, stop_repeating_interrupt
from radiant_app.workers.sources import list_files
from radiant_app.workers.tasks import JobTask
from radiant_core import __version__
from radiant_core.errors import BadInput, RadiantError
from radiant_core.hierarchy.codec import save_task
from radiant_core.io.run_store import SEAL_NAME, RunLock, content_key, read_json, write_atomic, write_json

Status = Literal["done", "skipped", "failed", "interrupted", "running", "not started"]
"""skipped: an earlier batch finished it; interrupted: Ctrl-C came while it ran."""
PRODUCTS = ("scene.ply", "metrics.json", "report.html")
"""Without these in its folder a job counts as unfinished, whatever its seal says."""
FIGURES = ("psnr_db", "ssim", "num_gaussians")
"""What the summary takes from a run's metrics.json."""


@dataclass(frozen=True, kw_only=True)
class JobResult:
    """How a job ended."""

    name: str
    source: str
    out: str
    status: Status = "not started"
    seconds: float | None = None
    """Wall time of the job in this batch."""
    exit_code: int | None = None
    """What `radiant run` would have returned."""
    message: str = ""
    """The error's sentence."""
    figures: dict[str, float | None] = field(default_factory=dict)
    """`FIGURES` of a finished job."""


@dataclass(frozen=True, kw_only=True)
class BatchResult:
    """What a batch left behind."""

    folder: Path
    jobs: tuple[JobResult, ...]

    @property
    def exit_code(self) -> int:
        """0: all done; 2: every failure is bad input; 1: otherwise; 130: interrupted."""
        codes = {job.exit_code for job in self.jobs if job.status == "failed"}
        if any(job.status in ("interrupted", "not started") for job in self.jobs):
            return INTERRUPTED
        return 0 if not codes else BadInput.exit_code if codes == {BadInput.exit_code} else 1

    @property
    def record(self) -> dict[str, Any]:
        """The content of summary.json; no exit code while a job runs."""
        goes_on = any(job.status == "running" for job in self.jobs)
        return {"exit_code": None if goes_on else self.exit_code, "jobs": [asdict(job) for job in self.jobs]}


Display = Callable[[str], AbstractContextManager[Listener]]
"""Opens a display of one job's events under a title."""


def run_batch(path: Path, out: Path | None, display: Display, *, resume: bool = False) -> BatchResult:
    """Run the jobs of a file into `out`, else a folder of its name beside it; `resume` goes on.

    Raises BadInput before anything starts when the file or a folder cannot be used. A job's failure
    is in the result. After Ctrl-C the running job is stopped and the summary written; the result
    says what was interrupted and what never started.
    """
    folder = out or path.with_suffix("")
    jobs = load_jobs(path, folder)
    with _open_batch(folder, jobs, resume):
        results = [JobResult(name=job.name, source=str(job.config.source), out=str(job.config.out)) for job in jobs]
        try:
            for index, job in enumerate(jobs):
                started = replace(results[index], status="running")
                _write_summary(folder, [*results[:index], started, *results[index + 1 :]])
                with display(f"job {index + 1} of {len(jobs)}: {job.name}") as listen:
                    results[index] = _job_result(folder, job, started, listen, resume=resume)
                if results[index].status == "interrupted":
                    break
        finally:
            _write_summary(folder, results)
    return BatchResult(folder=folder, jobs=tuple(results))


def _job_result(folder: Path, job: Job, started: JobResult, listen: Listener, *, resume: bool) -> JobResult:
    record = folder / RECORDS / job.name
    record.mkdir(parents=True, exist_ok=True)
    config, out = tables_of(job.config), job.config.out
    save_task(record, JobTask(config=config, resume=resume))
    if not all((out / name).is_file() for name in PRODUCTS):
        (record / SEAL_NAME).unlink(missing_ok=True)
    key = content_key(__version__, config, list_files(job.config.source, out), *job.input_files)
    stage = f"job {job.name}"
    skipped = False

    def note(event: Event) -> None:
        nonlocal skipped
        skipped = skipped or event == StageSkipped(stage=stage)
        listen(event)

    begun_s = time.monotonic()

    def end(status: Status, **more: Any) -> JobResult:
        return replace(started, status=status, seconds=time.monotonic() - begun_s, **more)

    try:
        run_task(NodeTask(kind="run", stage=stage, folder=record, key=key, module="radiant_app.commands.run.job"), note)
        metrics = read_json(out / "metrics.json", FIGURES)
    except RadiantError as error:
        return end("failed", exit_code=error.exit_code, message=str(error).removeprefix(f"{stage}: "))
    except KeyboardInterrupt:
        stop_repeating_interrupt()
        return end("interrupted", exit_code=INTERRUPTED)
    return end("skipped" if skipped else "done", exit_code=0, figures={name: metrics[name] for name in FIGURES})


@contextmanager
def _open_batch(folder: Path, jobs: Sequence[Job], resume: bool) -> Iterator[None]:
    if resume and folder.is_dir() and any(folder.iterdir()):
        if not (folder / "summary.json").is_file():
            raise BadInput(f"{folder} holds no summary.json, so it is no batch to resume: choose another folder.")
        with RunLock(folder):
            yield
        return
    if not resume:
        for job in jobs:
            if job.config.out.is_dir():
                require_empty(job.config.out)
    with create_folder(folder, resumable=True):
        pass
    with RunLock(folder):
        yield


def _write_summary(folder: Path, results: Sequence[JobResult]) -> None:
    """summary.json and the page; written after every job, so that a killed batch leaves both."""
    result = BatchResult(folder=folder, jobs=tuple(results))
    write_json(folder / "summary.json", result.record)
    template = jinja2.Environment(
        loader=jinja2.PackageLoader("radiant_app"), autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    ).get_template("batch.html.j2")
    reports = {job.name: os.path.relpath(Path(job.out) / "report.html", folder.resolve()) for job in results}
    write_atomic(folder / "summary.html", template.render(title=folder.name, jobs=results, reports=reports).encode())
