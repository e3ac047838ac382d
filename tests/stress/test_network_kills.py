"""20 of 20: the cloud, an edge or a device of a run over a network, killed with SIGKILL at random moments, several times in a run, and
started again: the run ends by itself with the scene of a run left alone, and no training begins from zero twice."""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest

from tests.app.network_processes import Fleet, run_here
from tests.stress.kill_harness import random_moments

pytestmark = pytest.mark.stress
NUM_KILLS, KILLS_PER_RUN, LONGEST_S = 20, 4, 6.0


def after(seconds: float) -> Callable[[], bool]:
    """True so many seconds after it was asked first."""
    began: list[float] = []

    def is_due() -> bool:
        began.append(time.monotonic())
        return began[-1] - began[0] >= seconds

    return is_due


@pytest.mark.parametrize(("name", "seed"), [("cloud", 1), ("e", 2), ("d", 3)])
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
        starts = fleet.starts("own_field")
        # Killed before its first checkpoint, a training has nothing to lose.
        assert all(saved >= before for before, saved in pairwise(starts)), starts
        runs += 1
    print(f"{name}: {hits} kills in {runs} runs")
