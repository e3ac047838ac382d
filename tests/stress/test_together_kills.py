"""Devices that train as one model: whichever process is killed or stands still, and whenever, the
scene has the bytes of a run left alone.

    one member (a device, an edge, the cloud)   SIGKILL; the run starts it again by itself
    the run itself                              SIGKILL; its workers end by themselves, `--resume`
    a device                                    SIGSTOP for some seconds, then SIGCONT

Half the kills come at a random moment of the process's life, start and end included, half at a
random step of the training.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import radiant_app.commands.run.pipeline
import radiant_app.report.html
from radiant_app.config.run_config import ExecutionOptions, PlanOptions, RunConfig, TrainOptions
from radiant_app.events import Event, StageDone, StageProgress, StageStarted, Warned
from radiant_core.io.run_store import read_json
from tests.stress.kill_harness import differing_files, run_killed
from tests.stress.test_kill_run import hamlet_in, worker_in

pytestmark = pytest.mark.stress

DEVICES = ("devices/edge-1-1", "devices/edge-1-2", "devices/edge-2-1", "devices/edge-2-2")
MEMBERS = (*DEVICES, "edges/edge-1", "edges/edge-2", "cloud")
RESULTS = ("scene.ply", "cloud/scene.ply")
NUM_MEMBER_KILLS, NUM_RUN_KILLS = 14, 6
STOPPED_S, NUM_STEPS = 5.0, 150
OPTIONS = ["--devices", "4", "--within-edge", "together", "--between-edges", "together", "--steps", "150", "--long-side-px", "96"]
OPTIONS += ["--max-splats", "1500", "--checkpoint-every", "0.3s"]


def config_of(out: Path) -> RunConfig:
    """As `OPTIONS`."""
    return RunConfig(
        source=out.parent / "hamlet",
        out=out,
        plan=replace(PlanOptions(), devices=4, within_edge="together", between_edges="together"),
        train=TrainOptions(long_side_px=96, num_steps=150, max_num_splats=1500),
        execution=ExecutionOptions(checkpoint_every_s=0.3),
    )


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, float]]:
    """A run left alone, and the seconds of its members."""
    folder, seconds = tmp_path_factory.mktemp("together"), dict[str, float]()
    hamlet_in(folder)

    def note(event: Event) -> None:
        if isinstance(event, StageDone):
            seconds[event.stage] = event.seconds

    radiant_app.commands.run.pipeline.run(config_of(folder / "whole"), note)
    return folder / "whole", seconds


def unfinished_copy(whole: Path, name: str) -> Path:
    """A copy of a run whose members have yet to begin."""
    out = whole.parent / name
    shutil.copytree(whole, out)
    for node in ("devices", "edges", "cloud"):
        shutil.rmtree(out / node)
    (out / "scene.ply").unlink()
    return out


class Once:
    """Listens to a run and does something once to the process of a member: so many seconds after
    its start, or when the root has taken so many steps."""

    def __init__(self, folder: Path, member: str, act: Callable[[int], None], *, after_s: float | None = None, at_step: int = 0) -> None:
        self._folder, self._member, self._act, self._after_s, self._at_step = folder, member, act, after_s, at_step
        self._acting = threading.Lock()
        self.has_acted = False
        self.warnings: list[str] = []

    def __call__(self, event: Event) -> None:
        if isinstance(event, Warned):
            self.warnings.append(f"{event.stage}: {event.message}")
        if isinstance(event, StageStarted) and event.stage == self._member and self._after_s is not None:
            timer = threading.Timer(self._after_s, self._once)
            timer.daemon = True
            timer.start()
        if isinstance(event, StageProgress) and event.stage == "cloud" and self._after_s is None and event.done >= self._at_step:
            self._once()

    def _once(self) -> None:
        with self._acting:
            pid = None if self.has_acted else worker_in(self._folder / self._member)
            if pid is not None:
                self.has_acted = True
                with suppress(ProcessLookupError):
                    self._act(pid)


def kill(pid: int) -> None:
    os.kill(pid, signal.SIGKILL)


def members_in(out: Path) -> list[str]:
    return [member for member in MEMBERS if worker_in(out / member) is not None]


def run_with_kill(undisturbed: Path, number: int, member: str, moment: float, lasts_s: float) -> tuple[Path, Once, str]:
    """A run in which a member is killed at a moment (0 … 1) of its life, or, where `number` is odd,
    of the training; in words when that was. Where it was done before, another run, killed sooner."""
    while True:
        out = unfinished_copy(undisturbed, f"member-{number}")
        at_step, after_s = int(moment * NUM_STEPS), None if number % 2 else moment * lasts_s
        once = Once(out, member, kill, at_step=at_step, after_s=after_s)
        radiant_app.commands.run.pipeline.run(config_of(out), once, resume=True)
        if once.has_acted:
            return out, once, f"at step {at_step}" if after_s is None else f"after {after_s:.1f} s"
        assert differing_files(undisturbed, out, RESULTS) == [] and moment > 0.01
        shutil.rmtree(out)
        moment *= 0.7


@pytest.mark.parametrize("number", range(NUM_MEMBER_KILLS))
def test_a_member_that_is_killed_comes_back_and_the_scene_has_the_same_bytes(
    number: int, whole: tuple[Path, dict[str, float]], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    undisturbed, seconds = whole
    monkeypatch.setattr(radiant_app.report.html, "write_report", lambda *arguments: None)
    rng = np.random.default_rng([59, number])
    member = MEMBERS[number % len(MEMBERS)]
    out, once, when = run_with_kill(undisturbed, number, member, rng.uniform(0.0, 1.0), seconds[member])
    assert differing_files(undisturbed, out, RESULTS) == [], once.warnings
    assert not any("Traceback" in message for message in once.warnings)
    assert not (out / "together").exists() and members_in(out) == []
    # Scored as the first run was: what it began with is the same, too.
    assert read_json(out / "metrics.json")["images"] == read_json(undisturbed / "metrics.json")["images"]
    with capsys.disabled():
        print(f"{member}: killed {when}, same bytes; {once.warnings[1:]}", flush=True)
    shutil.rmtree(out)


def test_a_device_that_stands_still_for_some_seconds_goes_on_with_the_same_bytes(
    whole: tuple[Path, dict[str, float]], monkeypatch: pytest.MonkeyPatch
) -> None:
    undisturbed, _ = whole
    monkeypatch.setattr(radiant_app.report.html, "write_report", lambda *arguments: None)
    out = unfinished_copy(undisturbed, "stopped")
    went_on_s: list[float] = []

    def stop(pid: int) -> None:
        os.kill(pid, signal.SIGSTOP)

        def go_on() -> None:
            went_on_s.append(time.monotonic())
            os.kill(pid, signal.SIGCONT)

        threading.Timer(STOPPED_S, go_on).start()

    once = Once(out, "devices/edge-2-1", stop, at_step=40)
    radiant_app.commands.run.pipeline.run(config_of(out), once, resume=True)
    assert once.has_acted and went_on_s, "the others waited for it"
    assert differing_files(undisturbed, out, RESULTS) == []
    assert not any("lost" in message for message in once.warnings), once.warnings


def test_a_run_that_is_killed_leaves_no_process_and_resumes_with_the_same_bytes(
    whole: tuple[Path, dict[str, float]], capsys: pytest.CaptureFixture[str]
) -> None:
    undisturbed, seconds = whole
    out = unfinished_copy(undisturbed, "run")
    command = [sys.executable, "-m", "radiant_app", "run", str(undisturbed.parent / "hamlet"), "--out", str(out), *OPTIONS, "--resume"]
    rng = np.random.default_rng(59)

    def kill_in(longest_s: float) -> Callable[[], bool]:
        begun_s, after_s = None, rng.uniform(0, longest_s)

        def is_due() -> bool:
            nonlocal begun_s
            if begun_s is None and len(members_in(out)) == len(MEMBERS):
                begun_s = time.monotonic()
            return begun_s is not None and time.monotonic() - begun_s >= after_s

        return is_due

    for number in range(NUM_RUN_KILLS):
        # Every second time the one who resumes does not wait until the workers have gone.
        moments = [kill_in(seconds["cloud"])] * (1 + number % 2)
        story = run_killed(command, command, moments)
        assert differing_files(undisturbed, out, RESULTS) == [], story.errors
        assert not any("Traceback" in error for error in story.errors), story.errors
        with capsys.disabled():
            print(f"run {number}: {story.num_kills} kills, same bytes", flush=True)
        for node in ("devices", "edges", "cloud"):
            shutil.rmtree(out / node)
        (out / "scene.ply").unlink()


def test_workers_end_within_three_seconds_after_their_run_was_killed(whole: tuple[Path, dict[str, float]]) -> None:
    undisturbed, _ = whole
    out = unfinished_copy(undisturbed, "orphans")
    command = [sys.executable, "-m", "radiant_app", "run", str(undisturbed.parent / "hamlet"), "--out", str(out), *OPTIONS, "--resume"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True) as process:
        until_s = time.monotonic() + 60
        while len(members_in(out)) < len(MEMBERS) and time.monotonic() < until_s:
            time.sleep(0.01)
        assert len(members_in(out)) == len(MEMBERS)
        time.sleep(1.5)
        process.kill()
    until_s = time.monotonic() + 3.0
    while members_in(out) and time.monotonic() < until_s:
        time.sleep(0.05)
    assert members_in(out) == []
