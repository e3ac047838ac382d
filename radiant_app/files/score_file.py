"""`ScoreFile`: scores of trials in trials.json, so that a killed choice among settings goes on.

Once per trial.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError

from radiant_core.errors import BadInput
from radiant_core.io.run_store import read_json, write_json
from radiant_core.numerics import FloatArray
from radiant_core.train.few import KeptScores

SCORES = "trials.json"
"""Key of a trial → PSNR in dB of the photographs that it was trained without."""
_SCORES = TypeAdapter(dict[str, Annotated[list[Annotated[float, Field(strict=True, allow_inf_nan=False)]], Field(min_length=1)]])


class ScoreFile(KeptScores):
    """Keeps scores in a file of the training's folder. What it cannot read it does not use, and
    what it cannot write is a warning: a trial can be taken again."""

    def __init__(self, path: Path, warn: Callable[[str], None] = lambda message: None) -> None:
        self._path, self._warn = path, warn
        self._scores = self._stored_scores()

    def find(self, key: str) -> FloatArray | None:
        """The score of that trial, if there is one."""
        figures = self._scores.get(key)
        return None if figures is None else np.array(figures)

    def keep(self, key: str, figures: FloatArray) -> None:
        """Write the file anew with this score."""
        self._scores[key] = [float(figure) for figure in figures]
        try:
            write_json(self._path, self._scores)
        except BadInput as error:
            self._warn(f"the score of a trial was not kept: {str(error).rstrip('.')}. Training goes on")

    def _stored_scores(self) -> dict[str, list[float]]:
        if not self._path.exists():
            return {}
        try:
            return _SCORES.validate_python(read_json(self._path))
        except (BadInput, ValidationError):
            self._warn(f"{self._path} is damaged and is written anew: its trials are taken again")
            return {}
