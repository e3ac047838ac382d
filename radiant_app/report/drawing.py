"""`draw_report`: the report of a run, where it can in a fork of the server of the run's nodes
(`fork_server.py`). Once per run.

    run    metrics, manifest ── a line of JSON ──→ standard input of the fork
    fork   `write_report`, its events line by line ──→ the run

The server has loaded torch, which the pictures of the model need, and the process of a run has not:
it plans and waits, and holds a few libraries. Without a server the run draws itself.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import threading
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

from radiant_app.events import Failed, Listener, decode, encode
from radiant_app.executors.fork_server import THREADS, ForkedProcess, ForkServer, started_server
from radiant_app.executors.local import IMPORTED, STOP_GRACE_S, worker_environment
from radiant_app.executors.sessions import signal_session
from radiant_app.files.run_folder import Manifest
from radiant_app.interrupts import INTERRUPTED, defer_interrupts, interrupt_on_signals
from radiant_app.workers.worker import end_process, exit_with_executor, failure_of
from radiant_core.errors import BadInput, CannotWrite, RadiantError, StageFailed

STAGE = "report"


def draw_report(run: Path, manifest: Manifest, metrics: Mapping[str, Any], listen: Listener) -> None:
    """Make the report of a finished run; `listen` hears how far it is.

    Raises:
        BadInput, CannotWrite: as `write_report`.
        StageFailed: the process that draws ended before it was done.
    """
    environment = worker_environment(_num_threads())
    server = started_server(IMPORTED, environment)
    with TemporaryFile("w+") as log:
        drawing = None if server is None else _start(server, log, environment)
        if drawing is None:
            from radiant_app.report import html

            html.write_report(run, manifest, dict(metrics), listen)
            return
        try:
            failure, code = _follow(drawing, run, manifest, metrics, listen)
        finally:
            _stop(drawing)
        if failure is not None:
            error = CannotWrite if failure.cannot_write else BadInput if failure.exit_code == BadInput.exit_code else StageFailed
            raise error(failure.message)
        if code != 0 or not (run / "report.html").is_file():
            log.seek(0)
            said = (log.read().strip().splitlines() or ["it said nothing"])[-1]
            raise StageFailed(f"{STAGE}: the process that draws it ended with code {code} ({said[:200]}); run again with --resume.")


def _num_threads() -> int:
    """Of this process, as torch counts them."""
    given = os.environ.get(THREADS, "")
    return int(given) if given.isdecimal() and int(given) else os.cpu_count() or 1


def _start(server: ForkServer, log: IO[str], environment: Mapping[str, str]) -> ForkedProcess | None:
    # It may have been killed.
    with defer_interrupts(), contextlib.suppress(OSError):
        return server.start_piped([__spec__.name], log, environment)
    return None


def _follow(
    drawing: ForkedProcess, run: Path, manifest: Manifest, metrics: Mapping[str, Any], listen: Listener
) -> tuple[Failed | None, int]:
    """Tell what to draw and pass on what is heard, to the end: the failure that was told, and the
    exit code."""
    assert drawing.stdin is not None and drawing.stdout is not None
    of_manifest = {field.name: getattr(manifest, field.name) for field in fields(manifest) if field.name != "folder"}
    failure = None
    with drawing.stdin, drawing.stdout as lines:
        # It may end before it has read all.
        with contextlib.suppress(BrokenPipeError):
            drawing.stdin.write(json.dumps({"run": str(run), "manifest": of_manifest, "metrics": metrics}) + "\n")
            drawing.stdin.flush()
        for line in lines:
            event = decode(line)
            if isinstance(event, Failed):
                failure = event
            else:
                listen(event)
        # Before standard input closes, whose end is for it the end of the run: it tells its last
        # event, and closes its output, a moment before it ends.
        return failure, drawing.wait()


def _stop(drawing: ForkedProcess) -> None:
    """End it, where an interrupt came before its end."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        if drawing.poll() is None:
            signal_session(drawing.pid, number)
            with contextlib.suppress(subprocess.TimeoutExpired):
                drawing.wait(STOP_GRACE_S)


def main() -> int:
    """Draw what standard input tells, in this process; an exit code."""
    interrupt_on_signals()
    # Unbuffered, so that nothing behind the line is taken from the thread that waits for the end.
    asked = json.loads(_read_line(0))
    threading.Thread(target=exit_with_executor, daemon=True).start()
    events = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    run = Path(asked["run"])
    try:
        from radiant_app.report.html import write_report

        write_report(run, Manifest(folder=run, **asked["manifest"]), asked["metrics"], lambda event: print(encode(event), file=events))
    except KeyboardInterrupt:
        return INTERRUPTED
    except (RadiantError, OSError, MemoryError, RuntimeError) as error:
        failure = failure_of(error, STAGE, run)
        if failure is None:
            raise
        print(encode(failure), file=events)
        return failure.exit_code
    return 0


def _read_line(fd: int) -> bytes:
    line = b""
    while not line.endswith(b"\n") and (part := os.read(fd, 1 << 16)):
        line += part
    return line


if __name__ == "__main__":
    end_process(main())
