"""The run that many tests look at, and reports with blank pictures."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from rich.console import Console

from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_app.commands.run.pipeline import run
from radiant_app.commands.run.steps import sfm
from radiant_app.config.run_config import RunConfig
from radiant_app.events import Event
from radiant_app.report.progress import ProgressDisplay
from radiant_core.hierarchy import refining_plan
from radiant_core.sfm.config import SfmConfig
from tests.app.blank_reports import blank_pictures, pictures_of_a_test
from tests.app.fusing import fused_by_forks
from tests.app.pipeline_kit import FOUR, TINY, Finished

__all__ = [
    "blank_pictures",
    "finished",
    "fused_by_forks",
    "hamlet",
    "hamlet_project",
    "hamlet_scene",
    "paper_models",
    "pictures_of_a_test",
    "short_rounds",
]


@pytest.fixture(scope="session")
def hamlet() -> Path:
    return sample_scenes_folder() / "hamlet" / "images"


@pytest.fixture(scope="session")
def finished(hamlet: Path, tmp_path_factory: pytest.TempPathFactory) -> Finished:
    folder = tmp_path_factory.mktemp("runs")
    shutil.copytree(hamlet, folder / "photos")
    whole = next(hamlet.iterdir()).read_bytes()
    (folder / "photos" / "cut.jpg").write_bytes(whole[: len(whole) // 2])
    config = RunConfig(source=folder / "photos", out=folder / "hamlet", train=TINY, plan=FOUR)
    events: list[Event] = []
    return config, run(config, events.append), events


@pytest.fixture(scope="session")
def hamlet_project(hamlet: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The hamlet as a COLMAP project: its cameras are known, so that no run of it matches photographs."""
    folder = tmp_path_factory.mktemp("projects") / "hamlet"
    shutil.copytree(hamlet, folder / "images")
    shutil.copytree(hamlet.parent / "known", folder / "sparse" / "0")
    return folder


@pytest.fixture(scope="session")
def hamlet_scene(hamlet_project: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder `scene` of that project, 10 photographs to train on."""
    folder = tmp_path_factory.mktemp("scenes") / "scene"
    sfm(hamlet_project, folder, SfmConfig(), ProgressDisplay(Console(quiet=True)))
    return folder


@pytest.fixture(scope="session")
def paper_models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where tests of `radiant bench paper`, all by one layout and setting, keep what they have made."""
    return tmp_path_factory.mktemp("paper") / "out"


@pytest.fixture
def short_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Devices show each photograph once in a round of refining, not five to eight times: for tests
    that ask what is made and kept, not how good it is."""
    monkeypatch.setattr(refining_plan, "MAX_STEPS", 1)
