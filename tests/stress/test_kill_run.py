"""150 of 150: the process of a device, an edge or the cloud, killed with SIGKILL at 50 random
moments each, is tried again and ends with the bytes of a run left alone; and so does a run whose
main process is killed and resumed.

A tiny scene of three devices, retrained at an edge and at the cloud, checkpoints every 0.1 s. Up to
five kills hit one stage of one run: in the start of its process, in its training, in a checkpoint,
while it seals. The counts go to docs/experiments/faults.md.
"""

from __future__ import annotations

import os
import resource
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

import radiant_app.commands.run.pipeline
import radiant_app.report.html
import radiant_app.run.stages
from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_app.config.run_config import ExecutionOptions, RunConfig, TrainOptions
from radiant_app.events import Event, StageDone, StageStarted, Warned
from radiant_core.io.records import load_plan
from radiant_core.io.run_store import read_json
from tests.stress.kill_harness import differing_files, random_moments, run_killed

pytestmark = pytest.mark.stress

NUM_KILLS = 50
KILLS_PER_STORY = 5
NUM_MAIN_KILLS = 6
SYSTEM = """
# A cloud with a limit of time wants to know what retraining takes: edges retrain, and do not pool.
[cloud]
time_s = 3600
[[edge]]
id = "a"
position_m = [-10, 0]
[[edge.device]]
id = "a-1"
[[edge.device]]
id = "a-2"
[[edge]]
id = "b"
position_m = [10, 0]
[[edge.device]]
id = "b-1"
"""
AFTER = {"devices/b-1": ("devices/b-1", "edges/b", "cloud"), "edges/a": ("edges/a", "cloud"), "cloud": ("cloud",)}
"""A stage and what depends on it."""
RESULTS = ("cloud/scene.ply", "scene.ply", "edges/a/upload.safetensors", "edges/b/upload.safetensors", "devices/b-1/model.safetensors")


def config_of(out: Path) -> RunConfig:
    return RunConfig(
        source=out.parent / "hamlet",
        out=out,
        system=out.parent / "system.toml",
        train=TrainOptions(long_side_px=96, num_steps=150, max_num_splats=1500),
        execution=ExecutionOptions(max_workers=1, checkpoint_every_s=0.1),
    )


def hamlet_in(folder: Path) -> None:
    """The hamlet with its known poses as a COLMAP project of that name in `folder`."""
    (folder / "hamlet").mkdir()
    (folder / "hamlet" / "images").symlink_to(sample_scenes_folder() / "hamlet" / "images")
    (folder / "hamlet" / "sparse").symlink_to(sample_scenes_folder() / "hamlet" / "known")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, float]]:
    """A run left alone, and the CPU seconds of its stages."""
    folder = tmp_path_factory.mktemp("kills")
    hamlet_in(folder)
    (folder / "system.toml").write_text(SYSTEM)
    seconds: dict[str, float] = {}
    before_s = 0.0

    def note(event: Event) -> None:
        nonlocal before_s
        if isinstance(event, StageDone):
            # One worker at a time, so that what children took since the last one ended is this
            # one's.
            used = resource.getrusage(resource.RUSAGE_CHILDREN)
            seconds[event.stage] = used.ru_utime + used.ru_stime - before_s
            before_s += seconds[event.stage]

    radiant_app.commands.run.pipeline.run(config_of(folder / "whole"), note)
    return folder / "whole", seconds


class Killer:
    """Listens to a run and kills the process of one stage at the moments given, in CPU seconds of
    that process: other work on this machine moves no kill from one part of a stage to another."""

    def __init__(self, stage: str, folder: Path, moments: list[float]) -> None:
        self.stage, self.folder, self.moments = stage, folder, list(moments)
        self.num_kills = 0
        self._turn = 0

    def __call__(self, event: Event) -> None:
        if isinstance(event, StageStarted | StageDone) and event.stage == self.stage:
            self._turn += 1
            if isinstance(event, StageStarted) and self.moments:
                threading.Thread(target=self._kill, args=(self._turn, self.moments.pop(0)), daemon=True).start()
        if isinstance(event, Warned) and event.stage == self.stage and "killed by signal 9" in event.message:
            self.num_kills += 1
        if isinstance(event, Warned) and event.stage == self.stage and "checkpoint" in event.message and "tried again" not in event.message:
            raise AssertionError(event.message)

    def _kill(self, turn: int, after_s: float) -> None:
        pid = None
        while self._turn == turn:
            pid = pid or worker_in(self.folder)
            if pid is not None and cpu_s(pid) >= after_s:
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
                return
            time.sleep(0.005)


def cpu_s(pid: int) -> float:
    """CPU seconds of a process; infinite when it has ended."""
    try:
        return time.clock_gettime((~pid << 3) | 2)
    except OSError:
        return float("inf")


def worker_in(folder: Path) -> int | None:
    """The process of the worker that runs in this folder: the one that logs there. The command of
    a fork is its server's."""
    log = str((folder / "log.txt").resolve())
    for path in Path("/proc").glob("[0-9]*/fd/2"):
        with suppress(OSError):
            if str(path.readlink()) == log:
                return int(path.parent.parent.name)
    return None


@pytest.mark.parametrize("stage", AFTER)
def test_fifty_kills_of_a_stage_are_survived_with_the_same_bytes(
    stage: str, whole: tuple[Path, dict[str, float]], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    undisturbed, seconds = whole
    monkeypatch.setattr(radiant_app.run.stages, "ATTEMPTS", KILLS_PER_STORY + 1)
    monkeypatch.setattr(radiant_app.report.html, "write_report", lambda *arguments: None)
    num_kills, story = 0, 0
    while num_kills < NUM_KILLS:
        out = undisturbed.parent / f"{stage.replace('/', '-')}-{story}"
        shutil.copytree(undisturbed, out)
        for node in AFTER[stage]:
            shutil.rmtree(out / node)
        moments = random_moments(1000 * list(AFTER).index(stage) + story, min(KILLS_PER_STORY, NUM_KILLS - num_kills), seconds[stage])
        killer = Killer(stage, out / stage, moments)
        radiant_app.commands.run.pipeline.run(config_of(out), killer, resume=True)
        assert differing_files(undisturbed, out, RESULTS) == [], (stage, story, moments)
        assert not (out / stage / "checkpoints").exists()
        num_kills, story = num_kills + killer.num_kills, story + 1
        shutil.rmtree(out)
        with capsys.disabled():
            print(f"{stage}: {num_kills}/{num_kills} kills survived in {story} runs, all with the same bytes", flush=True)
    assert num_kills == NUM_KILLS


def test_a_run_whose_main_process_is_killed_again_and_again_resumes_with_the_same_bytes(
    whole: tuple[Path, dict[str, float]], capsys: pytest.CaptureFixture[str]
) -> None:
    undisturbed, _ = whole
    out = undisturbed.parent / "main"
    shutil.copytree(undisturbed, out)
    for node in ("devices/b-1", "edges/a", "edges/b", "cloud"):
        shutil.rmtree(out / node)
    config = config_of(out)
    assert config.system is not None
    options = [str(config.source), "--out", str(out), "--system", str(config.system), "--workers", "1"]
    sizes = ["--steps", "150", "--long-side-px", "96", "--max-splats", "1500", "--checkpoint-every", "0.1s"]
    command = [sys.executable, "-m", "radiant_app", "run", *options, *sizes, "--resume"]
    rng = np.random.default_rng(7)

    def some_time_into(stage: str, longest_s: float) -> Callable[[], bool]:
        begun_s, after_s = None, rng.uniform(0, longest_s)

        def is_due() -> bool:
            nonlocal begun_s
            if begun_s is None and worker_in(out / stage) is not None:
                begun_s = time.monotonic()
            return begun_s is not None and time.monotonic() - begun_s >= after_s

        return is_due

    stages = [stage for stage in AFTER for _ in range(NUM_MAIN_KILLS // len(AFTER))]
    story = run_killed(command, command, [some_time_into(stage, 2.0) for stage in stages])
    with capsys.disabled():
        print(f"main process: {story.num_kills} kills of {NUM_MAIN_KILLS}, {story.num_runs} runs")
    assert story.num_kills >= 1, story
    assert differing_files(undisturbed, out, RESULTS) == []
    assert worker_in(out / "cloud") is None


def test_the_photographs_of_a_device_that_always_dies_go_to_one_that_has_not_begun_and_are_named(
    whole: tuple[Path, dict[str, float]],
) -> None:
    undisturbed, seconds = whole
    out = undisturbed.parent / "lost"
    shutil.copytree(undisturbed, out)
    for node in ("devices", "edges", "cloud"):
        shutil.rmtree(out / node)
    killer = Killer("devices/a-1", out / "devices/a-1", [0.3 * seconds["devices/a-1"]] * radiant_app.run.stages.ATTEMPTS)
    result = radiant_app.commands.run.pipeline.run(config_of(out), killer, resume=True)
    manifest = read_json(out / "manifest.json")
    (decision,) = (row for row in manifest["decisions"] if row["topic"] == "lost device")
    _, before = load_plan(undisturbed / "plan.json")
    assert decision["choice"].startswith(f"{len(before[0].cameras_of('a-1'))} photographs of a-1 go to")
    cloud, after = load_plan(out / "plan.json")
    assert sum(len(plan.cameras_of(device)) for plan in after for device in plan.device_ids) == len(cloud.edge_of_camera)
    assert len(after[0].cameras_of("a-1")) == 0 and result.metrics["missing"] == {}
    assert (out / "devices/a-1/done.json").exists() is False
    begun: list[str] = []

    def note(event: Event) -> None:
        if isinstance(event, StageStarted):
            begun.append(event.stage)

    radiant_app.commands.run.pipeline.run(config_of(out), note, resume=True)
    assert begun == [], "what others trained in its place is not trained again"
