"""Python processes for tests, forked from one that has imported the libraries (`fork_server.py`).

A node of a tiny run takes 2 s of CPU time for imports and 0.3 s for its work. Tests of how a
process starts call `sys.executable` themselves, and whatever a forked process starts does start
anew.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

from radiant_app.executors import local
from radiant_app.executors.fork_server import ForkServer, keep_servers, open_server, start_server
from radiant_app.executors.sessions import signal_session

LIBRARIES = ("zlib", "torch", "pycolmap", "cv2", "pydantic.fields", "scipy.optimize", "scipy.spatial", "shapely", "typer", "rich.progress")
COMMANDS = (
    *("radiant_app.cli.app", "radiant_app.report.html", "radiant_app.commands.run.pipeline", "radiant_app.commands.run.train"),
    *("radiant_app.commands.run.steps", "radiant_app.commands.export.export", "radiant_app.commands.model.render"),
    *("radiant_app.commands.plan.plan", "radiant_app.commands.survey.measure"),
)
IMPORTED = tuple(dict.fromkeys((*LIBRARIES, *COMMANDS, *local.IMPORTED)))
"""Of commands and of the nodes of runs: to import what they have in common takes a command 0.2 to 1.4 s of CPU time."""
PATIENCE_S = 600.0
_keeping = keep_servers()


def keep_until_the_end() -> None:
    """Servers stay, of runs too, until `end_all`."""
    _keeping.__enter__()


def end_all() -> None:
    """End what `keep_until_the_end` keeps."""
    _keeping.__exit__(None, None, None)


def open_server_of_tests(names: Sequence[str], environment: Mapping[str, str]) -> ForkServer | None:
    """What the local executor calls: one server for the nodes of all tests of a process."""
    return server_of(tuple(dict.fromkeys((*IMPORTED, *names))), environment)


def start_server_of_tests(names: Sequence[str], environment: Mapping[str, str]) -> ForkServer | None:
    """What starts that one."""
    return start_server(tuple(dict.fromkeys((*IMPORTED, *names))), environment)


def server_of(imported: Sequence[str], environment: Mapping[str, str]) -> ForkServer | None:
    """The server of processes that have imported these, however long that takes on a machine at work."""
    if (started := start_server(imported, environment)) is not None:
        started.is_ready(PATIENCE_S)
    return open_server(imported, environment)


def start_module(*arguments: object, log: IO[Any], cwd: Path, environment: Mapping[str, str], imported: Sequence[str] = IMPORTED) -> Any:
    """`python -m ARGUMENTS` with all that it prints in a log; what Popen and ForkedProcess have alike."""
    command = [*map(str, arguments)]
    if (server := server_of(imported, environment)) is None:
        starting = [sys.executable, "-m", *command]
        return subprocess.Popen(starting, cwd=cwd, env=environment, stdout=log, stderr=log, start_new_session=True)
    with Path(os.devnull).open() as nothing:
        return server.start(command, (nothing.fileno(), log.fileno(), log.fileno()), environment, cwd)


def run_module(
    *arguments: object,
    cwd: Path | None = None,
    timeout_s: float = 300,
    environment: Mapping[str, str] = os.environ,
    imported: Sequence[str] = IMPORTED,
) -> subprocess.CompletedProcess[str]:
    """What `python -m ARGUMENTS` prints, and its exit code; `imported` are the libraries of the process it is forked from."""
    command = [*map(str, arguments)]
    if (server := server_of(imported, environment)) is None:
        starting = [sys.executable, "-m", *command]
        return subprocess.run(starting, capture_output=True, text=True, cwd=cwd, env=environment, timeout=timeout_s, check=False)
    with Path(os.devnull).open() as nothing, tempfile.TemporaryFile("w+") as output, tempfile.TemporaryFile("w+") as errors:
        process = server.start(command, (nothing.fileno(), output.fileno(), errors.fileno()), environment, cwd)
        try:
            code = process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            signal_session(process.pid, signal.SIGKILL)
            raise
        output.seek(0)
        errors.seek(0)
        return subprocess.CompletedProcess(command, code, output.read(), errors.read())


def has_ended(pid: int) -> bool:
    """Whether a process is gone, or waits for nothing but its parent."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except (FileNotFoundError, ProcessLookupError):
        return True
