"""Structure from motion killed with SIGKILL at random moments, resumed each time: the features and
matches of a run left alone.

The moments are CPU seconds of the process, over what a whole one takes. Figures:
docs/experiments/faults.md.
"""

from __future__ import annotations

import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from radiant_app.commands.run.demo import sample_scenes_folder
from tests.core.sfm.test_kept_database import content

pytestmark = pytest.mark.stress

NUM_KILLS = 20
KILLS_PER_STORY = 4
SCRIPT = """
import os, signal, sys, threading, time
from pathlib import Path
from radiant_core.sfm.colmap import database
from radiant_core.sfm.config import SfmConfig
from radiant_core.sfm.reconstruct import reconstruct

database.PHOTOS_PER_CALL_AND_THREAD = 2

def end():
    while time.process_time() < float(sys.argv[3]):
        time.sleep(0.002)
    os.kill(os.getpid(), signal.SIGKILL)

threading.Thread(target=end, daemon=True).start()
done = []
config = SfmConfig(max_image_size_px=480, max_num_features=1000, num_threads=1)
reconstruct(Path(sys.argv[1]), Path(sys.argv[2]), config, lambda progress: done.append((progress.phase, progress.done)))
"""


def run_until(work: Path, cpu_s: float) -> int:
    """The exit code of a reconstruction of the hamlet that is killed after so many CPU seconds."""
    images = sample_scenes_folder() / "hamlet" / "images"
    return subprocess.run([sys.executable, "-c", SCRIPT, str(images), str(work), str(cpu_s)], timeout=600, check=False).returncode


def test_killed_at_random_moments_it_ends_with_the_same_features_and_matches(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert run_until(tmp_path / "whole", 1e9) == 0
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    whole_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    rng, num_kills, story = np.random.default_rng(3), 0, 0
    while num_kills < NUM_KILLS:
        work = tmp_path / f"killed-{story}"
        for moment in [*rng.uniform(0, whole_s, min(KILLS_PER_STORY, NUM_KILLS - num_kills)), 1e9]:
            code = run_until(work, moment)
            num_kills += code == -signal.SIGKILL
            assert code in (0, -signal.SIGKILL)
            if code == 0:
                break
        assert content(work / "database.db") == content(tmp_path / "whole" / "database.db"), story
        story += 1
    with capsys.disabled():
        print(f"{num_kills} of {NUM_KILLS} kills survived in {story} runs of {whole_s:.1f} CPU s, all with the same features and matches")


def test_a_polite_kill_of_the_command_leaves_one_sentence_and_a_folder_that_goes_on(tmp_path: Path) -> None:
    images = sample_scenes_folder() / "hamlet" / "images"
    command = [sys.executable, "-m", "radiant_app", "sfm", str(images), "--out", str(tmp_path / "sfm")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        while not (tmp_path / "sfm" / "database.db").exists():
            assert process.poll() is None
            time.sleep(0.05)
        process.terminate()
        _, errors = process.communicate(timeout=300)
    assert process.returncode == 130, errors
    assert errors.splitlines()[-1] == "radiant: interrupted. Finished work is kept: repeat the command with --resume."
    assert "@ 0x" not in errors
    refused = subprocess.run(command, capture_output=True, text=True, check=False)
    assert refused.returncode == 2 and "--resume" in refused.stderr
    again = subprocess.run([*command, "--resume"], capture_output=True, text=True, timeout=600, check=False)
    assert again.returncode == 0 and "12" in again.stdout, again.stderr
