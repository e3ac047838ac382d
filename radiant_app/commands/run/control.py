"""Runs begun, stopped and resumed from a window, each by the command line that does the same.

begin      `radiant …` in a session of its own, which a closed window leaves alone
stop       what Ctrl-C does in the run's terminal, wherever on this machine it was begun
resume     the run's own command with --resume, from its manifest
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from radiant_app.config.fields import config_fields, values_of
from radiant_app.files.event_file import is_locked
from radiant_app.files.run_folder import read_manifest
from radiant_core.errors import BadInput
from radiant_core.io.run_store import LOCK_NAME

MAX_WORDS = 4000
_begun: list[BegunCommand] = []
"""Those at work: a window may be closed before them."""


def command_line(arguments: Sequence[str]) -> list[str]:
    """What starts a `radiant` command."""
    return [sys.executable, "-m", "radiant_app", *arguments]


class BegunCommand:
    """A `radiant` command at work; what it says goes to a file that nobody else sees."""

    def __init__(self, arguments: Sequence[str]) -> None:
        self.arguments = tuple(arguments)
        self._words: str | None = None
        self._output = tempfile.TemporaryFile()  # noqa: SIM115 (it lives as long as the command)
        self._process = subprocess.Popen(
            command_line(arguments),
            stdin=subprocess.DEVNULL,
            stdout=self._output,
            stderr=self._output,
            start_new_session=True,
        )
        _begun[:] = [*(command for command in _begun if command.poll() is None), self]

    def poll(self) -> str | None:
        """None while it is at work; its last words once it ended, empty where it ended well."""
        if self._words is None and (code := self._process.poll()) is not None:
            self._words = "" if code == 0 else self._last_words() or f"it ended with exit code {code}"
            self._output.close()
        return self._words

    def stop(self) -> None:
        """End it as Ctrl-C does."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)

    def _last_words(self) -> str:
        size = self._output.seek(0, os.SEEK_END)
        self._output.seek(max(0, size - MAX_WORDS))
        lines = [line.strip() for line in self._output.read().decode(errors="replace").splitlines() if line.strip()]
        return lines[-1] if lines else ""


def stop_run(run: Path) -> None:
    """End a run that is at work on this machine as Ctrl-C does; BadInput where none is."""
    if not is_locked(run):
        raise BadInput(f"{run} is not at work: there is nothing to stop.")
    # The holder of the lock wrote its number. A descriptor stays with that process: should it end
    # and another take its number, the lock is free and nothing is signalled.
    elsewhere = "stop it where it was begun"
    if not hasattr(os, "pidfd_open"):
        raise BadInput(f"the run in {run} cannot be stopped from here, which needs Linux: {elsewhere}.")
    try:
        descriptor = os.pidfd_open(_number_in(run))
    except (ValueError, OSError) as error:
        raise BadInput(f"the run in {run} cannot be stopped from here ({error}): {elsewhere}.") from error
    try:
        if not is_locked(run):
            raise BadInput(f"{run} is not at work any more: there is nothing to stop.")
        signal.pidfd_send_signal(descriptor, signal.SIGINT)
    except OSError as error:
        raise BadInput(f"the run in {run} cannot be stopped from here ({error}): {elsewhere}.") from error
    finally:
        os.close(descriptor)


def _number_in(run: Path) -> int:
    return int((run / LOCK_NAME).read_text(encoding="ascii", errors="replace").strip())


def resuming_arguments(run: Path) -> tuple[str, ...]:
    """The arguments of `radiant` that go on with a run; BadInput where its manifest does not say
    what it was asked for."""
    values = values_of(read_manifest(run).config, "manifest")
    source = values.pop("source", None)
    if source is None:
        raise BadInput(f"{run} does not say of which photographs it is: type 'radiant run PHOTOGRAPHS --out {run} --resume'.")
    arguments = [word for path, value in values.items() for word in _option(path, value)]
    return ("run", str(source), "--out", str(run), *arguments, "--resume")


def _option(path: str, value: Any) -> Iterator[str]:
    """How a value other than the default is typed."""
    field = config_fields()[path]
    if value in (None, field.default):
        return
    if field.option is None or isinstance(value, bool):
        yield from ("--set", f"{path}={value}")
    else:
        yield from (field.option_name, str(value))
