"""The run that many tests look at, and reports with blank pictures."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from radiant_app.commands.demo import sample_scenes_folder
from radiant_app.config.run_config import RunConfig
from radiant_app.events import Event
from radiant_app.run.pipeline import run
from tests.app.blank_reports import blank_pictures
from tests.app.pipeline_kit import TINY, Finished

__all__ = ["blank_pictures", "finished", "hamlet"]


@pytest.fixture(scope="session")
def hamlet() -> Path:
    return sample_scenes_folder() / "hamlet" / "images"


@pytest.fixture(scope="session")
def finished(hamlet: Path, tmp_path_factory: pytest.TempPathFactory) -> Finished:
    folder = tmp_path_factory.mktemp("runs")
    shutil.copytree(hamlet, folder / "photos")
    whole = next(hamlet.iterdir()).read_bytes()
    (folder / "photos" / "cut.jpg").write_bytes(whole[: len(whole) // 2])
    config = RunConfig(source=folder / "photos", out=folder / "hamlet", train=TINY)
    events: list[Event] = []
    return config, run(config, events.append), events
