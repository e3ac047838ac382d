"""Films of the model and the splat view of a PLY from elsewhere, in real windows: each starts a process that loads a renderer."""

from __future__ import annotations

from pathlib import Path

import pytest

from radiant_core.io.ply import save_ply
from tests.viewer.made_up_run import made_up_town, save_run
from tests.viewer.window_kit import display, run_python  # noqa: F401 (a fixture)


@pytest.mark.stress
def test_windows_film_and_draw_the_splats(tmp_path: Path, display: str) -> None:  # noqa: F811 (the fixture)
    pytest.importorskip("pyvistaqt", reason="the extra 'desktop' is not installed")
    save_run(tmp_path / "run", made_up_town(step_levels=60))
    save_ply(tmp_path / "model.ply", made_up_town().splats)
    (tmp_path / "out").mkdir()
    tasks = [f"film={tmp_path / 'run'}", f"splats={tmp_path / 'model.ply'}"]
    result = run_python(["-m", "tests.viewer.window_driver"], str(tmp_path / "out"), *tasks, DISPLAY=display, QT_QPA_PLATFORM="xcb")
    assert result.returncode == 0, result.stderr[-4000:]
    assert (tmp_path / "out/splats.gif").stat().st_size > 1000
