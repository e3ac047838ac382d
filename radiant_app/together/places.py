"""Where the processes of machines that train together meet, and what they leave there. Loads no
torch."""

from __future__ import annotations

from pathlib import Path

GROUP_FOLDER, ENDED_NAME = "group", "end.json"
"""Folder of a node for what it says and hears before the first step, and in it the record that all
steps were taken: its process may be started again after that."""
INITIAL = "initial.safetensors"
"""There too: the Gaussians that the training began with."""
LATE_S = 60.0
"""A machine that is linked and says nothing for so long is left out until it comes back."""


def meeting_of(folder: Path, parent: str) -> Path:
    """Where the machine in the folder of a node of a run, such as RUN/devices/north-1, meets its
    parent, such as "edges/north"."""
    run = folder.parent if folder.name == "cloud" else folder.parent.parent
    return run / "together" / parent.replace("/", "_")


def mark_done(meeting: Path, child: str) -> None:
    """Say that a child has what it needs of a training that has ended."""
    (meeting / f"{child}.done").touch()


def is_done(meeting: Path, child: str) -> bool:
    """Whether it has said so."""
    return (meeting / f"{child}.done").is_file()


def mark_gone(meeting: Path, child: str) -> None:
    """Say that a child will not come, or not again."""
    meeting.mkdir(parents=True, exist_ok=True)
    (meeting / f"{child}.gone").touch()
