"""Checks for the `desktop` extra and a display, without which Qt would end the process."""

from __future__ import annotations

import importlib.util
import os
import sys

from radiant_core.errors import BadInput

DISPLAY_VARIABLES = ("DISPLAY", "WAYLAND_DISPLAY")


def install_command(extra: str) -> str:
    """Return the command that installs an extra, for Radiant's own folder."""
    return f".venv/bin/pip install -e '.[{extra}]'"


def install_text(extra: str) -> str:
    """Return how to install a missing extra, for the middle of a sentence."""
    return f"run ./setup.sh in the folder of Radiant, or there {install_command(extra)}"


def require_desktop() -> None:
    """Raise BadInput with an alternative where the `desktop` extra or a display is missing."""
    instead = "or make pictures without a window: radiant inspect RUN --screenshot out.png."
    missing = [name for name in ("PySide6", "pyvistaqt") if importlib.util.find_spec(name) is None]
    if missing:
        raise BadInput(f"no window can be opened because {missing[0]} is not installed: {install_text('desktop')}, {instead}")
    if sys.platform.startswith("linux") and not any(os.environ.get(name) for name in DISPLAY_VARIABLES):
        raise BadInput(f"no window can be opened because neither DISPLAY nor WAYLAND_DISPLAY is set: log in at a desktop, {instead}")
