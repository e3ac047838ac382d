"""`radiant train` killed with SIGKILL in the middle of training and of writing a checkpoint ends with the bytes of one left alone."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from radiant_core.io.run_store import read_json
from tests.stress.kill_harness import differing_files, run_killed, run_whole

RESULTS = ("scene.ply",)
OPTIONS = ("--steps", "300", "--long-side-px", "160", "--checkpoint-every", "0.05s")
SLOW_WRITES = """
import sys, time
import radiant_core.io.array_file as array_file
from radiant_app.cli.app import main
write = array_file.save_file
def slowly(arrays, path, metadata):
    write(arrays, path, metadata)
    if int(path.name.split("-")[1].split(".")[0]) >= 20:
        time.sleep(30)  # the file lies there whole under its temporary name, and is not yet the checkpoint
array_file.save_file = slowly
sys.argv = ["radiant", *sys.argv[1:]]
main()
"""


def radiant_train(scene: Path, out: Path, *more: str) -> list[str]:
    return [sys.executable, "-m", "radiant_app", "train", str(scene), "--out", str(out), *OPTIONS, *more]


def step_of(path: Path) -> int:
    return int(path.name.lstrip(".").removeprefix("step-").split(".")[0])


@pytest.mark.stress
def test_a_training_killed_while_it_writes_and_while_it_trains_ends_with_the_same_bytes(hamlet_scene: Path, tmp_path: Path) -> None:
    scene, whole, killed = hamlet_scene, tmp_path / "whole", tmp_path / "killed"
    run_whole(radiant_train(scene, whole, "--checkpoint-every", "60s"))

    def half_written() -> bool:
        return any(step_of(path) >= 20 and path.stat().st_size > 0 for path in killed.glob("checkpoints/.*.part"))

    def far_on() -> bool:
        return any(step_of(path) >= 60 for path in killed.glob("checkpoints/step-*.json"))

    slowly = [sys.executable, "-c", SLOW_WRITES, *radiant_train(scene, killed)[3:]]
    story = run_killed(slowly, radiant_train(scene, killed, "--resume"), [half_written, far_on])
    assert story.num_kills == 2, story
    assert differing_files(whole, killed, RESULTS) == []
    assert not (killed / "checkpoints").exists()
    assert read_json(killed / "metrics.json")["psnr_db"] == read_json(whole / "metrics.json")["psnr_db"]
