"""Processes that show windows, and displays for them."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.forked import run_module, start_module

ROOT = Path(__file__).parents[2]
LIBRARIES = (
    *("zlib", "torch", "cv2", "pydantic.fields", "scipy.optimize", "scipy.spatial", "shapely", "matplotlib.figure"),
    *("pyvista", "pyvistaqt", "trame.app", "trame.widgets.vtk", "trame_vuetify"),
)
"""What a window or a page imports before it shows anything, 1.7 s of CPU time. Libraries alone, as in `forked.IMPORTED`."""
ADDRESS = re.compile(r"http://127\.0\.0\.1:\d+/\?secret=\S{32}")


@contextmanager
def virtual_display(size: str, *options: str) -> Iterator[str]:
    """A display of its own, "width x height x depth" large; skips where there is no Xvfb. options: of Xvfb."""
    if shutil.which("Xvfb") is None:
        pytest.skip("Xvfb is not installed: apt-get install xvfb")
    read_end, write_end = os.pipe()
    command = ["Xvfb", "-displayfd", str(write_end), "-screen", "0", size, "-nolisten", "tcp", *options]
    server = subprocess.Popen(command, pass_fds=[write_end], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    os.close(write_end)
    with os.fdopen(read_end) as pipe:
        number = pipe.readline().strip()
    assert number, "Xvfb ended without naming its display"
    try:
        yield f":{number}"
    finally:
        server.terminate()
        server.wait(10)


@pytest.fixture(scope="session")
def display() -> Iterator[str]:
    with virtual_display("1280x800x24") as name:
        yield name


def patient(seconds: float) -> float:
    """So many seconds of a machine that does nothing else, on one that does."""
    return seconds * max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))


def run_python(
    code: str | list[str], *arguments: str, patience_s: float = 300, anew: bool = False, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run code, or a module named by `["-m", …]`, in a process with every warning as an error: a fork of one that has
    imported LIBRARIES, or one that starts anew."""
    hidden = ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM")
    program = ["-W", "error", *(["-c", code] if isinstance(code, str) else code), *arguments]
    # A home of its own: windows remember their size there.
    with tempfile.TemporaryDirectory() as home:
        env = {name: value for name, value in os.environ.items() if name not in hidden} | {"XDG_CONFIG_HOME": home} | environment
        if not anew and all(map(find_spec, ("PySide6", "pyvistaqt", "trame_vuetify"))):
            return run_module("tests.run_code", *program, cwd=ROOT, timeout_s=patient(patience_s), environment=env, imported=LIBRARIES)
        command = [sys.executable, *program]
        return subprocess.run(command, env=env, cwd=ROOT, capture_output=True, text=True, timeout=patient(patience_s), check=False)


@contextmanager
def page_server(*arguments: object, log: Path, patience_s: float) -> Iterator[tuple[str, Callable[[], int]]]:
    """The address that `python -m ARGUMENTS` prints, a fork with all that it says in a log; and what interrupts it, whose
    result is its exit code."""
    with log.open("w") as words:
        process = start_module(*arguments, log=words, cwd=ROOT, environment=os.environ, imported=LIBRARIES)

    def interrupt() -> int:
        if process.poll() is None:
            os.kill(process.pid, signal.SIGINT)
        return process.wait(patient(patience_s))

    deadline_s = time.monotonic() + patient(patience_s)
    while (printed := ADDRESS.search(log.read_text())) is None:
        if process.poll() is not None or time.monotonic() > deadline_s:
            pytest.fail(f"the page gave no address but {log.read_text()!r}")
        time.sleep(0.05)
    try:
        yield printed.group(), interrupt
    finally:
        interrupt()
