"""A whole run on a disk without Unix modes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from radiant_app.commands.run.demo import sample_scenes_folder
from tests.app.no_modes import without_modes

pytestmark = pytest.mark.stress
OPTIONS = ("--long-side-px", "96", "--steps", "20")


def test_a_run_on_a_disk_without_modes_says_so_at_once_ends_and_is_resumed(tmp_path: Path) -> None:
    images, out = sample_scenes_folder() / "hamlet" / "images", tmp_path / "run"
    for more in ((), ("--resume",)):
        command = [sys.executable, "-m", "radiant_app", "run", str(images), "--out", str(out), *OPTIONS, *more]
        ended = subprocess.run(command, env=without_modes(tmp_path), capture_output=True, text=True, timeout=900, check=False)
        assert ended.returncode == 0, ended.stderr
        told = ended.stderr.split()
        assert "keeps no access rights" in " ".join(told[:40]), "before structure from motion, not after it"
    manifest = json.loads((out / "manifest.json").read_text())
    assert [warning.startswith("run: ") for warning in manifest["warnings"]].count(True) == 1
