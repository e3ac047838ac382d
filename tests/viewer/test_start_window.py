"""The start window: what a folder is, what a run of it takes, and the run itself, begun, stopped and resumed by clicks."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from radiant_app.files.system_file import load_system
from radiant_core.io.ply import load_ply
from tests.viewer.window_kit import ROOT, run_python

FLIGHT = "name,latitude,longitude,altitude\n" + "".join(f"w{n},{47.37 + 1e-4 * (n // 6)},{8.54 + 1e-4 * (n % 6)},60\n" for n in range(30))


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory, display: str) -> tuple[Path, dict[str, Any]]:
    """A newcomer's sessions at the window."""
    pytest.importorskip("pyvistaqt", reason="the extra 'desktop' is not installed")
    pytest.importorskip("pycolmap", reason="the extra 'sfm' is not installed")
    folder = tmp_path_factory.mktemp("start")
    shutil.copytree(ROOT / "sample_scenes/hamlet/images", folder / "hamlet/images")
    (folder / "flight.csv").write_text(FLIGHT)
    command = ["-m", "tests.viewer.start_user", str(folder / "hamlet"), str(folder / "flight.csv"), str(folder)]
    result = run_python(command, patience_s=900, DISPLAY=display, QT_QPA_PLATFORM="xcb")
    assert result.returncode == 0, result.stderr[-4000:]
    return folder, json.loads(result.stdout.splitlines()[-1])


def test_a_folder_is_named_and_becomes_a_command(seen: tuple[Path, dict[str, Any]]) -> None:
    folder, result = seen
    usual = result["seen"]["usual"]
    assert usual["title"].startswith("12 photographs, ") and "12 with GPS" in usual["title"]
    assert usual["command"] == ["run", str(folder / "hamlet"), "--out", str(folder / "hamlet_run")]
    assert usual["forecast"].startswith("Time: about ") and "an estimate of" in usual["forecast"] and "GB free" in usual["forecast"]
    assert result["seen"]["places"], "no place was drawn on the map"
    assert result["seen"]["fine"][:4] == usual["command"] and result["seen"]["fine"][4::2] == ["--steps", "--long-side-px", "--max-splats"]


def test_listed_machines_become_a_system_file_only_where_the_line_is_taken(seen: tuple[Path, dict[str, Any]]) -> None:
    folder, result = seen
    listed = result["seen"]["listed"]
    path = Path(listed[listed.index("--system") + 1])
    assert path == folder / "hamlet_run_machines.toml" and not result["seen"]["was_there"]
    assert path.read_text() == result["seen"]["kept"]
    (edge,) = load_system(path).edges
    assert edge.id == "office" and [device.memory_bytes for device in edge.devices] == [16e9, 16e9]
    assert "count" in result["seen"]["refused"], result["seen"]["refused"]


def test_waypoints_become_a_plan_and_an_empty_folder_a_sentence(seen: tuple[Path, dict[str, Any]]) -> None:
    folder, result = seen
    assert result["seen"]["flown"]["title"].startswith("30 waypoints before capture")
    assert result["seen"]["flown"]["command"][:2] == ["plan", str(folder / "flight.csv")]
    assert "no photographs" in result["seen"]["nothing"]


def test_three_actions_make_a_model_that_can_be_stopped_and_resumed(seen: tuple[Path, dict[str, Any]]) -> None:
    folder, result = seen
    trained = result["trained"]
    print(trained)
    assert len(trained["actions"]) == 3
    assert not trained["stopped"] or trained["after_stop"] == "interrupted"
    assert len(load_ply(folder / "run/scene.ply")) > 100
    assert any("run" in row and "done" in row for row in result["again"]), result["again"]
