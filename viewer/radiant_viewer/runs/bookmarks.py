"""Bookmarked views, by number, kept in views.json beside the run. Once per key; some milliseconds.

{"schema": "radiant.views", "version": 1,
 "views": {"1": {"position": [x, y, z], "focal_point": …, "up": …, "angle_deg": 30,
                 "title": "The church", "note": "Its roof was renewed in May."}}}

Title and note are for the page that is sent, and may be left out.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, ValidationError

from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.io.run_store import read_bounded, write_json
from radiant_core.io.strict import Strict, problem_sentence
from radiant_viewer.pictures.view_pose import ViewPose
from radiant_viewer.runs.flight_file import PoseRecord, pose_record

SCHEMA, VERSION = "radiant.views", 1
NUMBERS = range(1, 10)
MAX_FILE_BYTES = 1 << 20
MAX_TITLE, MAX_NOTE = 80, 400


def _printable(text: str) -> str:
    if not text.isprintable():
        raise ValueError("it has characters that cannot be printed")
    return text


class _Record(PoseRecord):
    title: Annotated[str, Field(max_length=MAX_TITLE), AfterValidator(_printable)] = ""
    note: Annotated[str, Field(max_length=MAX_NOTE), AfterValidator(_printable)] = ""

    def place(self) -> Bookmark:
        """The view and what is said of it."""
        pose = PoseRecord(**{name: getattr(self, name) for name in PoseRecord.model_fields}).pose()
        return Bookmark(pose=pose, title=self.title, note=self.note)


@dataclass(frozen=True, kw_only=True)
class Bookmark:
    """A bookmarked view, and what is said of it on a page."""

    pose: ViewPose
    title: str = ""
    note: str = ""


class _File(Strict):
    schema_: Literal["radiant.views"] = Field(alias="schema")
    version: Literal[1]
    views: dict[Annotated[str, Field(pattern="^[1-9]$")], _Record]


class Bookmarks:
    """The views of a run's folder, or of a model's file; read at every key, so that two windows
    share them."""

    def __init__(self, subject: Path) -> None:
        self.path = subject / "views.json" if subject.is_dir() else subject.with_name(f"{subject.stem}.views.json")

    def load(self) -> dict[int, Bookmark]:
        """The bookmarked views by number; StoreDamaged where the file is broken."""
        if not self.path.exists():
            return {}
        try:
            file = _File.model_validate_json(read_bounded(self.path, MAX_FILE_BYTES))
            return {int(number): view.place() for number, view in file.views.items()}
        except ValidationError as error:
            problem = problem_sentence(error, "file of views")
        except BadInput as error:
            problem = str(error)
        raise StoreDamaged(f"{self.path} holds no views ({problem}): move it away, and begin anew.")

    def keep(self, number: int, pose: ViewPose) -> str:
        """Bookmark a view in place of the one of its number, title and note included, and return
        what to say; raises as `load` and `write_json`."""
        self.save({**self.load(), number: Bookmark(pose=pose)})
        return f"View {number} is bookmarked in {self.path.name}: Alt+{number} brings it back, Shift+V gives it a title."

    def save(self, views: Mapping[int, Bookmark]) -> None:
        """Keep these views and no others; BadInput where a title or note cannot be kept, and raises
        as `write_json`."""
        records = {str(key): _record_of(view) for key, view in sorted(views.items())}
        content = {"schema": SCHEMA, "version": VERSION, "views": records}
        try:
            _File.model_validate_json(json.dumps(content))
        except ValidationError as error:
            raise BadInput(f"the views cannot be kept: {problem_sentence(error, 'file of views')}.") from error
        write_json(self.path, content)

    def view(self, number: int) -> ViewPose:
        """A bookmarked view; BadInput where there is none of that number."""
        views = self.load()
        if number not in views:
            numbers = ", ".join(map(str, sorted(views))) or "none"
            raise BadInput(f"no view {number} is bookmarked here (bookmarked: {numbers}): Ctrl+Alt+{number} bookmarks the 3D view.")
        return views[number].pose


def _record_of(view: Bookmark) -> dict[str, Any]:
    texts = {"title": view.title, "note": view.note}
    return {**pose_record(view.pose), **{name: text for name, text in texts.items() if text}}
