"""Measures that are kept with a run: RUN/survey/measures.json, name → kind, system, places,
figures. Once per measure."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.io.run_store import read_json, write_json
from radiant_core.numerics import FloatArray

FOLDER, MEASURES = "survey", "measures.json"
LEAST_SHOWN = 0.005
"""Smaller shares are 0 %."""
_KEYS = {"kind", "places", "figures"}


def load_measures(run: Path) -> dict[str, Any]:
    """The measures of a run, none where it has no file; BadInput where that holds something else,
    StoreDamaged where it is no JSON."""
    path = run / FOLDER / MEASURES
    kept = read_json(path) if path.is_file() else {}
    if not isinstance(kept, dict) or not all(_is_measure(row) for row in kept.values()):
        raise BadInput(f"{path} does not hold measures: move it away.")
    return kept


def save_measures(run: Path, kept: dict[str, Any]) -> None:
    """Write the measures of a run, atomically."""
    (run / FOLDER).mkdir(exist_ok=True)
    write_json(run / FOLDER / MEASURES, kept)


def places_of(row: dict[str, Any]) -> FloatArray:
    """Places (P,3) of a measure on its map."""
    return np.array(row["places"], np.float64).reshape(-1, 3)


def figures_text(row: dict[str, Any]) -> str:
    """A measure's figures with σ in one line, and what is known of the scale."""
    figures = [f"{name} {about['value']:.3f} ± {about['sigma']:.3f} {about['unit']}" for name, about in row["figures"].items()]
    filled = row.get("filled", 0)
    scale = row.get("scale")
    said = f"; {scale}" if isinstance(scale, str) and scale.isprintable() else ""
    return "; ".join(figures) + (f" ({100 * filled:.0f} % filled)" if filled >= LEAST_SHOWN else "") + said


def _is_measure(row: Any) -> bool:
    if not (isinstance(row, dict) and set(row) >= _KEYS and isinstance(row["figures"], dict)):
        return False
    try:
        return bool(np.isfinite(places_of(row)).all()) and all(
            isinstance(about, dict) and np.isfinite([about["value"], about["sigma"]]).all() and isinstance(about["unit"], str)
            for about in row["figures"].values()
        )
    except (ValueError, TypeError, KeyError):
        return False
