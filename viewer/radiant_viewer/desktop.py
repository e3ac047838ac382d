"""Whether a window can be opened here: the `desktop` extra and a display, checked before Qt, which would end the process."""

from __future__ import annotations

import importlib.util
import os
import sys

from radiant_core.errors import BadInput

DISPLAY_VARIABLES = ("DISPLAY", "WAYLAND_DISPLAY")


def require_desktop() -> None:
    """Raise BadInput, with what to do instead, where the `desktop` extra or a display is missing."""
    instead = "or make pictures without a window: radiant inspect RUN --screenshot out.png."
    missing = [name for name in ("PySide6", "pyvistaqt") if importlib.util.find_spec(name) is None]
    if missing:
        raise BadInput(f"no window can be opened because {missing[0]} is not installed: install the extra 'desktop', {instead}")
    if sys.platform.startswith("linux") and not any(os.environ.get(name) for name in DISPLAY_VARIABLES):
        raise BadInput(f"no window can be opened because neither DISPLAY nor WAYLAND_DISPLAY is set: log in at a desktop, {instead}")
