"""Removes file names of a device's photographs from its events, reasons and errors.

A device with a folder of its own (`--frames gps` or `known`) reports counts of skipped photographs
and keeps their names in own_notes.txt in its folder. As a second line of defence every event of its
process is searched for names of files in that folder. Photographs that one folder holds for all
devices have no secret names.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path

from radiant_app.events import Decided, Event, Failed, StageProgress, Warned
from radiant_core.errors import RadiantError
from radiant_core.io.run_store import read_json

OWN_SOURCE = "own_source.json"
"""File in the folder of a device whose photographs nobody else has heard of: where they are."""
NOTES_NAME = "own_notes.txt"
"""File in the device's folder with the original text of everything redacted."""
HIDDEN = f"[a name, see {NOTES_NAME} of the device]"


@dataclass(frozen=True, kw_only=True)
class Redactor:
    """Replaces names of files in a device's own folder and keeps the original texts."""

    notes: Path
    source: Path | None = None
    """The device's own folder of photographs; None: nothing is redacted."""
    names_in_task: tuple[str, ...] = ()
    """Names of photographs in its task."""

    @cached_property
    def _pattern(self) -> re.Pattern[str] | None:
        """Matches lists of names, each verbatim or as Python and JSON escape it."""
        if self.source is None:
            return None
        names = {text for path in self.source.rglob("*") for text in (path.relative_to(self.source).as_posix(), path.name)} | {
            *self.names_in_task
        }
        written = {text for name in names for text in (name, repr(name)[1:-1], ascii(name)[1:-1])}
        # The longest first: a name may be a prefix of another.
        one = "|".join(re.escape(text) for text in sorted(written, key=lambda text: (-len(text), text)))
        return re.compile(rf"(?<!\w)(?:{one})(?!\w)(?:, (?:{one})(?!\w))*") if one else None

    def redact(self, text: str) -> str:
        """Return the text without names of the device's files; keeps the original in the notes."""
        if self._pattern is None:
            return text
        redacted = self._pattern.sub(HIDDEN, text)
        if redacted != text:
            self.keep([text])
        return redacted

    def redact_event(self, event: Event) -> Event:
        """Return the event with redacted texts; its stage stays."""
        if isinstance(event, Warned | Failed):
            return replace(event, message=self.redact(event.message))
        if isinstance(event, StageProgress):
            return replace(event, note=self.redact(event.note)) if event.note else event
        if isinstance(event, Decided):
            texts = {key: value for key, value in asdict(event.decision).items() if isinstance(value, str) and key != "stage"}
            return Decided(decision=replace(event.decision, **{key: self.redact(text) for key, text in texts.items()}))
        return event

    def keep(self, texts: Iterable[str]) -> None:
        """Append the texts that the device's notes do not contain yet."""
        before = self.notes.read_text(errors="surrogateescape").splitlines() if self.notes.is_file() else []
        added = [line for line in dict.fromkeys(" ".join(text.splitlines()) for text in texts) if line not in before]
        if added:
            # A full disk stops the node at its next essential file.
            with suppress(OSError), self.notes.open("a", errors="surrogateescape") as file:
                file.write("".join(f"{line}\n" for line in added))


def make_redactor(kind: str, folder: Path) -> Redactor:
    """The redactor of a node, for kinds of node that open a device's own photographs."""
    place = folder.parent if kind in ("score", "refine", "count", "raster") else folder
    notes = place / NOTES_NAME
    if kind not in ("positions", "field", "score", "refine", "count", "raster", "own_field"):
        return Redactor(notes=notes)
    if (place / OWN_SOURCE).is_file():
        return Redactor(notes=notes, source=Path(read_json(place / OWN_SOURCE, ("photographs",))["photographs"]))
    try:
        task = read_json(place / "task.json")
    except RadiantError:
        # Without a task no device's own photograph is opened.
        return Redactor(notes=notes)
    # Not parsed as a message: the error about an invalid task is redacted too.
    task = task.get("placing", task) if isinstance(task, dict) else {}
    source = task.get("source") if isinstance(task, dict) else None
    if not isinstance(source, str) or task.get("fetch", False):
        return Redactor(notes=notes)
    listed = [names for key in ("names", "held_out") if isinstance(names := task.get(key), list)]
    listed_names = tuple(name for names in listed for name in names if isinstance(name, str) and name)
    return Redactor(notes=notes, source=Path(source), names_in_task=listed_names)
