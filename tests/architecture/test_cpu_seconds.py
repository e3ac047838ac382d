"""The limit that every test runs under: processes count while they live and when they have ended, and what exceeds it fails."""

from __future__ import annotations

import os
import subprocess
import sys
from types import SimpleNamespace
from typing import Any, cast

import pytest

from tests import cpu_seconds
from tests.cpu_seconds import CpuSeconds, limit_of, seconds_of_tree

BURN = "import sys, time\nwhile time.process_time() < 0.3: pass\nprint('done', flush=True)\nsys.stdin.read()"

pytestmark = pytest.mark.skipif(not cpu_seconds.CHILDREN.exists(), reason="this kernel lists no children of a process")


def test_processes_count_while_they_live_and_afterwards() -> None:
    before_s = seconds_of_tree(os.getpid())
    nested = f"import subprocess, sys; subprocess.run([sys.executable, '-S', '-c', {BURN!r}], check=True)"
    with subprocess.Popen([sys.executable, "-S", "-c", nested], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None and process.stdout.readline() == b"done\n"
        alive_s = seconds_of_tree(os.getpid()) - before_s
    # 0.3 s less a tick of 0.01 s, and what starting two interpreters takes.
    assert 0.29 <= alive_s <= seconds_of_tree(os.getpid()) - before_s + 0.02 < 5


def item(*marks: pytest.Mark) -> Any:
    """A test with these marks."""
    by_name = {mark.name: mark for mark in marks}
    return cast(Any, SimpleNamespace(nodeid="tests/a.py::test_b", get_closest_marker=by_name.get))


def reported(spent_s: float, of: Any) -> Any:
    """The report of a call of that length that passed."""
    plugin = CpuSeconds()
    plugin.lap = lambda: spent_s  # type: ignore[method-assign]
    hook = plugin.pytest_runtest_makereport(of)
    next(hook)
    with pytest.raises(StopIteration) as ended:
        hook.send(SimpleNamespace(passed=True, outcome="passed", when="call", longrepr=None))
    return ended.value.value


def test_what_exceeds_its_limit_fails_with_a_sentence_and_stress_has_none() -> None:
    assert reported(cpu_seconds.LIMIT_S - 1, item()).outcome == "passed"
    failed = reported(cpu_seconds.LIMIT_S + 1, item())
    assert failed.outcome == "failed" and failed.longrepr.startswith(
        f"call of tests/a.py::test_b took {cpu_seconds.LIMIT_S + 1:.1f} s of CPU time"
    )
    assert limit_of(item(pytest.mark.cpu_seconds(90).mark)) == 90 and limit_of(item(pytest.mark.stress.mark)) == float("inf")
