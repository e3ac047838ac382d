"""The model of a folder or a file, cleaned, for everything that shows or exports one. Once per
command."""

from __future__ import annotations

from pathlib import Path

from radiant_core.errors import BadInput
from radiant_core.geometry.cleaning import Cleaning, Surroundings
from radiant_core.geometry.cleaning_file import cleaning_path, load_cleaning
from radiant_core.io.model_reader import read_model
from radiant_core.io.ply import load_ply
from radiant_viewer.runs.cleaned_model import CleanedModel, cleaned_model
from radiant_viewer.runs.run_view import PLY_NAME, load_run_view, no_model_text


def load_model(path: Path, *, as_trained: bool = False) -> CleanedModel:
    """Read the model of a run, a training, or a file of any kind that `io.model_reader` reads.

    Args:
        path: the folder or the file.
        as_trained: the whole model, whatever its cleaning leaves out.

    Raises: BadInput where there is no model, or its cleaning does not fit to it; StoreDamaged for a
    broken file.
    """
    if path.is_dir() and not (path / PLY_NAME).is_file():
        raise BadInput(no_model_text(path))
    cleaning = Cleaning() if as_trained else load_cleaning(cleaning_path(path))
    if path.is_dir() and cleaning.steps:
        model = load_run_view(path).model
        assert model is not None
        return model
    if path.is_dir():
        return cleaned_model(load_ply(path / PLY_NAME), cleaning, Surroundings())
    model_file = read_model(path)
    return cleaned_model(model_file.splats, cleaning, Surroundings(), model_file.notes)
