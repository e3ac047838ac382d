"""The real windows under a real X server, in a process of their own: of a run for all that it does,
of one at work from before its plan to its model, and of a PLY."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image as Pictures

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.io.ply import load_ply, save_ply
from radiant_core.render.rendered_view import render_views
from radiant_viewer.window.desktop import require_desktop
from tests.viewer.made_up_run import made_up_town, save_run
from tests.viewer.window_kit import run_python


def test_the_windows_of_a_run_of_one_at_work_and_of_a_ply_from_elsewhere(tmp_path: Path, display: str) -> None:
    """The one test of the real windows: three sessions under one X server, in a process that starts anew."""
    pytest.importorskip("pyvistaqt", reason="the extra 'desktop' is not installed")
    save_run(tmp_path / "run", made_up_town(step_levels=60))
    save_run(tmp_path / "begun", made_up_town())
    save_ply(tmp_path / "model.ply", made_up_town().splats)
    out = tmp_path / "out"
    out.mkdir()
    (tmp_path / "begun/scene.ply").rename(out / "scene.ply")
    (tmp_path / "begun/plan.json").rename(out / "plan.json")
    (tmp_path / "begun/metrics.json").unlink()
    tasks = [f"run={tmp_path / 'run'}", f"begun={tmp_path / 'begun'}", f"model={tmp_path / 'model.ply'}"]
    result = run_python(["-m", "tests.viewer.window_driver"], str(out), *tasks, anew=True, DISPLAY=display, QT_QPA_PLATFORM="xcb")
    assert result.returncode == 0, result.stderr[-4000:]
    written = ["cameras.csv", "dragged.ply", "inside.ply", "layers.gif", "ours.npz", "part.ply", "shot.png", "window.png"]
    assert sorted(path.name for path in out.iterdir()) == written
    assert (out / "shot.png").stat().st_size > 5000
    with Pictures.open(out / "layers.gif") as film:
        assert getattr(film, "n_frames", 1) == 6, "the film of the layers stands still"
    ours = np.load(out / "ours.npz")
    height, width = ours["image"].shape[:2]
    camera = Cameras(names=("view",), Ks=ours["K"], cam_from_world=ours["cam_from_world"], sizes_wh=np.array([[width, height]]))
    exact = next(render_views(load_ply(tmp_path / "run/scene.ply"), camera))
    over = 255 * (exact.image + 1 - exact.alpha[..., None])
    assert np.abs(ours["image"] - over).mean() < 1, "the splat view does not follow the 3D view"


def test_without_a_display_there_is_one_sentence_and_no_crash(tmp_path: Path) -> None:
    code = "import sys; from pathlib import Path; from radiant_viewer.window.inspector import open_window\n"
    code += "try: open_window(Path(sys.argv[1]))\nexcept ValueError as error: print(error); sys.exit(error.exit_code)"
    result = run_python(code, str(tmp_path), anew=True)
    assert result.returncode == 2, result.stderr
    assert len(result.stdout.strip().splitlines()) == 1
    assert "DISPLAY" in result.stdout
    assert "--screenshot" in result.stdout


def test_without_the_extra_the_missing_package_and_the_way_out_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("radiant_core.extras.find_spec", lambda name: None)
    with pytest.raises(BadInput, match=r"PySide6.*install.*'radiant-splats\[desktop\]'.*--screenshot"):
        require_desktop()
