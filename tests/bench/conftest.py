"""The runs and scenes that benchmarks are tried on: those of the application's tests."""

from tests.app.conftest import (
    blank_pictures,
    finished,
    hamlet,
    hamlet_project,
    hamlet_scene,
    paper_models,
    pictures_of_a_test,
    short_rounds,
)
from tests.bench.small_fields import small_fields

__all__ = [
    "blank_pictures",
    "finished",
    "hamlet",
    "hamlet_project",
    "hamlet_scene",
    "paper_models",
    "pictures_of_a_test",
    "short_rounds",
    "small_fields",
]
