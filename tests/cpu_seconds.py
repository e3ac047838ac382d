"""CPU seconds of every test, with those of the processes that it starts: a limit, and a summary.

    seconds of a phase (setup, call, teardown) = growth of the sum, over this process and all that
    descend from it, of user and system time, of their own and of what they have waited for

A module's or a session's fixture is in the setup of the first test that asks for it. Time of the
processor, not of the clock: a test that waits, or whose machine does other work beside, uses none.
The sum is read from /proc after each phase that took longer than SHORT_S; of shorter ones, only
this process counts. Where the kernel does not list children, nothing is measured and nothing fails.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

LIMIT_S = 120.0
"""A phase of a test may take so many; `@pytest.mark.cpu_seconds(N)` says another number, `stress` none."""
SHORT_S = 0.05
NUM_SHOWN = 25
CHILDREN = Path("/proc/self/task") / str(os.getpid()) / "children"
_TICKS_PER_S = os.sysconf("SC_CLK_TCK") if hasattr(os, "sysconf") else 100


def seconds_of_tree(pid: int) -> float:
    """CPU seconds of a process and its descendants so far; of those that ended, what was waited for."""
    ticks, tree = 0, [pid]
    while tree:
        folder = f"/proc/{tree.pop()}"
        try:
            with open(f"{folder}/stat", "rb") as file:  # noqa: PTH123  # twice as fast as Path, thousands of times
                ticks += sum(map(int, file.read().rpartition(b")")[2].split()[11:15]))
            for thread in os.listdir(f"{folder}/task"):  # noqa: PTH208
                with open(f"{folder}/task/{thread}/children", "rb") as file:  # noqa: PTH123
                    tree.extend(map(int, file.read().split()))
        except OSError:  # It ended meanwhile.
            continue
    return ticks / _TICKS_PER_S


class CpuSeconds:
    """The plugin: in a process that runs tests it measures them, in the one that reports it adds up."""

    def __init__(self) -> None:
        self.is_measuring = CHILDREN.exists()
        self.tree_s, self.process_s, self.began_s = 0.0, 0.0, 0.0
        self.phases: list[tuple[float, str, str]] = []

    def start(self) -> None:
        """Count from here on."""
        self.tree_s, self.process_s, self.began_s = seconds_of_tree(os.getpid()), time.process_time(), time.monotonic()

    def lap(self) -> float:
        """Seconds since the last lap."""
        now_s = time.process_time()
        spent_s, self.process_s = now_s - self.process_s, now_s
        if time.monotonic() - self.began_s > SHORT_S:
            tree_s = seconds_of_tree(os.getpid())
            spent_s, self.tree_s = max(spent_s, tree_s - self.tree_s), tree_s
        else:
            self.tree_s += spent_s
        self.began_s = time.monotonic()
        return spent_s

    def pytest_collection_finish(self) -> None:
        """What was imported to find the tests is no test's."""
        if self.is_measuring:
            self.start()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item) -> Generator[None, Any, Any]:
        """Add `cpu_s` to the report of a phase, which a pytest-xdist worker sends with it."""
        spent_s = self.lap() if self.is_measuring else 0.0
        report = yield
        report.cpu_s = round(spent_s, 3)
        limit_s = limit_of(item)
        if report.passed and spent_s > limit_s:
            report.outcome = "failed"
            report.longrepr = (
                f"{report.when} of {item.nodeid} took {spent_s:.1f} s of CPU time, at most {limit_s:.0f} s are allowed: make its scene "
                "smaller, share what it makes with others by a fixture, or, if it is of random or huge input, mark it `stress`."
            )
        return report

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Note what a phase took."""
        self.phases.append((getattr(report, "cpu_s", 0.0), report.nodeid, report.when))

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        """Where the suite's seconds went: by folder, and the largest phases."""
        total_s = sum(seconds for seconds, *_ in self.phases)
        if not self.is_measuring or total_s < LIMIT_S:
            return
        folders: Counter[str] = Counter()
        for seconds, nodeid, _ in self.phases:
            folders["/".join(nodeid.split("::")[0].split("/")[:-1][:3])] += seconds
        terminalreporter.section(f"CPU seconds of the tests: {total_s:.0f}")
        terminalreporter.write_line(", ".join(f"{folder} {seconds:.0f}" for folder, seconds in folders.most_common()))
        for seconds, nodeid, when in sorted(self.phases, reverse=True)[:NUM_SHOWN]:
            terminalreporter.write_line(f"{seconds:8.1f} {when:8} {nodeid}")


def limit_of(item: pytest.Item) -> float:
    """CPU seconds that a phase of a test may take."""
    if item.get_closest_marker("stress"):
        return float("inf")
    marker = item.get_closest_marker("cpu_seconds")
    return float(marker.args[0]) if marker else LIMIT_S
