"""A worker process: `python -m radiant_app.workers.worker KIND FOLDER STAGE KEY` runs one node.

Standard output carries events, one per line; everything else goes to the node's log.txt. Standard
input is a pipe that the executor holds open: when it closes, the executor is gone and so is the
worker, however that one ended.
"""

from __future__ import annotations

import errno
import os
import stat
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from radiant_app.events import CpuSpent, Event, Failed, Heartbeat, MemoryPeaked, encode
from radiant_app.workers.memory import OUT_OF_MEMORY, is_out_of_memory, peak_bytes
from radiant_app.workers.redaction import make_redactor
from radiant_core.errors import BadInput, CannotWrite, RadiantError, StageFailed
from radiant_core.io.run_store import seal

if TYPE_CHECKING:
    from radiant_app.workers.nodes import Work

HEARTBEAT_S = 5.0
"""Interval of the heartbeats of a worker."""
DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EROFS)
"""Error numbers of a full or broken disk."""


def main(arguments: list[str], work: Work | None = None) -> int:
    """Run one node and seal its folder; returns an exit code. `work` as in `nodes.run_node`."""
    kind, folder, stage, key = arguments
    if stat.S_ISFIFO(os.fstat(0).st_mode):
        threading.Thread(target=exit_with_executor, daemon=True).start()
    # Libraries print to file descriptor 1 too: events keep the real one, the rest goes to the log.
    events = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)

    writing = threading.Lock()

    def emit(event: Event) -> None:
        with writing:
            events.write(encode(event) + "\n")

    threading.Thread(target=_send_heartbeats, args=(stage, emit), daemon=True).start()
    try:
        from radiant_app.workers.nodes import run_node

        outputs = run_node(kind, Path(folder), stage, emit, work)
        emit(MemoryPeaked(stage=stage, peak_bytes=peak_bytes()))
        emit(CpuSpent(stage=stage, seconds=time.process_time()))
        seal(Path(folder), key, outputs)
    except (RadiantError, OSError, MemoryError, RuntimeError) as error:
        failed = failure_of(error, stage, Path(folder))
        if failed is None:
            raise
        emit(make_redactor(kind, Path(folder)).redact_event(failed))
        return failed.exit_code
    return 0


def failure_of(error: Exception, stage: str, folder: Path) -> Failed | None:
    """What is told of the failure of a stage that works in `folder`; None for a bug of ours."""
    if isinstance(error, RadiantError):
        return Failed(stage=stage, message=str(error), exit_code=error.exit_code, cannot_write=isinstance(error, CannotWrite))
    if isinstance(error, OSError):
        message = f"{error.strerror or error} ({error.filename or folder})"
        return Failed(stage=stage, message=message, exit_code=BadInput.exit_code, cannot_write=error.errno in DISK_ERRORS)
    if isinstance(error, MemoryError | RuntimeError) and is_out_of_memory(error):
        return Failed(stage=stage, message=OUT_OF_MEMORY, exit_code=StageFailed.exit_code)
    return None


def end_process(code: int) -> NoReturn:
    """End with an exit code, and leave libraries as they are: the product is sealed, and tearing
    them down takes longer than the work of a small node."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _send_heartbeats(stage: str, emit: Callable[[Event], None]) -> None:
    while True:
        time.sleep(HEARTBEAT_S)
        emit(Heartbeat(stage=stage))


def exit_with_executor() -> None:
    """End this process where standard input ends, which the executor holds open."""
    while os.read(0, 1):
        pass
    os._exit(1)


if __name__ == "__main__":
    end_process(main(sys.argv[1:]))
