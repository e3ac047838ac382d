"""--out may lie in a folder that does not exist: it is made when the work is written, and goes again where it fails."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from radiant_app.cli.app import app
from radiant_app.files.out_folder import folder_made_for, require_folder_for
from radiant_core.errors import BadInput
from radiant_core.io.ply import save_ply
from tests.core.scenes import ground_splats

FLIGHT = "latitude,longitude,altitude(m)\n" + "".join(f"{47 + 1e-4 * (k // 4)},{8 + 1e-4 * (k % 4)},60\n" for k in range(16))


def call(*arguments: str) -> tuple[int, str]:
    """Exit code and, where it failed, the sentence."""
    result = CliRunner().invoke(app, list(map(str, arguments)))
    return result.exit_code, str(result.exception or "")


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    path = tmp_path / "flight.csv"
    path.write_text(FLIGHT)
    return path


@pytest.fixture
def model(tmp_path: Path) -> Path:
    save_ply(tmp_path / "model.ply", ground_splats(20))
    return tmp_path / "model.ply"


def test_a_plan_and_its_revision_go_into_new_folders(flight: Path, tmp_path: Path) -> None:
    plan, new = tmp_path / "a" / "b" / "plan.json", tmp_path / "c" / "new.json"
    assert call("plan", flight, "--out", plan) == (0, "")
    assert json.loads(plan.read_text())["schema"] == "radiant.plan" and (plan.parent / "plan_waypoints").is_dir()
    assert call("plan", "--after", plan, "--system", plan.parent / "plan_system.toml", "--out", new) == (0, "")
    assert new.is_file()


@pytest.mark.parametrize("name", ["cut.ply", "m.spz", "m.sog"])
def test_an_export_goes_into_new_folders(model: Path, tmp_path: Path, name: str) -> None:
    out = tmp_path / "x" / "y" / name
    assert call("export", model, out) == (0, "")
    assert out.is_file()


@pytest.mark.parametrize("kind", ["png folder", "film"])
def test_pictures_and_films_go_into_new_folders(model: Path, tmp_path: Path, kind: str) -> None:
    out = tmp_path / "x" / "y" / ("film.gif" if kind == "film" else "pictures")
    assert call("render", model, "--trajectory", "orbit", "--frames", 2, "--size", "32x32", "--out", out)[0] == 0
    assert out.exists()


def test_an_invitation_goes_into_a_new_folder(tmp_path: Path) -> None:
    home, out = tmp_path / "home", tmp_path / "x" / "y" / "north.join"
    assert call("node", "init", "--home", home, "--url", "https://127.0.0.1:7443") == (0, "")
    assert call("node", "invite", "north", "--home", home, "--out", out) == (0, "")
    assert out.is_file()


COMMANDS = [
    ("plan", "{flight}", "--out", "{out}/plan.json"),
    ("plan", "--after", "{plan}", "--out", "{out}/new.json"),
    ("render", "{model}", "--trajectory", "orbit", "--out", "{out}/film.gif"),
    ("render", "{model}", "--trajectory", "orbit", "--out", "{out}/pictures"),
    ("export", "{model}", "{out}/m.spz"),
    ("evaluate", "{model}", "--photos", "{photos}", "--out", "{out}/figures.json"),
    ("join", "{run}", "--out", "{out}/scene.ply"),
    ("join", "{model}", "{run}", "--out", "{out}/scene.ply"),
    ("train", "{run}", "--out", "{out}/model.ply"),
    ("train", "{photos}", "--out", "{out}/training"),
    ("sfm", "{photos}", "--out", "{out}/sfm"),
    ("run", "{photos}", "--out", "{out}/run"),
    ("machine", "profile", "--from", "{run}", "--out", "{out}/mine.toml"),
]


def given(tmp_path: Path, flight: Path, model: Path) -> dict[str, Path]:
    """What commands name: nothing of it but the flight and the model is of use."""
    for name in ("photos", "run"):
        (tmp_path / name).mkdir()
    return {"flight": flight, "model": model, "photos": tmp_path / "photos", "run": tmp_path / "run", "plan": flight}


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: f"{command[0]} {Path(command[-1]).name}")
def test_a_file_in_place_of_the_folder_is_named(command: tuple[str, ...], tmp_path: Path, flight: Path, model: Path) -> None:
    places = given(tmp_path, flight, model)
    before = sorted(tmp_path.rglob("*"))
    code, said = call(*(part.format(**places, out=flight / "deeper") for part in command))
    assert code != 0 and sorted(tmp_path.rglob("*")) == before
    # Some look at what they read first; the place is then told the next time.
    assert "expected a folder to write" in said or command[0] in ("evaluate", "join", "train", "sfm", "run"), said


@pytest.mark.parametrize("command", [row for row in COMMANDS if row[0] not in ("plan", "export", "render")], ids=lambda command: command[0])
def test_bad_input_leaves_no_new_folder(command: tuple[str, ...], tmp_path: Path, flight: Path, model: Path) -> None:
    places = given(tmp_path, flight, model)
    before = sorted(tmp_path.rglob("*"))
    code, said = call(*(part.format(**places, out=tmp_path / "new" / "deeper") for part in command))
    assert code != 0 and "no folder" not in said.replace("holds no", "")
    assert sorted(tmp_path.rglob("*")) == before


def interrupted_within(out: Path, *also: Path) -> None:
    with folder_made_for(out):
        assert out.parent.is_dir()
        for path in also:
            path.touch()
        raise KeyboardInterrupt


def test_folders_that_were_made_go_again_and_others_stay(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    out, theirs = tmp_path / "there" / "new" / "deeper" / "file", tmp_path / "there" / "new" / "of somebody else"
    with pytest.raises(KeyboardInterrupt):
        interrupted_within(out)
    assert list(tmp_path.rglob("*")) == [tmp_path / "there"]
    with pytest.raises(KeyboardInterrupt):
        interrupted_within(out, theirs)
    assert not out.parent.exists() and theirs.exists()


def test_what_is_no_folder_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to(tmp_path / "gone")
    with pytest.raises(BadInput, match=r"file is a file, expected a folder to write x\.json into: choose another place"):
        require_folder_for(tmp_path / "file" / "deeper" / "x.json")
    with pytest.raises(BadInput, match=r"link is a link to .*gone, which does not exist"):
        require_folder_for(tmp_path / "link" / "x.json")
    require_folder_for(tmp_path / "new" / "x.json")
    require_folder_for(Path("x.json"))
