"""The README's Python is run as it stands there, and its test command is the one that CI runs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text()


def test_the_library_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert len([line for line in example.splitlines() if line.strip()]) <= 10
    (tmp_path / "sample_scenes").symlink_to(ROOT / "sample_scenes")
    monkeypatch.chdir(tmp_path)
    exec(compile(example, "README.md", "exec"), {"__name__": "__main__"})
    (psnr_db,) = re.findall(r"^Scores\((\d+\.\d+) dB PSNR", capsys.readouterr().out, re.MULTILINE)
    assert float(psnr_db) > 15  # grey has 12 dB
    assert (tmp_path / "hamlet.ply").exists()


def test_the_python_of_its_page_runs_at_small_size(hamlet_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pasted one after the other, with fewer steps and smaller pictures than they stand there."""
    page = (ROOT / "docs" / "python.md").read_text()
    code = "\n".join(re.findall(r"```python\n(.*?)```", page, re.DOTALL))
    for usual, small in (
        ("num_steps=800, long_side_px=384", "num_steps=20, long_side_px=96"),
        ("long_side_px=384", "long_side_px=96"),
        ('**{"density.kind": "none"}', 'num_steps=101, long_side_px=96, **{"density.kind": "none"}'),
    ):
        assert usual in code
        code = code.replace(usual, small)
    (tmp_path / "SCENE").symlink_to(hamlet_scene)
    monkeypatch.chdir(tmp_path)
    said: dict[str, Any] = {"__name__": "__main__"}
    exec(compile(code, "python.md", "exec"), said)
    assert said["view"].image.shape[2] == 3 and (tmp_path / "town.ply").exists()
    assert len(said["result"].splats) > 0


def test_ci_runs_the_readmes_test_command() -> None:
    """It stands beside the demo, and is a line of its own in CI: no option, no `|| true`."""
    (block,) = re.findall(r"(?:^    .+\n)*^    \./setup\.sh demo.*\n(?:^    .+\n)*", README, re.MULTILINE)
    commands = [line.split("#")[0].strip() for line in block.splitlines()]
    assert "./setup.sh test" in commands
    assert "./setup.sh test" in (ROOT / ".ci" / "run").read_text().splitlines()
