"""`EditFile`: the file with the edits of a plan, safe when two windows edit the same plan.

The window that writes first owns the file. Another window that finds unfamiliar bytes in it writes
its own edits to a file beside it, until the user resolves the conflict. Bytes are compared, not
times, at every write; some milliseconds each.
"""

from __future__ import annotations

import hashlib
from contextlib import suppress
from pathlib import Path

from radiant_core.errors import StoreDamaged
from radiant_core.io.run_store import read_bounded
from radiant_viewer.editing.edit_log import MAX_LOG_BYTES, EditHistory, free_path_beside, load_edits, move_aside, save_edits


class EditFile:
    """`path`: the file of the plan with key `base`; `aside`: this window's own file during a
    conflict, else None."""

    def __init__(self, path: Path, base: str) -> None:
        self.path, self._base = path, base
        self.aside: Path | None = None
        self._last_digest = _digest(path)

    def load(self) -> tuple[EditHistory, str]:
        """Return the edits in the file, and a sentence if they are unusable; this window then owns
        the file."""
        self.aside, self._last_digest = None, _digest(self.path)
        history, sentence = load_edits(self.path, self._base)
        if not self.path.exists():
            self._last_digest = None
        return history, sentence

    def save(self, history: EditHistory) -> None:
        """Write the edits, to `aside` during a conflict; without edits the file is removed.
        Raises BadInput where that fails."""
        self.has_foreign_edits()
        target = self.aside or self.path
        if history.edits or history.undone:
            save_edits(target, self._base, history)
        else:
            with suppress(FileNotFoundError):
                target.unlink()
        if self.aside is None:
            self._last_digest = _digest(self.path)

    def has_foreign_edits(self) -> bool:
        """Return whether another window wrote the file since this one read or wrote it."""
        if self.aside is None and _digest(self.path) != self._last_digest:
            self.aside = free_path_beside(self.path)
        return self.aside is not None

    def take_over(self, history: EditHistory) -> str:
        """Overwrite the file, and return a sentence about the renamed edits of the other window.
        Raises BadInput as `save`."""
        theirs = move_aside(self.path) if self.path.exists() else None
        mine, self.aside, self._last_digest = self.aside, None, None
        self.save(history)
        if mine is not None:
            # These edits are in the file itself now.
            with suppress(OSError):
                mine.unlink()
        return "" if theirs is None else f"The other window's edits are kept as {theirs.name}."


def _digest(path: Path) -> str | None:
    """Return the hash of a file, None where there is none."""
    if not path.exists():
        return None
    try:
        return hashlib.sha256(read_bounded(path, MAX_LOG_BYTES)).hexdigest()
    except StoreDamaged:
        return "unreadable"
