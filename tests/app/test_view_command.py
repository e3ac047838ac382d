"""`radiant inspect --page` keeps a page beside the run, makes it anew when the model changes, and leaves no half of one."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from radiant_app.commands.inspect import view as view_command
from radiant_app.commands.inspect.view import view
from radiant_app.report.progress import terminal_display
from radiant_core.errors import BadInput
from radiant_core.io.ply import load_ply, save_ply
from tests.viewer.made_up_run import made_up_town, save_run


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What the command says; it does not wait for Ctrl-C."""
    monkeypatch.setattr(view_command, "_wait", lambda: None)
    return []


def test_a_page_is_made_once_per_model(tmp_path: Path, seen: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    run = tmp_path / "run"
    save_run(run, made_up_town())
    view(run, 0, terminal_display(), seen.append)
    assert seen[0].startswith("open http://127.0.0.1:")
    first = (run / "viewer" / "scene.json").stat().st_ino
    view(run, 0, terminal_display(), seen.append)
    assert (run / "viewer" / "scene.json").stat().st_ino == first, "nothing has changed"
    splats = load_ply(run / "scene.ply")
    save_ply(run / "scene.ply", splats.select(slice_of(len(splats))))
    view(run, 0, terminal_display(), seen.append)
    assert f"{len(splats) // 2:,} Gaussians" in json.loads((run / "viewer" / "scene.json").read_text())["about"]
    made = view_command._make

    def broken(*arguments: object) -> None:
        made(*arguments)  # pyright: ignore[reportArgumentType]
        raise BadInput("stopped.")

    monkeypatch.setattr(view_command, "_make", broken)
    save_ply(run / "scene.ply", splats)
    with pytest.raises(BadInput, match="stopped"):
        view(run, 0, terminal_display(), seen.append)
    assert not list(run.glob(".viewer*")) and (run / "viewer" / "index.html").is_file(), "the old page stands"


def slice_of(count: int) -> list[int]:
    return list(range(count // 2))


def test_a_model_alone_is_shown_and_nothing_stays(tmp_path: Path, seen: list[str]) -> None:
    save_run(tmp_path / "run", made_up_town())
    (tmp_path / "a.ply").write_bytes((tmp_path / "run" / "scene.ply").read_bytes())
    view(tmp_path / "a.ply", 0, terminal_display(), seen.append)
    assert len(seen) == 2 and {path.name for path in tmp_path.iterdir()} == {"run", "a.ply"}
    with pytest.raises(BadInput, match="no"):
        view(tmp_path / "missing", 0, terminal_display(), seen.append)
