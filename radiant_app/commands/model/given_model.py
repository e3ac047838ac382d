"""The model that a command was given, a folder or a file, and what is to be said of it."""

from __future__ import annotations

from pathlib import Path

from radiant_app.commands.run.steps import require_model
from radiant_app.events import Warned
from radiant_app.report.progress import ProgressDisplay
from radiant_core.errors import BadInput
from radiant_viewer.runs.cleaned_model import CleanedModel
from radiant_viewer.runs.model_file import load_model


def given_model(path: Path, display: ProgressDisplay, *, as_trained: bool = False) -> CleanedModel:
    """The model by its cleaning, unless `as_trained`; warns of what its reader left out or changed.
    BadInput and StoreDamaged as the readers, and BadInput without any Gaussian."""
    require_model(path)
    model = load_model(path, as_trained=as_trained)
    if not len(model.whole):
        raise BadInput(f"{path} holds no Gaussian: there is nothing to use.")
    for note in model.notes:
        display(Warned(stage="model", message=note))
    return model
