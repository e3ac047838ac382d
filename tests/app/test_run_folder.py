"""The run's folder: what lies there already is never touched, and what a bad input began goes away again."""

from __future__ import annotations

import errno
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from radiant_app.cli.app import app
from radiant_app.commands.run.train import TrainRequest
from radiant_app.config.fields import config_fields
from radiant_app.config.run_config import RunConfig, SfmOptions, TrainOptions
from radiant_app.events import StageDone, StageStarted, Warned
from radiant_app.files import run_folder
from radiant_app.files.run_folder import (
    Manifest,
    create_folder,
    differing_options,
    open_folder,
    open_run,
    read_manifest,
    recorded_config,
    require_current,
    sfm_folder,
)
from radiant_core.errors import BadInput, CannotWrite
from radiant_core.io.run_store import RunLock, atomic_path, read_json, write_atomic, write_json
from radiant_core.train.needs import Overrides


def config(out: Path) -> RunConfig:
    return RunConfig(source=out.parent, out=out)


def begin_and_fail(out: Path, reason: str, left: str) -> None:
    with open_run(config(out), resume=False):
        (out / "sfm").mkdir()
        (out / "sfm" / left).write_text("{}")
        raise BadInput(reason)


def test_a_run_that_loses_the_race_for_the_lock_leaves_the_winners_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "run"
    winner = RunLock(out)

    class Late(RunLock):
        """The other run locks between this run's look at the folder and its lock."""

        def __enter__(self) -> RunLock:
            winner.__enter__()
            (out / "sfm").mkdir()
            (out / "sfm" / "work.txt").write_text("hours")
            return super().__enter__()

    monkeypatch.setattr(run_folder, "RunLock", Late)
    try:
        with pytest.raises(BadInput, match="another process"), open_run(config(out), resume=False):
            pass
    finally:
        winner.__exit__()
    assert (out / "sfm" / "work.txt").read_text() == "hours"


def test_a_run_that_finds_work_after_the_lock_leaves_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "run"

    class Late(RunLock):
        def __enter__(self) -> RunLock:
            (out / "scene.ply").write_text("done")
            return super().__enter__()

    monkeypatch.setattr(run_folder, "RunLock", Late)
    with pytest.raises(BadInput, match="not empty"), open_run(config(out), resume=False):
        pass
    assert (out / "scene.ply").read_text() == "done"


@pytest.mark.parametrize("name", ["manifest.json", "task.json", "summary.json", "photo.jpg", "scene.ply"])
def test_resume_is_named_only_where_something_was_begun(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("{}")
    with pytest.raises(BadInput) as told, create_folder(tmp_path, resumable=True):
        pytest.fail("it was let in")
    begun = ", or go on with what was begun there by --resume" if name.endswith(".json") else ""
    assert str(told.value) == f"{tmp_path} exists and is not empty: choose another folder{begun}."


def test_after_bad_input_the_folders_made_are_gone_and_an_empty_one_stays(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    for out, left in ((tmp_path / "a" / "b", ["mine"]), (tmp_path / "mine", ["mine"])):
        with pytest.raises(BadInput, match="unusable"):
            begin_and_fail(out, "unusable", "task.json")
        assert [path.name for path in tmp_path.iterdir()] == left
    assert list((tmp_path / "mine").iterdir()) == []


def test_a_run_is_kept_once_structure_from_motion_is_done(tmp_path: Path) -> None:
    out = tmp_path / "run"
    with pytest.raises(BadInput, match="plan"):
        begin_and_fail(out, "plan", "done.json")
    assert (out / "sfm" / "done.json").exists() and (out / "manifest.json").exists()


def test_a_link_to_nowhere_and_a_file_are_no_folders(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "gone")
    (tmp_path / "file").write_text("")
    for name, told in (("link", "which does not exist"), ("file", "is a file")):
        with pytest.raises(BadInput, match=told), create_folder(tmp_path / name):
            pass
    assert not (tmp_path / "gone").exists()


def test_stages_of_an_earlier_plan_are_forgotten_with_what_they_said(tmp_path: Path) -> None:
    manifest = Manifest(folder=tmp_path, config={})
    for stage in ("sfm", "devices/a", "devices/b"):
        manifest.record(StageStarted(stage=stage), 0.0)
        manifest.record(Warned(stage=stage, message="dark"), 1.0)
        manifest.record(StageDone(stage=stage, seconds=2.0), 2.0)
    manifest.keep_stages(["sfm", "devices/b"])
    assert list(manifest.stages) == ["sfm", "devices/b"]
    assert manifest.warnings == ["sfm: dark", "devices/b: dark"]


@pytest.mark.parametrize("field", ["source", "out"])
def test_a_path_that_is_no_text_and_a_seed_out_of_range_are_refused(field: str, tmp_path: Path) -> None:
    paths = {"source": tmp_path, "out": tmp_path / "out", field: tmp_path / "b\udcff"}
    with pytest.raises(BadInput, match="not valid UTF-8"):
        RunConfig(**paths)
    for seed in (-1, 2**31):
        with pytest.raises(BadInput, match="seed is"):
            RunConfig(source=tmp_path, out=tmp_path / "out", seed=seed)


def test_a_disk_that_is_full_empties_no_folder_and_leaves_none_that_holds_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "run"

    def compute() -> None:
        with open_run(config(out), resume=False):
            (out / "sfm").mkdir()
            write_atomic(out / "sfm" / "database.db", b"features of an hour")
            with atomic_path(out / "sfm" / "scene"):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(CannotWrite, match="No space left"):
        compute()
    assert (out / "sfm" / "database.db").read_bytes() == b"features of an hour"
    with pytest.raises(BadInput, match="--resume"), open_run(config(out), resume=False):
        pass
    monkeypatch.setattr(Manifest, "save", lambda manifest: write_atomic(tmp_path / "missing" / "manifest.json", b""))
    with pytest.raises(CannotWrite), open_run(config(tmp_path / "second"), resume=False):
        pass
    assert not (tmp_path / "second").exists()


NUMBERS: dict[str, Any] = {"num_steps": 5, "max_num_splats": 7, "settings": {"sh_degree": 1}}


def options_of(command: str) -> set[str]:
    """What the command line of `radiant COMMAND` calls its parameters."""
    return {name for option in get_command(app).commands[command].params for name in (*option.opts, option.name)}  # type: ignore[attr-defined]


def test_fields_of_a_run_that_differ_are_named_as_the_command_line_calls_them(tmp_path: Path) -> None:
    asked = config(tmp_path)
    other = replace(asked, sfm=SfmOptions(height_m=40.0), train=TrainOptions(**NUMBERS))
    assert differing_options(recorded_config(asked), recorded_config(asked)) == ""
    assert differing_options(recorded_config(other), recorded_config(asked)) == "--height, --max-splats, --set train.sh_degree, --steps"
    names = options_of("run")
    for field in config_fields().values():
        assert field.option is None or field.path == "source" or field.option_name in names, field.path


def test_settings_of_a_training_that_differ_are_named_as_the_command_line_calls_them() -> None:
    asked = TrainRequest(source=Path("photos"), out=Path("out"))
    other = replace(asked, height_m=40.0, overrides=Overrides(**NUMBERS))
    assert differing_options(asked.settings, asked.settings) == ""
    assert differing_options(other.settings, asked.settings) == "--height, --max-splats, --set, --steps"
    names = options_of("train")
    for setting in asked.settings.keys() - {"overrides", "source"}:
        assert differing_options({setting: "other"}, {setting: None}) in names, f"{setting} has no option of that name"


BEFORE_SECTIONS = {
    "aggregate_preset": "default", "distance": None, "emulated": False, "frames": "shared", "height_m": None, "masks": None,
    "matching": "auto", "plan": None, "plan_method": "exact", "poses": None, "raster_cell_m": None, "seed": 0, "single_owner": False,
    "overrides": {"long_side_px": 400, "max_num_splats": None, "num_steps": 800, "settings": {"sky": False}},
    "system": "/desk/system.toml", "train_preset": "draft", "up": None, "upload": "float16",
}  # fmt: skip
"""The configuration of a run as manifests kept it when it had no sections, without its source."""


SFM = {"source": "photos", "sfm": {"matching": "auto"}, "masks": None, "placement": {}}


def begin_sfm(out: Path, task: dict[str, Any] = SFM, *, resume: bool = False, error: BaseException | None = None) -> None:
    with sfm_folder(out, task, resume=resume):
        (out / "database.db").touch()
        if error is not None:
            raise error


def test_structure_from_motion_that_was_interrupted_goes_on_and_nothing_else_does(tmp_path: Path) -> None:
    out = tmp_path / "sfm"
    with pytest.raises(KeyboardInterrupt):
        begin_sfm(out, error=KeyboardInterrupt())
    with pytest.raises(BadInput, match="go on with what was begun there by --resume"):
        begin_sfm(out)
    with pytest.raises(BadInput, match="begun with another --masks, --matching: repeat that"):
        begin_sfm(out, {**SFM, "sfm": {"matching": "spatial"}, "masks": "masks"}, resume=True)
    with pytest.raises(BadInput, match="begun with another --height, --up: repeat that"):
        begin_sfm(out, {**SFM, "placement": {"up": "level", "height_m": 40.0}}, resume=True)
    with RunLock(out), pytest.raises(BadInput, match="another process"):
        begin_sfm(out, resume=True)
    with pytest.raises(BadInput, match="no overlap"):
        begin_sfm(out, resume=True, error=BadInput("no overlap"))
    assert (out / "database.db").is_file(), "what an earlier attempt left is not for this one to remove"
    begin_sfm(out, resume=True)
    (out / "result.json").touch()
    with pytest.raises(BadInput, match="finished"):
        begin_sfm(out, resume=True)
    (tmp_path / "other" / "sparse").mkdir(parents=True)
    with pytest.raises(BadInput, match=r"holds no task\.json"):
        begin_sfm(tmp_path / "other", resume=True)
    begin_sfm(tmp_path / "new", resume=True)


def test_structure_from_motion_keeps_its_work_after_a_full_disk_and_not_after_bad_input(tmp_path: Path) -> None:
    for error, kept in ((BadInput("no overlap"), False), (CannotWrite("the disk is full"), True)):
        with pytest.raises(BadInput):
            begin_sfm(tmp_path / "sfm", error=error)
        assert (tmp_path / "sfm" / "database.db").exists() == kept


def test_pictures_that_fill_the_disk_go_away_again_and_nobody_is_told_to_resume_them(tmp_path: Path) -> None:
    def render() -> None:
        with create_folder(tmp_path / "frames"):
            (tmp_path / "frames" / "1.png").touch()
            raise CannotWrite("the disk is full")

    with pytest.raises(CannotWrite):
        render()
    assert not (tmp_path / "frames").exists()
    (tmp_path / "mine").touch()
    with pytest.raises(BadInput) as refused, create_folder(tmp_path):
        pass
    assert "--resume" not in str(refused.value)


def test_a_run_of_an_earlier_version_is_not_resumed_over_what_it_holds(tmp_path: Path) -> None:
    Manifest(folder=tmp_path, config={}).save()
    record = read_json(tmp_path / "manifest.json")
    write_json(tmp_path / "manifest.json", {name: value for name, value in record.items() if name != "sha256"} | {"version": 1})
    before = (tmp_path / "manifest.json").read_bytes()
    assert read_manifest(tmp_path).config == {}, "it can be looked at"
    told = "was made by an earlier version of radiant.*begin again in another folder"
    with pytest.raises(BadInput, match=told), open_folder(tmp_path, {}, True, ()):
        pass
    with pytest.raises(BadInput, match=told):
        require_current(tmp_path)
    assert (tmp_path / "manifest.json").read_bytes() == before
