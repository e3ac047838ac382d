"""An environment in which no file has Unix modes, for processes that a test starts."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest


def without_modes(folder: Path) -> dict[str, str]:
    """The environment; skips the test where nothing can be compiled or preloaded."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None or not sys.platform.startswith("linux"):
        pytest.skip("no C compiler for Linux")
    library = folder / "no_modes.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", library, Path(__file__).with_suffix(".c"), "-ldl"], check=True)
    return {**os.environ, "LD_PRELOAD": str(library)}
