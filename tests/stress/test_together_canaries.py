"""Watermarks in the photographs of devices that train one model, looked for in every byte that any
process of the run sends: 0 found of names, EXIF, GPS, bytes and pixels.

What travels is captured below gloo, as it leaves through sockets (tests/app/sent_bytes.c): START,
BEGIN, the gradients and totals of every step. The poses of cameras do travel, in START from a
device over its edge to the root, as they do where models are joined (to the edge alone there):
the search finds them, and so sees the messages. No other device receives them.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_core.io.records import load_cameras
from tests.app.canary import PHOTOGRAPH_KINDS, POSE_KINDS, Parts, canaries_of, files_with
from tests.stress.test_canaries import DEVICES, SYSTEM, assert_each_kind_is_found_when_planted, kept_socket_bytes, marked_photographs

pytestmark = pytest.mark.stress

SIZE_PX, TIMEOUT_S = 96, 600.0


def test_no_canary_is_in_what_machines_that_train_together_send(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    captured, poses = marked_photographs(sample_scenes_folder() / "hamlet", 12, tmp_path)
    (tmp_path / "system.toml").write_text(SYSTEM)
    sent, run = kept_socket_bytes(tmp_path, monkeypatch), tmp_path / "run"
    command = ["run", captured, "--out", run, "--frames", "known", "--poses", poses, "--system", tmp_path / "system.toml"]
    command += ["--within-edge", "together", "--between-edges", "together"]
    command += ["--steps", 40, "--long-side-px", SIZE_PX, "--max-splats", 800]
    done = subprocess.run(
        [sys.executable, "-m", "radiant_app", *map(str, command)], capture_output=True, text=True, timeout=TIMEOUT_S, check=False
    )
    assert done.returncode == 0, done.stderr
    carried, parts_of = sorted(sent.iterdir()), Parts()
    num_bytes = sum(path.stat().st_size for path in carried)
    assert num_bytes > 5_000_000, "the steps of four devices and two edges"
    num_patterns = 0
    for name in DEVICES:
        skipped = [path.name for path in (captured / name).glob("zz secret*")]
        canaries = canaries_of(captured / name, load_cameras(run / "devices" / name / "cameras.safetensors"), SIZE_PX, skipped)
        above = [run / "cloud", run / "edges"]
        assert files_with(canaries.of(PHOTOGRAPH_KINDS), [*carried, *above], parts_of) == []
        assert files_with(canaries.of(POSE_KINDS), carried, parts_of), "the search sees what was sent"
        others = [run / "devices" / other for other in DEVICES if other != name]
        groups = [path / "group" for path in others]
        assert all((path / "begin.safetensors").is_file() for path in groups)
        assert files_with(canaries, groups, parts_of) == [], "no device receives another one's poses"
        assert_each_kind_is_found_when_planted(canaries, run / "scene.ply")
        num_patterns += sum(map(len, canaries.patterns.values()))
    with capsys.disabled():
        print(f"together: {num_patterns:,} patterns, {num_bytes:,} bytes through sockets, {len(carried)} processes; 0 found")
