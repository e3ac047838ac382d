"""What fuses depth views, for a server of forks that has imported Open3D (`forked_workers.py`)."""

from __future__ import annotations

import os
from pathlib import Path

from radiant_core.geometry import fusion


def main(arguments: list[str]) -> int:
    """Fuse the views in a folder, as the process does that starts anew."""
    words = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    return fusion.main(Path(arguments[0]), words)
