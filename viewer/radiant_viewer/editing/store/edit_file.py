"""The edits of a plan as a file, written before they are solved: closing the window loses nothing.

    {"schema": "radiant.edits", "version": 1, "base": key of the plan that was edited,
     "done": [edit…], "undone": [edit…]}

A plan is a function of its edits, so edits are stored, not plans. A file that is broken or belongs
to another plan is renamed, never overwritten. Written once per edit, some milliseconds.

The window that writes first owns the file (`EditFile`). Another window that finds unfamiliar bytes
in it writes its own edits to a file beside it, until the user resolves the conflict. Bytes are
compared, not times, at every write.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.io.array_file import name_file_in_errors
from radiant_core.io.records import plan_of_record, plan_record
from radiant_core.io.run_store import content_key, read_bounded, read_json, write_json
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_viewer.editing.model.plan_edits import EDITS, AdoptPlan, Edit

SCHEMA, VERSION = "radiant.edits", 1
MAX_LOG_BYTES = 512 * 2**20
"""That of a plan, which an edit may contain."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EditHistory:
    """Edits in order, and the undone ones, of which the last is the next to redo."""

    edits: tuple[Edit, ...] = ()
    undone: tuple[Edit, ...] = ()


def plan_key(cloud: CloudPlan, edges: Sequence[EdgePlan]) -> str:
    """Return a key that depends on the plan and its machines alone, not on its file."""
    return content_key(cloud, tuple(edges))


def save_edits(path: Path, base: str, history: EditHistory) -> None:
    """Write the edits atomically; BadInput where the folder cannot be written."""
    record = {"done": [edit_record(edit) for edit in history.edits], "undone": [edit_record(edit) for edit in history.undone]}
    write_json(path, {"schema": SCHEMA, "version": VERSION, "base": base, **record})


def load_edits(path: Path, base: str) -> tuple[EditHistory, str]:
    """Return the stored edits of the plan, and a sentence if the file was unusable and renamed."""
    if not path.exists():
        return EditHistory(), ""
    try:
        with name_file_in_errors(path):
            record = read_json(path, ("schema", "version", "base", "done", "undone"), MAX_LOG_BYTES)
            if (record["schema"], record["version"]) != (SCHEMA, VERSION):
                raise BadInput(f"it is {record['schema']!r} {record['version']!r}, expected {SCHEMA!r} {VERSION}.")
            if record["base"] == base:
                return EditHistory(edits=_edits(record["done"]), undone=_edits(record["undone"])), ""
            reason = "were made on another plan"
    except (BadInput, StoreDamaged):
        reason = "cannot be read"
    aside = move_aside(path)
    return EditHistory(), f"The edits in {path.name} {reason}: they are kept as {aside.name}, this plan is shown as it was made."


def edit_record(edit: Edit) -> dict[str, Any]:
    """Return an edit as JSON values, with its kind."""
    if isinstance(edit, AdoptPlan):
        return {"edit": "AdoptPlan", "name": edit.name, **plan_record(edit.cloud, edit.edges)}
    return {"edit": type(edit).__name__, **asdict(edit)}


def parse_edit(record: Any) -> Edit:
    """Return the edit that `edit_record` wrote; BadInput for anything else."""
    kinds = {kind.__name__: kind for kind in EDITS}
    if not isinstance(record, Mapping) or record.get("edit") not in kinds:
        raise BadInput(f"{record!r:.80} is no edit of a plan: expected one of {', '.join(kinds)}.")
    if record["edit"] == "AdoptPlan":
        cloud, edges = plan_of_record(record)
        return AdoptPlan(name=_text(record["name"]), cloud=cloud, edges=edges)
    kind = kinds[record["edit"]]
    names = {field.name for field in fields(kind)}
    if set(record) != {"edit", *names}:
        raise BadInput(f"an edit {record['edit']} has {sorted(record)}, expected {sorted(names)}.")
    return kind(**{name: _value(name, record[name]) for name in names})


def _edits(records: Any) -> tuple[Edit, ...]:
    if not isinstance(records, list):
        raise BadInput("the edits are no list.")
    return tuple(parse_edit(record) for record in records)


def _value(name: str, value: Any) -> Any:
    if name == "cameras":
        return tuple(_text(item) for item in value)
    if name == "position":
        x, y = (_number(item) for item in value)
        return (x, y)
    if name == "weight_m2":
        return _number(value)
    if name == "slack":
        return None if value is None else _number(value)
    return None if name == "edge" and value is None else _text(value)


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise BadInput(f"{value!r:.40} came, expected a name.")
    return value


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise BadInput(f"{value!r:.40} came, expected a finite number.")
    return float(value)


def free_path_beside(path: Path) -> Path:
    """Return an unused path beside `path`."""
    number = 1
    while (aside := path.with_name(f"{path.stem}_{number}{path.suffix}")).exists():
        number += 1
    return aside


def move_aside(path: Path) -> Path:
    """Rename a file to an unused path and return it; BadInput where that fails."""
    aside = free_path_beside(path)
    try:
        path.rename(aside)
    except OSError as error:
        raise BadInput(f"{path} cannot be set aside ({error.strerror}): move it away, then open the plan again.") from error
    return aside


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
