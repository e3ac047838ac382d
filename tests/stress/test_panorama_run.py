"""`radiant run` on a folder of panoramas: one line says what they become, and the run ends with a model, scores and a report."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from radiant_core.io.ply import load_ply
from radiant_core.panoramas import frame_of
from tests.forked import run_module
from tests.panorama_scene import walk, write_walk

NUM_PANORAMAS = 10


@pytest.mark.stress
def test_a_folder_of_panoramas_is_run_whole(tmp_path: Path) -> None:
    write_walk(tmp_path / "street", walk(NUM_PANORAMAS, 640), gps=True)
    out = tmp_path / "run"
    ended = run_module("radiant_app", "run", tmp_path / "street", "--out", out, "--steps", "150", "--long-side-px", "128", timeout_s=600)
    assert ended.returncode == 0, ended.stderr
    line = "10 photographs are panoramas: each becomes 6 faces of 204 px, placed as one rig."
    assert any(line in warning for warning in json.loads((out / "manifest.json").read_text())["warnings"])
    metrics = json.loads((out / "metrics.json").read_text())
    names = [row["name"] for row in metrics["images"]]
    # Every eighth of ten panoramas is held out, with all its faces that were placed.
    assert {frame_of(name) for name in names} == {"pano_000.jpg", "pano_008.jpg"} and len(names) >= 8
    better = [row["psnr_db"] > row["initial_psnr_db"] for row in metrics["images"]]
    assert sum(better) > len(better) / 2, "training fits the held-out faces better than the points it starts from"
    assert len(load_ply(out / "scene.ply")) > 500 and (out / "report.html").is_file()
