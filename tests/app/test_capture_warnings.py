"""Faults of a capture are said by the run that places it, and by the map of what is known."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console

from radiant_app.commands.plan.known_map import find_known
from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_app.commands.survey.parts import load_survey
from radiant_app.config.run_config import RunConfig
from radiant_app.events import Event, Warned
from radiant_app.files.run_folder import Manifest
from radiant_app.report.gaps import notes_of
from radiant_app.report.progress import ProgressDisplay
from radiant_app.run.pooled import sfm_stage
from radiant_app.run.progress import Progress
from radiant_core.io.colmap.model import read_model
from radiant_core.io.colmap.text import write_model
from radiant_core.next_flight.capture_faults import DOWN_DEG
from tests.viewer.made_up_run import made_up_town, save_run

HAMLET = sample_scenes_folder() / "hamlet"


@pytest.fixture(scope="module")
def straight_down(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A COLMAP project of the hamlet's photographs that look down, every second one darker by 0.8
    stops."""
    folder = tmp_path_factory.mktemp("down") / "project"
    model = read_model(HAMLET / "known")
    down = [image for image in model.images if -image.cam_from_world[2, 2] > np.cos(np.radians(DOWN_DEG))]
    write_model(folder / "sparse" / "0", model.without({image.name for image in model.images} - {image.name for image in down}))
    (folder / "images").mkdir()
    for number, image in enumerate(down):
        picture = cv2.imread(str(HAMLET / "images" / image.name))
        linear = (np.asarray(picture) / 255.0) ** 2.2 * 2.0 ** (-0.8 * (number % 2))
        cv2.imwrite(str(folder / "images" / image.name), (255 * linear ** (1 / 2.2)).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 95])
    return folder


def test_a_run_says_what_its_capture_lacks_and_its_report_notes_it(straight_down: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    manifest = Manifest(folder=run, config={})
    sfm_stage(
        RunConfig(source=straight_down, out=run), Progress(manifest=manifest, listener=lambda event: None, clock=lambda: 0.0, started_s=0)
    )
    notes = notes_of({}, manifest.warnings)
    for name, advice in (("only down", "add oblique views"), ("exposure hunts", "lock exposure")):
        assert any(f"the capture: {name}" in note and advice in note for note in notes), notes


@pytest.mark.parametrize(("grid", "names"), [((8, 3), ["only down"]), ((9, 1), ["one line", "only down"])])
def test_the_map_of_what_is_known_says_it_too(tmp_path: Path, grid: tuple[int, int], names: list[str]) -> None:
    heard: list[Event] = []

    class Hearing(ProgressDisplay):
        def __call__(self, event: Event) -> None:
            heard.append(event)

    save_run(tmp_path / "run", made_up_town(grid=grid))
    faults = find_known(load_survey(tmp_path / "run"), 6.0, Hearing(Console(quiet=True))).faults
    assert [fault.name for fault in faults] == names
    said = [event.message for event in heard if isinstance(event, Warned)]
    assert all(fault.sentence in said for fault in faults)
