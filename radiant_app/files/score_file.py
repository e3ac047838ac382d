"""`ScoreFile`: scores of trials in trials.json, so that a killed choice among settings goes on.

Once per trial.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.io.run_store import read_json, write_json
from radiant_core.numerics import FloatArray
from radiant_core.train.few import KeptScores

SCORES = "trials.json"
"""Key of a trial → PSNR in dB of the photographs that it was trained without."""


class ScoreFile(KeptScores):
    """Keeps scores in a file of the training's folder. What it cannot read it does not use, and
    what it cannot write is a warning: a trial can be taken again."""

    def __init__(self, path: Path, warn: Callable[[str], None] = lambda message: None) -> None:
        self._path, self._warn = path, warn

    def find(self, key: str) -> FloatArray | None:
        """The score of that trial, if there is one that is whole."""
        figures = self._read().get(key)
        try:
            scores = np.array(figures, np.float64)
        except (TypeError, ValueError):
            return None
        return scores if scores.ndim == 1 and len(scores) and np.isfinite(scores).all() else None

    def keep(self, key: str, figures: FloatArray) -> None:
        """Write the file anew with this score."""
        try:
            write_json(self._path, {**self._read(), key: [float(figure) for figure in figures]})
        except BadInput as error:
            self._warn(f"the score of a trial was not kept: {str(error).rstrip('.')}. Training goes on")

    def _read(self) -> dict[str, object]:
        try:
            scores = read_json(self._path)
        except BadInput:
            return {}
        return scores if isinstance(scores, dict) else {}
