"""The desktop window of `radiant inspect RUN`: map and 3D view, layers with check boxes, and a table of the cameras.

It draws the same layers as the headless pictures. Needs the `desktop` extra and a display; `open_window` says so otherwise.
Building it takes a second or two; showing or hiding a layer redraws both views, some 50 ms each.
"""

from __future__ import annotations

import sys
from pathlib import Path

from radiant_viewer.desktop import require_desktop
from radiant_viewer.run_view import load_run_view


def open_window(run_folder: Path) -> int:
    """Show a run until its window is closed and return the exit code; BadInput without a desktop or for a broken run."""
    require_desktop()
    # A run that cannot be shown is refused before any window appears.
    run = load_run_view(run_folder)
    from PySide6.QtWidgets import QApplication

    from radiant_viewer.window import InspectorWindow

    existing = QApplication.instance()
    application = existing if isinstance(existing, QApplication) else QApplication(sys.argv[:1])
    window = InspectorWindow(run)
    window.show()
    return application.exec()
