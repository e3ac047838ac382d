"""Standard output and error of a command that goes on for hours though they break.

Standard error carries progress: a full disk under its log or a reader that went away (`2>&1 |
head`) silences it and ends nothing. Standard output carries results: there only a reader that went
away is no error, and all else is `CannotPrint`. Once per process.
"""

from __future__ import annotations

import io
import os
import sys
from typing import Any, TextIO


class CannotPrint(OSError):
    """What was to be printed did not arrive; what was made for it is whole."""


class LastingStream(io.TextIOWrapper):
    """A text stream silenced from its first error on; CannotPrint for one not in `silenced_by`."""

    def __init__(self, stream: TextIO, silenced_by: type[OSError]) -> None:
        super().__init__(stream.buffer, encoding=stream.encoding, errors=stream.errors, line_buffering=True)
        self._silenced_by = silenced_by

    def write(self, text: str) -> int:
        """As of any text stream; after an error nothing is written, and nothing said."""
        try:
            return super().write(text)
        except OSError as error:
            self._silence(error)
            return len(text)

    def flush(self) -> None:
        """As `write`."""
        try:
            super().flush()
        except OSError as error:
            self._silence(error)

    def _silence(self, error: OSError) -> None:
        # What is still buffered goes there too, else it would be tried again.
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self.fileno())
        os.close(nowhere)
        if not isinstance(error, self._silenced_by):
            raise CannotPrint(error.errno, error.strerror) from error


def make_streams_last() -> None:
    """Let this process outlive its standard streams; those closed or not its own stay."""
    for name, silenced_by in (("stdout", BrokenPipeError), ("stderr", OSError)):
        stream: Any = getattr(sys, name)
        if isinstance(stream, io.TextIOWrapper) and not isinstance(stream, LastingStream):
            setattr(sys, name, LastingStream(stream, silenced_by))
