"""COLMAP's own signal handlers stay out of the way of whoever had them."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

HEARS = "import signal, sys\nsignal.signal(signal.SIGTERM, lambda *_: sys.exit('heard'))\n"
END = "import os, time, radiant_core.sfm.colmap.calls\nos.kill(os.getpid(), 15)\ntime.sleep(20)\n"


@pytest.mark.parametrize(("before", "code", "said"), [(HEARS, 1, "heard\n"), ("", -signal.SIGTERM, "")])
def test_sigterm_is_heard_by_whoever_had_it_before_colmap_was_imported(before: str, code: int, said: str) -> None:
    ended = subprocess.run([sys.executable, "-c", before + END], capture_output=True, text=True, timeout=60, check=False)
    assert (ended.returncode, ended.stderr) == (code, said)
