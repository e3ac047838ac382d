"""Starts the process that draws with Open3D, and says in one sentence why it ended. Once a call."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from radiant_core.errors import BadInput, StageFailed
from radiant_core.io.run_store import write_json
from radiant_viewer.window.desktop import require_display

INSTEAD = "leave out --viewer open3d, and our own renderer draws it"


def open_open3d_window(source: Path, size_wh: tuple[int, int], camera: str | None = None) -> int:
    """Show a run, a plan or a model in Open3D's window until it is closed; returns the exit code.
    Raises BadInput without a display and for what cannot be read, StageFailed if Open3D ends its
    process."""
    require_display()
    return _run(source, None, size_wh, camera)


def save_open3d_picture(source: Path, path: Path, size_wh: tuple[int, int], camera: str | None = None) -> None:
    """Write what Open3D's window would show as PNG, without a display; raises as above."""
    _run(source, path, size_wh, camera)
    if not path.is_file():
        raise StageFailed(f"Open3D drew no picture of {source}: {INSTEAD}.")


def _run(source: Path, picture: Path | None, size_wh: tuple[int, int], camera: str | None) -> int:
    with TemporaryDirectory(prefix="radiant-open3d-") as folder:
        job, words = Path(folder) / "job.json", Path(folder) / "words"
        where = None if picture is None else str(picture.resolve())
        write_json(job, {"source": str(source.resolve()), "picture": where, "size_wh": list(size_wh), "camera": camera})
        with words.open("wb") as errors:
            # Open3D and the graphics driver tell what they do on standard output.
            process = subprocess.Popen(worker_command(job), stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=errors)
            code = _wait(process)
        if code in (0, 128 + signal.SIGINT):
            return code
        message = (words.read_text(errors="replace").strip() or "it said nothing").splitlines()[-1]
    if code == BadInput.exit_code:
        raise BadInput(message)
    ended = f"signal {-code}" if code < 0 else f"exit code {code}"
    raise StageFailed(f"Open3D ended by {ended} ({message}): {INSTEAD}.")


def worker_command(job: Path) -> list[str]:
    """How the process is started."""
    return [sys.executable, "-m", "radiant_viewer.open3d_window.worker", str(job)]


def _wait(process: subprocess.Popen[bytes]) -> int:
    """Wait for the window to be closed; Ctrl-C closes it."""
    try:
        return process.wait()
    except BaseException:
        process.terminate()
        raise
