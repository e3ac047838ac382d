"""Standard output and error of a command that may work for hours: where they break, what it does goes on.

Standard error carries progress: a full disk under its log or a reader that went away (`2>&1 | head`) silences it and ends nothing. Standard
output carries results: there only a reader that went away is no error. Once per process.
"""

from __future__ import annotations

import io
import os
import sys
from typing import Any, TextIO


class LastingStream(io.TextIOWrapper):
    """A text stream that leads nowhere from the first of some errors on."""

    def __init__(self, stream: TextIO, silenced_by: type[OSError]) -> None:
        super().__init__(stream.buffer, encoding=stream.encoding, errors=stream.errors, line_buffering=True)
        self._silenced_by = silenced_by

    def write(self, text: str) -> int:
        """As of any text stream; after such an error nothing is written, and nothing said."""
        try:
            return super().write(text)
        except self._silenced_by:
            self._silence()
            return len(text)

    def flush(self) -> None:
        """As `write`."""
        try:
            super().flush()
        except self._silenced_by:
            self._silence()

    def _silence(self) -> None:
        # What is still buffered goes there too: else it would be tried again, at the latest when the process ends.
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self.fileno())
        os.close(nowhere)


def make_streams_last() -> None:
    """Let the standard streams of this process break without ending what it does; those that are closed or not its own stay."""
    for name, silenced_by in (("stdout", BrokenPipeError), ("stderr", OSError)):
        stream: Any = getattr(sys, name)
        if isinstance(stream, io.TextIOWrapper) and not isinstance(stream, LastingStream):
            setattr(sys, name, LastingStream(stream, silenced_by))
