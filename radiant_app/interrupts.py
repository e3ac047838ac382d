"""Signals that end a process: all are handled as Ctrl-C, so that no worker outlives its run."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

INTERRUPTED = 130
"""Exit code after Ctrl-C; what typer returns for it."""
NUMBERS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGALRM)
"""Signals that are handled alike."""


def interrupt_on_signals() -> None:
    """Raise KeyboardInterrupt on SIGTERM, SIGHUP and SIGALRM too."""
    for number in NUMBERS:
        signal.signal(number, _interrupt)


def stop_repeating_interrupt() -> None:
    """Stop repeating the last interrupt."""
    signal.setitimer(signal.ITIMER_REAL, 0)


@contextmanager
def defer_interrupts() -> Iterator[None]:
    """Defer Ctrl-C and termination while a worker starts or stops: it would outlive the run."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    deferred: list[int] = []
    before = {number: signal.signal(number, lambda caught, frame: deferred.append(caught)) for number in NUMBERS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if deferred:
            signal.raise_signal(deferred[0])


def _interrupt(number: int, frame: Any) -> NoReturn:
    # Raised inside a finalizer, Python drops it: repeat it until `stop_repeating_interrupt`.
    signal.setitimer(signal.ITIMER_REAL, 1.0)
    raise KeyboardInterrupt
