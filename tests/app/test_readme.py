"""The README's Python is run as it stands there, and its test command is the one that CI runs."""

from __future__ import annotations

import re
from pathlib import Path

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


def test_ci_runs_the_readmes_test_command() -> None:
    """It stands beside the demo, and is a line of its own in CI: no option, no `|| true`."""
    (block,) = re.findall(r"(?:^    .+\n)*^    \./setup\.sh demo.*\n(?:^    .+\n)*", README, re.MULTILINE)
    commands = [line.split("#")[0].strip() for line in block.splitlines()]
    assert "./setup.sh test" in commands
    assert "./setup.sh test" in (ROOT / ".ci" / "run").read_text().splitlines()
