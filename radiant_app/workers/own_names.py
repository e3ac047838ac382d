"""What a device says of its photographs without their names: whoever reads its events, reasons and errors learns no name of a file.

A device with a folder of its own (`--frames gps` or `known`) counts what it skips; names stay in own_notes.txt in its folder. As a second
line every event that its process sends is searched for names of files in that folder, whoever wrote them into it. Photographs that one
folder holds for all devices have no secret names: who pooled them knows them.
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

NOTES_NAME = "own_notes.txt"
"""What a device keeps for itself: a line for everything that names a file."""
HIDDEN = f"[a name, see {NOTES_NAME} of the device]"


@dataclass(frozen=True, kw_only=True)
class OwnNames:
    """The names of the files in a device's own folder, and where it keeps what it does not tell."""

    notes: Path
    source: Path | None = None
    """The device's own folder of photographs; None where nothing is to be hidden."""
    given: tuple[str, ...] = ()
    """Names of its photographs that its task has."""

    @cached_property
    def _pattern(self) -> re.Pattern[str] | None:
        """A list of names, each as it is or as Python and JSON escape it."""
        if self.source is None:
            return None
        names = {text for path in self.source.rglob("*") for text in (path.relative_to(self.source).as_posix(), path.name)} | {*self.given}
        written = {text for name in names for text in (name, repr(name)[1:-1], ascii(name)[1:-1])}
        # The longest first: a name may be the beginning of another's.
        one = "|".join(re.escape(text) for text in sorted(written, key=lambda text: (-len(text), text)))
        return re.compile(rf"(?<!\w)(?:{one})(?!\w)(?:, (?:{one})(?!\w))*") if one else None

    def without(self, text: str) -> str:
        """The text without names of the device's files; what is taken out is kept in its notes."""
        if self._pattern is None:
            return text
        told = self._pattern.sub(HIDDEN, text)
        if told != text:
            self.keep([text])
        return told

    def without_in(self, event: Event) -> Event:
        """The event without names; its stage stays."""
        if isinstance(event, Warned | Failed):
            return replace(event, message=self.without(event.message))
        if isinstance(event, StageProgress):
            return replace(event, note=self.without(event.note)) if event.note else event
        if isinstance(event, Decided):
            texts = {key: value for key, value in asdict(event.decision).items() if isinstance(value, str) and key != "stage"}
            return Decided(decision=replace(event.decision, **{key: self.without(text) for key, text in texts.items()}))
        return event

    def keep(self, texts: Iterable[str]) -> None:
        """Add to the device's notes what does not stand there yet."""
        before = self.notes.read_text(errors="surrogateescape").splitlines() if self.notes.is_file() else []
        added = [line for line in dict.fromkeys(" ".join(text.splitlines()) for text in texts) if line not in before]
        if added:
            # A full disk stops the node when it writes what matters.
            with suppress(OSError), self.notes.open("a", errors="surrogateescape") as file:
                file.write("".join(f"{line}\n" for line in added))


def own_names(kind: str, folder: Path) -> OwnNames:
    """The names that a node of this kind does not tell; none of other kinds than those that open a device's own photographs."""
    place = folder.parent if kind == "score" else folder
    notes = place / NOTES_NAME
    if kind not in ("positions", "field", "score"):
        return OwnNames(notes=notes)
    try:
        task = read_json(place / "task.json")
    except RadiantError:
        # Without it no photograph is opened: what the node reports is about the task.
        return OwnNames(notes=notes)
    # Not parsed as a message: names are taken out of the sentence about a task that is none, too.
    task = task.get("placing", task) if isinstance(task, dict) else {}
    source = task.get("source") if isinstance(task, dict) else None
    if not isinstance(source, str) or task.get("fetch", False):
        return OwnNames(notes=notes)
    listed = [names for key in ("names", "held_out") if isinstance(names := task.get(key), list)]
    given = tuple(name for names in listed for name in names if isinstance(name, str) and name)
    return OwnNames(notes=notes, source=Path(source), given=given)
