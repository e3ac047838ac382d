"""Checks for the `desktop` extra and a display, without which Qt would end the process."""

from __future__ import annotations

import os
import sys

from radiant_core.errors import BadInput
from radiant_core.extras import require_extra

DISPLAY_VARIABLES = ("DISPLAY", "WAYLAND_DISPLAY")


def require_desktop() -> None:
    """Raise BadInput with an alternative where the `desktop` extra or a display is missing."""
    instead = "make pictures without a window: radiant inspect RUN --screenshot out.png"
    require_extra("desktop", "no window can be opened", instead)
    require_display()


def require_display() -> None:
    """Raise BadInput with an alternative where there is no display."""
    instead = "make pictures without a window: radiant inspect RUN --screenshot out.png"
    if sys.platform.startswith("linux") and not any(os.environ.get(name) for name in DISPLAY_VARIABLES):
        raise BadInput(f"no window can be opened because neither DISPLAY nor WAYLAND_DISPLAY is set: log in at a desktop, or {instead}.")
