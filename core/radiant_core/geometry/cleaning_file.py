"""The cleaning of a model as a file beside it, written at every step; some milliseconds each.

    {"schema": "radiant.cleaning", "version": 1, "steps": [{"kind": "size", "at_most": 3.0}, …],
     "undone": [step, …]}

It is `cleaning.json` in the folder of a run or a training, and NAME.cleaning.json beside NAME.ply.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.geometry.cleaning import (
    Cleaning,
    CleaningStep,
    OpacityStep,
    PolygonStep,
    RegionsStep,
    SelectionStep,
    SizeStep,
    SupportStep,
)
from radiant_core.geometry.selection import Front, Stroke
from radiant_core.io.run_store import read_bounded, write_json
from radiant_core.io.strict import Strict, problem_sentence

CLEANING_NAME = "cleaning.json"
SCHEMA, VERSION = "radiant.cleaning", 1
MAX_FILE_BYTES = 64 * 2**20
KINDS: dict[str, type[CleaningStep]] = {
    "polygon": PolygonStep,
    "regions": RegionsStep,
    "support": SupportStep,
    "opacity": OpacityStep,
    "size": SizeStep,
    "selection": SelectionStep,
}


class _Polygon(Strict):
    kind: Literal["polygon"]
    corners: list[tuple[float, float]]
    keep: Literal["inside", "outside"] = "inside"
    low: float | None = None
    high: float | None = None


class _Regions(Strict):
    kind: Literal["regions"]
    margin: float = 0.0


class _Support(Strict):
    kind: Literal["support"]
    num_views: int
    parallax_deg: float


class _Opacity(Strict):
    kind: Literal["opacity"]
    at_least: float


class _Size(Strict):
    kind: Literal["size"]
    at_most: float


class _Front(Strict):
    box: tuple[float, float, float, float]
    rows: int
    columns: int
    depths: list[float]


class _Stroke(Strict):
    cam_from_world: list[float]
    path: list[tuple[float, float]]
    radius: float = 0.0
    takes_away: bool = False
    front: _Front | None = None
    tolerance: float


class _Selection(Strict):
    kind: Literal["selection"]
    strokes: list[_Stroke]
    keep: Literal["inside", "outside"] = "outside"

    def step(self) -> SelectionStep:
        """The step."""
        strokes = (stroke.model_dump() for stroke in self.strokes)
        parsed = (Stroke(**{**record, "front": None if record["front"] is None else Front(**record["front"])}) for record in strokes)
        return SelectionStep(strokes=tuple(parsed), keep=self.keep)


_Step = Annotated[_Polygon | _Regions | _Support | _Opacity | _Size | _Selection, Field(discriminator="kind")]


class _File(Strict):
    schema_: Literal["radiant.cleaning"] = Field(alias="schema")
    version: Literal[1]
    steps: list[_Step]
    undone: list[_Step] = Field(default_factory=list[_Step])


def cleaning_path(model: Path) -> Path:
    """Where the cleaning of a run, a training or a model alone is kept."""
    return model / CLEANING_NAME if model.is_dir() else model.with_name(f"{model.stem}.{CLEANING_NAME}")


def load_cleaning(path: Path) -> Cleaning:
    """The cleaning in a file, an empty one where there is none; StoreDamaged where it is broken or
    of another version."""
    if not path.exists():
        return Cleaning()
    try:
        file = _File.model_validate_json(read_bounded(path, MAX_FILE_BYTES))
        return Cleaning(steps=tuple(map(_step, file.steps)), undone=tuple(map(_step, file.undone)))
    except ValidationError as error:
        problem = problem_sentence(error, "cleaning")
    except BadInput as error:
        problem = str(error)
    raise StoreDamaged(f"{path} is no cleaning ({problem}): correct it, or move it away, and nothing is left out.")


def save_cleaning(path: Path, cleaning: Cleaning) -> None:
    """Write a cleaning atomically; raises as `write_json`."""
    steps, undone = ([step_record(step) for step in steps] for steps in (cleaning.steps, cleaning.undone))
    write_json(path, {"schema": SCHEMA, "version": VERSION, "steps": steps, "undone": undone})


def step_record(step: CleaningStep) -> dict[str, object]:
    """A step as JSON values, with its kind."""
    kind = next(name for name, form in KINDS.items() if isinstance(step, form))
    return {"kind": kind, **{name: value for name, value in asdict(step).items() if value is not None}}


def _step(record: Strict) -> CleaningStep:
    if isinstance(record, _Selection):
        return record.step()
    values = record.model_dump()
    return KINDS[values.pop("kind")](**values)
