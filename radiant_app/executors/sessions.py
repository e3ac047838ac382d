"""Signals to processes by their number: here and nowhere else.

kill(2) takes 1 for the first process of the system, 0 for the caller's own group, −1 for everybody,
and killpg(1) is that −1. Whatever a number was read from, it is signalled only where it leads a
session that is not this process's: each process of a node is started in a session of its own.
Where a process is held by an object (`Popen`, `QProcess`, a pidfd), its own methods signal it.
"""

from __future__ import annotations

import contextlib
import os
import signal

from radiant_core.errors import StageFailed

FIRST_PID = 2
"""Smaller numbers are the system's first process, groups, or everybody."""


def signal_session(pid: int, number: signal.Signals) -> None:
    """Signal the process `pid` and all of its group; nothing where it has ended meanwhile.

    Raises:
        StageFailed: `pid` leads no session apart from this process's; nothing was signalled.
    """
    with contextlib.suppress(ProcessLookupError):
        if pid < FIRST_PID or os.getsid(pid) != pid or pid == os.getsid(0):
            raise StageFailed(
                f"process {pid} leads no session of this run and was sent no {number.name}: `ps` shows what of the run is left."
            )
        os.killpg(pid, number)
