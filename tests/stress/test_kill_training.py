"""50 of 50: `radiant train` on the hamlet, killed at random moments and resumed until it is done,
ends with the bytes of a run left alone.

Jobs of up to five kills each: some in structure from motion or while libraries load, most in
training or in a checkpoint.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from radiant_app.commands.run.demo import sample_scenes_folder
from tests.stress.kill_harness import differing_files, random_moments, run_killed, run_whole

pytestmark = pytest.mark.stress

NUM_KILLS = 50
KILLS_PER_JOB = 5
RESULTS = ("scene.ply",)
OPTIONS = ("--steps", "1500", "--long-side-px", "240", "--checkpoint-every", "0.3s")


def radiant_train(project: Path, out: Path, *more: str) -> list[str]:
    return [sys.executable, "-m", "radiant_app", "train", str(project), "--out", str(out), *OPTIONS, *more]


def test_fifty_kills_of_fifty_end_with_the_same_bytes(tmp_path: Path) -> None:
    project = tmp_path / "hamlet"
    project.mkdir()
    (project / "images").symlink_to(sample_scenes_folder() / "hamlet" / "images")
    (project / "sparse").symlink_to(sample_scenes_folder() / "hamlet" / "known")
    whole = tmp_path / "whole"
    seconds = run_whole(radiant_train(project, whole))
    num_kills, job = 0, 0
    while num_kills < NUM_KILLS:
        killed = tmp_path / f"killed-{job}"
        # Each process takes up where the last one stopped, so a job of several kills sees moments
        # over all of its length.
        moments = random_moments(job, min(KILLS_PER_JOB, NUM_KILLS - num_kills), 0.9 * seconds)
        story = run_killed(radiant_train(project, killed), radiant_train(project, killed, "--resume"), moments)
        assert differing_files(whole, killed, RESULTS) == [], (job, moments)
        num_kills, job = num_kills + story.num_kills, job + 1
    assert num_kills == NUM_KILLS
