"""Kills a command again and again with SIGKILL, resumes it until it is done, and compares what it
made with an undisturbed run.

    undisturbed = run_whole(command)                     once
    story = run_killed(command, resumed, delays_s)       killed after delays_s[0], resumed, killed after delays_s[1], …, then left alone
    differing_files(whole, killed, names)                []

Every run is a session of its own, and the whole process group is killed, so that no worker outlives
it. A run that ends before its kill ends the story. Kills come at moments that only the seed
decides, in seconds since the start of each process, or when a file appears.
"""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from radiant_app.executors.sessions import signal_session

Moment = float | Callable[[], bool]
"""Seconds after the start, or what becomes true when the kill is to come."""
POLL_S = 0.002
TIMEOUT_S = 600.0


@dataclass(frozen=True, kw_only=True)
class KillStory:
    """What happened to one job."""

    num_kills: int
    """Processes that died by our signal."""
    num_runs: int
    """Processes that were started, the last one included."""
    errors: tuple[str, ...]
    """Standard error of every process."""


def random_moments(seed: int, count: int, longest_s: float) -> list[float]:
    """Moments (count,) of kills in seconds, evenly over 0 … longest_s."""
    return np.random.default_rng(seed).uniform(0, longest_s, count).tolist()


def run_whole(command: Sequence[str], environment: dict[str, str] | None = None) -> float:
    """Run a command to its end; returns its seconds, fails the test when it does."""
    begun_s = time.monotonic()
    done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False, env=_environment(environment))
    assert done.returncode == 0, done.stderr
    return time.monotonic() - begun_s


def run_killed(
    command: Sequence[str], resumed: Sequence[str], moments: Sequence[Moment], environment: dict[str, str] | None = None
) -> KillStory:
    """Start `command`, kill it at the first moment, start `resumed` and kill that at the next, and so on; the last is left alone."""
    errors: list[str] = []
    for number, moment in enumerate([*moments, None]):
        process = subprocess.Popen(
            command if number == 0 else resumed,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            env=_environment(environment),
        )
        try:
            if moment is not None:
                _wait_for(moment, process)
                if process.poll() is None:
                    signal_session(process.pid, signal.SIGKILL)
            _, error = process.communicate(timeout=TIMEOUT_S)
        finally:
            _end(process)
        errors.append(error)
        if process.returncode == 0:
            return KillStory(num_kills=number, num_runs=number + 1, errors=tuple(errors))
        assert moment is not None and process.returncode == -signal.SIGKILL, error
    raise AssertionError("the last run is left alone and ends the story")


def differing_files(whole: Path, killed: Path, names: Sequence[str]) -> list[str]:
    """Which of the files `names` differ in a byte between two folders, or are missing."""
    return [
        name
        for name in names
        if not ((whole / name).is_file() and (killed / name).is_file() and (whole / name).read_bytes() == (killed / name).read_bytes())
    ]


def _wait_for(moment: Moment, process: subprocess.Popen[str]) -> None:
    begun_s = time.monotonic()
    while process.poll() is None and time.monotonic() - begun_s < TIMEOUT_S:
        if moment() if callable(moment) else time.monotonic() - begun_s >= moment:
            return
        time.sleep(POLL_S)


def _end(process: subprocess.Popen[str]) -> None:
    if process.poll() is None:
        signal_session(process.pid, signal.SIGKILL)
        process.wait()


def _environment(more: dict[str, str] | None) -> dict[str, str]:
    # One thread, so that a run takes its time whatever else the machine does, and the same for
    # every run.
    return {**os.environ, "OMP_NUM_THREADS": "1", **(more or {})}
