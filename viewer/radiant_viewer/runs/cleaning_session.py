"""`CleaningSession`: a model's cleaning as a window changes it, written at every step.

The file is read before every change: what another program, such as `radiant clean`, did in the
meantime stays. Once per click; some 10 ns a Gaussian and step.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from radiant_core.errors import BadInput
from radiant_core.geometry.cleaning import Cleaning, CleaningStep, Surroundings, keeps
from radiant_core.geometry.cleaning_file import cleaning_path, load_cleaning, save_cleaning
from radiant_core.io.ply import save_ply
from radiant_viewer.runs.cleaned_model import CleanedModel, cleaned_model


class CleaningSession:
    """`model`: the model as it is cleaned now; `changed` hears of every new one. path: the run's
    folder or the model's file."""

    def __init__(self, path: Path, model: CleanedModel, around: Surroundings) -> None:
        self._path, self._around = cleaning_path(path), around
        self.model = model
        self.changed: Callable[[], None] = lambda: None

    def count(self, step: CleaningStep) -> int:
        """How many more Gaussians a further step would leave out; BadInput where it cannot be."""
        return int((self.model.cleaned.kept & ~keeps(step, self.model.whole, self._around)).sum())

    def add(self, step: CleaningStep) -> None:
        """Make a further step; BadInput where it cannot be, or nothing would be left."""
        self._change(lambda cleaning: cleaning.add(step))

    def undo(self) -> None:
        """Take the last step back."""
        self._change(lambda cleaning: cleaning.undo())

    def redo(self) -> None:
        """Make the step again that was taken back last."""
        self._change(lambda cleaning: cleaning.redo())

    def reset(self) -> None:
        """Take all steps back."""
        self._change(lambda cleaning: cleaning.undo(len(cleaning.steps)))

    def save_kept_by(self, step: CleaningStep, path: Path) -> int:
        """Write what a further step would keep as PLY and return its number; BadInput where that is
        nothing, or the file cannot be written."""
        keep_mask = self.model.cleaned.kept & keeps(step, self.model.whole, self._around)
        if not keep_mask.any():
            raise BadInput("the crop box holds no Gaussian: make it larger.")
        save_ply(path, self.model.whole.select(keep_mask))
        return int(keep_mask.sum())

    def _change(self, change: Callable[[Cleaning], Cleaning]) -> None:
        before = load_cleaning(self._path)
        after = change(before)
        if after == before:
            return
        self.model = cleaned_model(self.model.whole, after, self._around)
        save_cleaning(self._path, after)
        self.changed()
