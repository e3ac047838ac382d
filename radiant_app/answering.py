"""How a process that a window asks for answers ends, and where its answers go."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import IO

from radiant_app.interrupts import interrupt_on_signals, stop_repeating_interrupt


@contextmanager
def answering() -> Iterator[IO[bytes]]:
    """Standard output, for answers alone, until the asking window is gone or ends the process.

    What libraries print becomes standard error.
    """
    pipe = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    interrupt_on_signals()
    with suppress(BrokenPipeError, KeyboardInterrupt):
        yield pipe
    stop_repeating_interrupt()
