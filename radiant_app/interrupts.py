"""Signals that end a process: all are handled as Ctrl-C, so that no worker outlives its run."""

from __future__ import annotations

import signal
from typing import Any, NoReturn

INTERRUPTED = 130
"""Exit code after Ctrl-C; what typer returns for it."""


def interrupt_on_signals() -> None:
    """Raise KeyboardInterrupt on SIGTERM, SIGHUP and SIGALRM too."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGALRM):
        signal.signal(number, _interrupt)


def stop_repeating_interrupt() -> None:
    """Stop repeating the last interrupt."""
    signal.setitimer(signal.ITIMER_REAL, 0)


def _interrupt(number: int, frame: Any) -> NoReturn:
    # Raised inside a finalizer, Python drops it: repeat it until `stop_repeating_interrupt`.
    signal.setitimer(signal.ITIMER_REAL, 1.0)
    raise KeyboardInterrupt
