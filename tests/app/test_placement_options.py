"""--up, --distance and --height on their way from the command line to structure from motion, and where they are refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from radiant_app.cli.app import app
from radiant_app.commands.run.train import TrainRequest, train
from radiant_app.config.run_config import RunConfig, SfmOptions
from radiant_app.workers.sources import reconstruct_source, sfm_task
from radiant_app.workers.tasks import SfmTask
from radiant_core.errors import BadInput
from radiant_core.hierarchy.codec import message_of, message_record
from radiant_core.sfm.config import SfmConfig
from radiant_core.sfm.world_frame.placement import Placement

GIVEN: list[dict[str, Any]] = [{"up": "ground"}, {"distance": "a.jpg,b.jpg,3"}, {"height_m": 40.0}]


def test_a_task_carries_what_was_asked_for() -> None:
    asked = Placement(up="down", height_m=40.0)
    task = sfm_task(Path("photos"), SfmConfig(), None, asked)
    assert message_of(SfmTask, message_record(task)).placement == asked
    assert sfm_task(Path("photos"), SfmConfig(), None, Placement()).placement == Placement(up="auto", distance=None, height_m=None)
    with pytest.raises(BadInput, match="keep one"):
        Placement(distance="a.jpg,b.jpg,3", height_m=40.0)


@pytest.mark.parametrize("given", GIVEN)
@pytest.mark.parametrize("frames", ["gps", "known"])
def test_devices_that_place_themselves_cannot_be_told(frames: Any, given: dict[str, Any]) -> None:
    with pytest.raises(BadInput, match=f"--frames {frames} each device places its own"):
        RunConfig(source=Path("photos"), out=Path("out"), frames=frames, sfm=SfmOptions(**given))


@pytest.mark.parametrize("command", ["run", "train", "sfm"])
@pytest.mark.parametrize(
    "given",
    [
        *(("--height", value) for value in ("nan", "inf", "0", "-1", "1e7")),
        *(("--distance", f"a.jpg,b.jpg,{value}") for value in ("nan", "inf", "0", "x")),
        ("--up", "0,nan,1"),
        ("--up", "0,0,0"),
        ("--height", "2", "--distance", "a.jpg,b.jpg,3"),
    ],
)
def test_a_length_or_direction_that_is_none_is_refused_before_anything_is_written(
    command: str, given: tuple[str, ...], tmp_path: Path
) -> None:
    (tmp_path / "photos").mkdir()
    out = tmp_path / "out"
    done = CliRunner().invoke(app, [command, str(tmp_path / "photos"), "--out", str(out), *given])
    assert isinstance(done.exception, BadInput) and all(option in str(done.exception) for option in given[::2])
    assert not out.exists()


@pytest.mark.parametrize("given", GIVEN)
def test_a_scene_and_poses_that_come_with_the_photographs_keep_their_frame(given: dict[str, Any], tmp_path: Path) -> None:
    (tmp_path / "train" / "metadata").mkdir(parents=True)
    with pytest.raises(BadInput, match="brings its own frame"):
        reconstruct_source(sfm_task(tmp_path, SfmConfig(), None, Placement(**given)), tmp_path / "work", lambda progress: None)
    (tmp_path / "scene.safetensors").touch()
    with pytest.raises(BadInput, match="is a scene, which has its frame"):
        train(TrainRequest(source=tmp_path, out=tmp_path / "out", **given))


def test_a_photograph_that_is_not_there_is_named_before_the_work_begins(tmp_path: Path) -> None:
    hamlet = Path(__file__).parents[2] / "sample_scenes" / "hamlet" / "images"
    told: list[Any] = []
    for placement in ({"up": "nobody.jpg"}, {"distance": "nobody.jpg,hamlet_00.jpg,3"}):
        with pytest.raises(BadInput, match=r"nobody\.jpg"):
            reconstruct_source(sfm_task(hamlet, SfmConfig(), None, Placement(**placement)), tmp_path / "work", told.append)
    assert {progress.phase for progress in told} == {"checking photographs"}


@pytest.mark.parametrize("command", ["run", "sfm", "train"])
def test_every_command_that_makes_a_scene_has_the_options(command: str) -> None:
    shown = CliRunner().invoke(app, [command, "--help"]).output
    assert all(option in shown for option in ("--up", "--distance", "--height", "--contradictions"))
