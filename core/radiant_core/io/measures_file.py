"""Measures that are kept with a run: RUN/survey/measures.json, name → kind, system, places,
figures. Once per measure.

A run may come from a stranger: the file is typed to the last key where it is read, and what passed
is what is used.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, Field, TypeAdapter, ValidationError

from radiant_core.choices import MeasureKind
from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.io.run_store import MAX_JSON_BYTES, parse_json, read_bounded, write_json
from radiant_core.io.strict import Strict, problem_sentence
from radiant_core.numerics import FloatArray

FOLDER, MEASURES = "survey", "measures.json"
LEAST_SHOWN = 0.005
"""Smaller shares are 0 %."""
MAX_TEXT, MAX_NUMBER = 200, 1e15
LEAST_PLACES: dict[str, int] = {"distance": 2, "height": 2, "profile": 2, "area": 3, "volume": 3}


def _printable(text: str) -> str:
    if not text.isprintable():
        raise ValueError("it has characters that cannot be printed")
    return text


_Text = Annotated[str, Field(max_length=MAX_TEXT), AfterValidator(_printable)]
_Number = Annotated[float, Field(ge=-MAX_NUMBER, le=MAX_NUMBER)]


class _Figure(Strict):
    value: _Number
    sigma: Annotated[float, Field(ge=0, le=MAX_NUMBER)]
    unit: _Text


class _Measure(Strict):
    kind: MeasureKind
    crs: _Text = ""
    """Empty where the file does not say it, as those of early versions do not."""
    places: Annotated[list[tuple[_Number, _Number, _Number]], Field(max_length=1_000_000)]
    figures: dict[_Text, _Figure]
    filled: Annotated[float, Field(ge=0, le=1)] = 0.0
    scale: Annotated[str, Field(max_length=1_000), AfterValidator(_printable)] = ""
    """What is known of the scale that lengths are in."""
    profile: list[tuple[_Number | None, _Number | None, _Number | None]] | None = None


_MEASURES = TypeAdapter(dict[_Text, _Measure])


def load_measures(run: Path) -> dict[str, Any]:
    """The measures of a run, none where it has no file; BadInput where that holds something else,
    StoreDamaged where it is no JSON."""
    path = run / FOLDER / MEASURES
    if not path.is_file():
        return {}
    data = read_bounded(path, MAX_JSON_BYTES)
    try:
        parse_json(data)  # also where a key comes twice
        measures = _MEASURES.validate_json(data)
    except ValidationError as error:
        problem = problem_sentence(error, "measure").rstrip(".")
        raise BadInput(f"{path} does not hold measures ({problem}): correct it, or move it away.") from error
    except (ValueError, RecursionError) as error:
        raise StoreDamaged(f"{path} is not valid JSON ({error}): correct it, or move it away.") from error
    for name, row in measures.items():
        if len(row.places) < LEAST_PLACES[row.kind]:
            raise BadInput(f"{path} does not hold measures ({name!r} has {len(row.places)} places for its {row.kind}): move it away.")
    return {name: {"crs": row.crs, **row.model_dump(mode="json", exclude_unset=True)} for name, row in measures.items()}


def save_measures(run: Path, measures: dict[str, Any]) -> None:
    """Write the measures of a run, atomically."""
    (run / FOLDER).mkdir(exist_ok=True)
    write_json(run / FOLDER / MEASURES, measures)


def places_of(row: dict[str, Any]) -> FloatArray:
    """Places (P,3) of a measure on its map."""
    return np.array(row["places"], np.float64).reshape(-1, 3)


def figures_text(row: dict[str, Any]) -> str:
    """A measure's figures with σ in one line, and what is known of the scale."""
    figures = [f"{name} {about['value']:.3f} ± {about['sigma']:.3f} {about['unit']}" for name, about in row["figures"].items()]
    filled = row.get("filled", 0)
    scale_note = f"; {row['scale']}" if row.get("scale") else ""
    return "; ".join(figures) + (f" ({100 * filled:.0f} % filled)" if filled >= LEAST_SHOWN else "") + scale_note
