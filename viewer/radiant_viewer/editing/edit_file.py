"""`EditFile`: the file in which a window keeps the edits of a plan, and what becomes of them where two windows do.

The window that writes first has the file. Another one that finds other bytes in it than it read or wrote itself neither overwrites them nor
loses its own: it keeps its edits in a file beside, until somebody says whose count. Bytes are compared, not times, at every write; each
write some milliseconds.
"""

from __future__ import annotations

import hashlib
from contextlib import suppress
from pathlib import Path

from radiant_core.errors import StoreDamaged
from radiant_core.io.run_store import read_bounded
from radiant_viewer.editing.edit_log import MAX_LOG_BYTES, EditHistory, free_path_beside, load_edits, move_aside, save_edits


class EditFile:
    """`path` is the file of the plan with key `base`; `aside` is where this window keeps its edits since another one wrote the file, None
    while it has the file for itself."""

    def __init__(self, path: Path, base: str) -> None:
        self.path, self._base = path, base
        self.aside: Path | None = None
        self._seen = _digest(path)

    def load(self) -> tuple[EditHistory, str]:
        """The edits in the file, and one sentence where they cannot be used; from now on this window has the file."""
        self.aside, self._seen = None, _digest(self.path)
        kept, sentence = load_edits(self.path, self._base)
        if not self.path.exists():
            self._seen = None
        return kept, sentence

    def save(self, kept: EditHistory) -> None:
        """Write the edits, or remove the file where there are none; beside it where another window wrote it. BadInput where that fails."""
        self.has_foreign_edits()
        target = self.aside or self.path
        if kept.done or kept.undone:
            save_edits(target, self._base, kept)
        else:
            with suppress(FileNotFoundError):
                target.unlink()
        if self.aside is None:
            self._seen = _digest(self.path)

    def has_foreign_edits(self) -> bool:
        """Whether another window wrote the file since this one read or wrote it."""
        if self.aside is None and _digest(self.path) != self._seen:
            self.aside = free_path_beside(self.path)
        return self.aside is not None

    def take_over(self, kept: EditHistory) -> str:
        """Write these edits into the file after all; returns one sentence about where what stood there is kept. BadInput as `save`."""
        theirs = move_aside(self.path) if self.path.exists() else None
        mine, self.aside, self._seen = self.aside, None, None
        self.save(kept)
        if mine is not None:
            # Its edits are in the file itself now.
            with suppress(OSError):
                mine.unlink()
        return "" if theirs is None else f"The other window's edits are kept as {theirs.name}."


def _digest(path: Path) -> str | None:
    """Of the bytes of a file, None where there is none."""
    if not path.exists():
        return None
    try:
        return hashlib.sha256(read_bounded(path, MAX_LOG_BYTES)).hexdigest()
    except StoreDamaged:
        return "unreadable"
