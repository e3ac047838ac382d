"""20 of 20: the cloud, an edge or a device of a run over a network, killed with SIGKILL at random moments, several times in a run, and
started again: the run ends by itself with the scene of a run left alone, and no training begins from zero twice. A device is killed while
it trains, for long enough to be hit, and goes on from the step of its newest checkpoint."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest

from radiant_app.config.run_config import TrainOptions
from tests.app.network_processes import Fleet, run_here
from tests.stress.kill_harness import random_moments

pytestmark = pytest.mark.stress
NUM_KILLS, KILLS_PER_RUN, LONGEST_S = 20, 4, 6.0
KILLS_PER_TRAINING, LONGEST_TRAINING_CPU_S = 10, 1.0
LONG = TrainOptions(long_side_px=96, num_steps=6000, max_num_splats=2000)


def after(seconds: float) -> Callable[[], bool]:
    """True so many seconds after it was asked first."""
    began: list[float] = []

    def is_due() -> bool:
        began.append(time.monotonic())
        return began[-1] - began[0] >= seconds

    return is_due


@pytest.mark.parametrize(("name", "seed"), [("cloud", 1), ("e", 2)])
def test_twenty_kills_at_random_moments(tmp_path: Path, name: str, seed: int) -> None:
    whole, hits, runs = b"", 0, 0
    moments = random_moments(seed, 10 * NUM_KILLS, LONGEST_S)
    while hits < NUM_KILLS:
        fleet = Fleet(folder=tmp_path / str(runs))
        fleet.make()
        now = [moments.pop() for _ in range(KILLS_PER_RUN)]
        try:
            hits += fleet.run_with([(name, after(seconds)) for seconds in now], 600)
        finally:
            fleet.close()
        whole = whole or run_here(fleet.folder)
        assert (fleet.folder / "far" / "scene.ply").read_bytes() == whole, now
        steps = fleet.trained_from("own_field")
        # Killed before its first checkpoint, a training has nothing to lose.
        assert all(step >= before for before, step in pairwise(steps)), steps
        runs += 1
    print(f"{name}: {hits} kills in {runs} runs")


def cpu_s(parent: int) -> float:
    """CPU seconds of the children that a process has now: workers have sessions of their own."""
    ticks = 0
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            values = path.read_text().rpartition(")")[2].split()
        except (FileNotFoundError, ProcessLookupError):
            continue
        if int(values[1]) == parent:
            ticks += int(values[11]) + int(values[12])
    return ticks / os.sysconf("SC_CLK_TCK")


def while_training(fleet: Fleet, number: int, seconds: float) -> Callable[[], bool]:
    """True so many CPU seconds after the `number`-th process began to train, from zero or from a checkpoint."""
    began: list[float] = []

    def is_due() -> bool:
        if len(fleet.trained_from("own_field")) < number:
            return False
        began.append(cpu_s(fleet.running["d"].pid))
        return began[-1] - began[0] >= seconds

    return is_due


def test_twenty_kills_of_a_device_while_it_trains(tmp_path: Path) -> None:
    hits, runs, steps = 0, 0, list[int]()
    moments = random_moments(3, 10 * NUM_KILLS, LONGEST_TRAINING_CPU_S)
    while hits < NUM_KILLS:
        fleet = Fleet(folder=tmp_path / str(runs), train=LONG, checkpoint_every_s=0.1)
        fleet.make()
        kills = [("d", while_training(fleet, number, moments.pop())) for number in range(1, KILLS_PER_TRAINING + 1)]
        try:
            hits += fleet.run_with(kills, 3000)
        finally:
            fleet.close()
        assert (fleet.folder / "far" / "scene.ply").read_bytes() == run_here(fleet.folder)
        saved = set(fleet.saved_at_kill)
        from_steps = fleet.trained_from("own_field")
        assert from_steps == sorted(from_steps) and {*from_steps} <= {0, *saved}, (from_steps, fleet.saved_at_kill)
        assert sum(step == 0 for step in from_steps) <= 1 + fleet.saved_at_kill.count(0), "from zero only where nothing was saved"
        steps += from_steps
        runs += 1
    assert sum(step > 0 for step in steps) >= NUM_KILLS // 2, "trainings were hit after their first checkpoint"
    print(f"d: {hits} kills in {runs} runs; trained from the steps {steps} of {LONG.num_steps}")
