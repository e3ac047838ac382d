"""`radiant render --keyframes` shows what the inspector's 3D view does: the scene, not the sky before it; forced: all."""

from __future__ import annotations

import io
import json
from pathlib import Path

from rich.console import Console

from radiant_app.commands.model.render import RenderRequest, render
from radiant_app.report.progress import ProgressDisplay
from radiant_core.io.ply import save_ply
from radiant_core.splats import concatenate_splats
from radiant_viewer.pictures.images import load_image
from tests.core.render.test_reach import sky, town


def test_a_sky_before_the_scene_is_left_out_and_told_unless_all_is_asked_for(tmp_path: Path) -> None:
    save_ply(tmp_path / "town.ply", concatenate_splats([town(), sky(400)]))
    keys = [{"time_s": 0, "position": [0, -420, 420], "target": [0, 0, 0]}, {"time_s": 0.1, "position": [0, -60, 40], "target": [0, 0, 0]}]
    (tmp_path / "keys.json").write_text(json.dumps({"keyframes": keys}))

    def blue(out: str, *, as_trained: bool) -> tuple[list[float], str]:
        console = Console(record=True, width=200, file=io.StringIO())
        place = {"model": tmp_path / "town.ply", "out": tmp_path / out, "keyframes": tmp_path / "keys.json"}
        render(RenderRequest(**place, fps=10, size_wh=(96, 64), as_trained=as_trained), ProgressDisplay(console))
        images = [load_image(path).astype(int) for path in sorted((tmp_path / out).iterdir())]
        return [float((image[26:38, 40:56, 2] > image[26:38, 40:56, 0] + 60).mean()) for image in images], console.export_text()

    (far, near), told = blue("seen", as_trained=False)
    (all_far, all_near), nothing = blue("all", as_trained=True)
    assert far < 0.02 < 0.9 < all_far and near == all_near
    assert "Gaussians far in front of the scene are not drawn" in told
    assert "far before" not in nothing
