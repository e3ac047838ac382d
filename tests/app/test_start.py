"""What the start window is told: what a path is, what a run of it takes, the command that begins, stops and resumes it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from radiant_app.cli.app import app
from radiant_app.commands.inspect.start_forecast import (
    TOWN_DB,
    MachineRow,
    command_of,
    forecast_start,
    free_folder,
    quality_of,
    save_system,
)
from radiant_app.commands.inspect.start_look import look_at
from radiant_app.commands.machine import this_machine as machine_profile
from radiant_app.commands.machine.forecast import forecast, training_factor
from radiant_app.commands.run.control import BegunCommand, resuming_arguments, stop_run
from radiant_app.events import StageDone, StageProgress, StageStarted, encode
from radiant_app.files.event_file import EVENTS_NAME, read_progress
from radiant_app.files.profile_file import load_profile
from radiant_app.files.system_file import load_system
from radiant_app.run.predictions import planned_training
from radiant_core.errors import BadInput
from radiant_core.io.run_store import RunLock
from radiant_core.train.needs import Overrides
from tests.app.test_doctor import CURVES

ROOT = Path(__file__).parents[2]
HAMLET = ROOT / "sample_scenes/hamlet/images"
FLIGHT = "name,latitude,longitude,altitude\n" + "".join(f"w{n},{47.37 + 1e-4 * (n // 6)},{8.54 + 1e-4 * (n % 6)},60\n" for n in range(30))


def test_photographs_are_counted_and_placed_by_gps() -> None:
    told = []
    found = look_at(HAMLET, lambda done, total: told.append((done, total)))
    assert found.next == "run" and found.num_photographs == 12 and found.num_trained == 10 and told[-1] == (12, 12)
    assert found.places.shape == (12, 2) and not found.is_placed and "12 with GPS, over 34 × 21 m" in found.title


def test_an_alignment_of_another_program_is_named_and_placed(tmp_path: Path) -> None:
    shutil.copytree(HAMLET, tmp_path / "images")
    frames = []
    for number in range(12):
        pose = [[1.0, 0, 0, float(number)], [0, 1.0, 0, 2.0 * number], [0, 0, 1.0, 30.0], [0, 0, 0, 1]]
        frames.append({"file_path": f"images/drone_{number:04}.jpg", "transform_matrix": pose})
    record = {"camera_model": "PINHOLE", "w": 320, "h": 240, "fl_x": 300.0, "fl_y": 300.0, "cx": 160.0, "cy": 120.0, "frames": frames}
    (tmp_path / "transforms.json").write_text(json.dumps(record))
    found = look_at(tmp_path)
    assert found.is_placed and "nerfstudio" in found.title and found.places_are == "GPS of the photographs"
    assert len(found.places) == 12


def test_waypoints_runs_models_plans_and_strangers_are_told_apart(tmp_path: Path) -> None:
    (tmp_path / "flight.csv").write_text(FLIGHT)
    flight = look_at(tmp_path / "flight.csv")
    assert (flight.next, flight.num_photographs) == ("plan", 30) and flight.title.startswith("30 waypoints before capture")
    run = look_at(ROOT / "sample_scenes/runs/tiny")
    assert run.next == "open" and run.title.startswith("a finished run")
    assert look_at(ROOT / "sample_scenes/runs/tiny/scene.ply").title == "a model"
    (tmp_path / "empty").mkdir()
    with pytest.raises(BadInput, match="no photographs"):
        look_at(tmp_path / "empty")
    with pytest.raises(BadInput, match="neither a folder nor a file"):
        look_at(tmp_path / "nothing")
    (tmp_path / "words.txt").write_text("words")
    with pytest.raises(BadInput):
        look_at(tmp_path / "words.txt")


def test_three_qualities_are_options_of_radiant_run_that_hold_in_its_help() -> None:
    usual, quick, fine = (quality_of(name) for name in ("usual", "quick", "fine"))
    assert usual.options == () and usual.training == planned_training("default", Overrides())
    assert quick.training.num_steps < usual.training.num_steps < fine.training.num_steps
    assert quick.training.long_side_px < usual.training.long_side_px < fine.training.long_side_px
    words = CliRunner().invoke(app, ["run", "--help"], env={"COLUMNS": "300"}).output
    for option in (*quick.options[::2], *fine.options[::2]):
        assert option in words


def test_a_training_of_more_steps_and_pixels_takes_longer_by_the_law_of_its_curves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "machine.toml").write_text(CURVES)
    curves, train = load_profile(tmp_path / "machine.toml"), planned_training("default", Overrides())
    assert training_factor(curves, train, 40) == pytest.approx(1.0)
    assert training_factor(curves, replace(train, num_steps=3 * train.num_steps), 40) == pytest.approx(3.0)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    (tmp_path / "radiant").mkdir()
    (tmp_path / "machine.toml").rename(machine_profile.machine_profile())
    found = look_at(HAMLET)
    usual, fine = (forecast_start(found, None, quality_of(name)) for name in ("usual", "fine"))
    # By hand: sfm 2 s a photograph, a start of 4 s and 10 + 1 s a photograph.
    told = forecast(12, machine_profile.machine_profile(), 2**40)
    assert told.parts_s["structure from motion"] == 24 and told.parts_s["device"] == 26
    assert usual.time.startswith("about 50 s (structure from motion 24 s, device 26 s") and "a test's machine" in usual.time
    assert "GB free" in usual.memory and fine.time.split()[2:3] in (["min"], ["h"])
    for name, town_db in TOWN_DB.items():
        expected = forecast_start(found, None, quality_of(name)).quality
        assert "steps at" in expected and ("dB PSNR by one model of the sample town" in expected) == (town_db is not None)
    assert f"{TOWN_DB['quick']:.1f} dB PSNR by one model of the sample town" in forecast_start(found, None, quality_of("quick")).quality


def test_machines_of_a_form_become_a_system_that_is_planned_by(tmp_path: Path) -> None:
    rows = [
        MachineRow(site="office", machine="gpu", count=2, profile="rtx-3090", memory_gb=24.0, uplink_mbit_per_s=1000.0),
        MachineRow(site="home", machine="laptop", profile="laptop-cpu"),
    ]
    save_system(rows, tmp_path / "m.toml")
    system = load_system(tmp_path / "m.toml")
    assert [(edge.id, len(edge.devices)) for edge in system.edges] == [("office", 2), ("home", 1)]
    found = look_at(HAMLET)
    told = forecast_start(found, tmp_path / "m.toml", quality_of("usual"))
    assert told.time.startswith("about ") and "office" in told.time
    before = (tmp_path / "m.toml").read_bytes()
    for wrong in ([], [MachineRow(site="of fice", machine="gpu")], [MachineRow(site="a", machine="gpu", memory_gb=-1.0)]):
        with pytest.raises(BadInput):
            save_system(wrong, tmp_path / "m.toml")
    assert (tmp_path / "m.toml").read_bytes() == before and sorted(path.name for path in tmp_path.iterdir()) == ["m.toml"]
    small = [MachineRow(site="a", machine="b", memory_gb=0.001)]
    save_system(small, tmp_path / "small.toml")
    with pytest.raises(BadInput, match="hold 0 of 10 photographs"):
        forecast_start(found, tmp_path / "small.toml", quality_of("usual"))


def test_a_command_is_of_the_command_line_and_names_no_folder_that_is_taken(tmp_path: Path) -> None:
    photos = tmp_path / "photos"
    shutil.copytree(HAMLET, photos / "images")
    found = look_at(photos)
    out = free_folder(photos)
    assert out == tmp_path / "photos_run"
    assert command_of(found, out, None, quality_of("usual")) == ("run", str(photos), "--out", str(out))
    out.mkdir()
    assert free_folder(photos) == tmp_path / "photos_run_2"
    (out / "x").touch()
    with pytest.raises(BadInput, match="not empty"):
        command_of(found, out, None, quality_of("usual"))


def test_the_command_that_resumes_a_run_is_the_one_that_began_it(tmp_path: Path) -> None:
    from radiant_app.config.run_config import RunConfig, TrainOptions
    from radiant_app.files.run_folder import open_run

    train = TrainOptions(num_steps=7, settings={"sky": False})
    config = RunConfig(source=HAMLET, out=tmp_path / "run", train=train, seed=3)
    with pytest.raises(KeyboardInterrupt), open_run(config, resume=False):
        raise KeyboardInterrupt
    arguments = resuming_arguments(tmp_path / "run")
    assert arguments[:4] == ("run", str(HAMLET), "--out", str(tmp_path / "run")) and arguments[-1] == "--resume"
    assert set(arguments[4:-1]) == {"--steps", "7", "--seed", "3", "--set", "train.sky=False"}
    # Read back by the command line, it is the same run.
    begun = BegunCommand((*arguments, "--set", "train.light=nonsense"))
    words = wait_for(begun)
    assert "train.light" in words, words
    with pytest.raises(BadInput, match="not at work"):
        stop_run(tmp_path / "run")


def test_stopping_ends_the_process_that_holds_the_lock(tmp_path: Path) -> None:
    # As a run does, also where it inherits that SIGINT is ignored, as the jobs of a script in the background do.
    code = "import signal, sys, time; from pathlib import Path; from radiant_core.io.run_store import RunLock\n"
    code += "signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
    code += "from radiant_app.interrupts import interrupt_on_signals\ninterrupt_on_signals()\n"
    code += "with RunLock(Path(sys.argv[1])):\n print('held', flush=True); time.sleep(600)"
    with subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        assert process.stdout is not None and process.stdout.readline() == b"held\n"
        stop_run(tmp_path)
        assert process.wait(60) != 0
    with RunLock(tmp_path):
        (tmp_path / ".lock").write_text("no number")
        with pytest.raises(BadInput, match="cannot be stopped from here"):
            stop_run(tmp_path)


def test_losses_are_read_from_the_stream_of_a_run(tmp_path: Path) -> None:
    events = [StageStarted(stage="devices/a")]
    events += [StageProgress(stage="devices/a", done=done, total=100, note=f"loss {0.3 - 0.001 * done:.4f}") for done in (10, 50, 90)]
    events += [StageProgress(stage="devices/a", done=5, total=100, note="edge, loss 0.0500"), StageDone(stage="devices/a", seconds=3.0)]
    events += [StageProgress(stage="devices/a", done=50, total=100, note="loss 0.0400"), StageProgress(stage="sfm", done=1, total=2)]
    (tmp_path / EVENTS_NAME).write_text("".join(encode(event) + "\n" for event in events))
    (curve,) = read_progress(tmp_path).losses
    # A step that begins anew begins its curve.
    assert curve.stage == "devices/a" and curve.points == ((0.05, 0.05), (0.5, 0.04))


def test_inspecting_nothing_needs_a_window() -> None:
    result = CliRunner().invoke(app, ["inspect", "--page"])
    assert isinstance(result.exception, BadInput) and "something to show" in str(result.exception)


def wait_for(begun: BegunCommand) -> str:
    end = time.monotonic() + 120 * max(1.0, os.getloadavg()[0])
    while (words := begun.poll()) is None:
        assert time.monotonic() < end
        time.sleep(0.2)
    return words
